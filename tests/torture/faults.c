/* A disk that fails or forgets, in front of the C library (LD_PRELOAD): what is written to files of one folder.
 *
 * PLUMB_FAULT_DIR      the folder; paths that begin with it are meant
 * PLUMB_FAULT_CONTROL  a file of eight ints, changed while the process runs: after how many more writes or syncs it fails (0: never),
 *                      the errno, the writes and syncs so far, and those that failed; the same four of reads. It goes on failing
 *                      until the first is 0 again.
 * PLUMB_FAULT_LOG      where every write, truncation, rename, removal and sync is written down, for the disk after a power cut
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <unistd.h>

enum { FILES = 65536 };
static char *path_of[FILES];
static volatile int *control;
static int log_fd = -1;
static const char *folder;
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;

#define REAL(name) ((__typeof__(&name))real(#name))
static void *real(const char *name) { return dlsym(RTLD_NEXT, name); }

__attribute__((constructor)) static void begin(void) {
    folder = getenv("PLUMB_FAULT_DIR");
    const char *file = getenv("PLUMB_FAULT_CONTROL");
    if (file) {
        int fd = REAL(open)(file, O_RDWR);
        void *mapped = mmap(0, 32, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
        if (mapped != MAP_FAILED) control = mapped;
    }
    const char *log = getenv("PLUMB_FAULT_LOG");
    if (log) log_fd = REAL(open)(log, O_WRONLY | O_CREAT | O_APPEND, 0600);
}

static int is_meant(const char *path) { return folder && path && !strncmp(path, folder, strlen(folder)) && !strstr(path, "-shm"); }

static const char *meant(int fd) { return fd >= 0 && fd < FILES ? path_of[fd] : 0; }

/* Whether what these four ints count is to fail this time; errno is set then. */
static int fails_by(volatile int *ints) {
    if (!control) return 0;
    __sync_fetch_and_add((int *)&ints[2], 1);
    int left = ints[0];
    if (left <= 0) return 0;
    if (left > 1) {
        ints[0] = left - 1;
        return 0;
    }
    __sync_fetch_and_add((int *)&ints[3], 1);
    errno = ints[1];
    return 1;
}
static int fails(void) { return fails_by(control); }
static int read_fails(void) { return fails_by(control + 4); }

/* One line of the log: what, path, offset, length; then the bytes. */
static void note(char what, const char *path, int64_t offset, const void *bytes, int64_t length) {
    if (log_fd < 0) return;
    char head[4400];
    int n = snprintf(head, sizeof head, "%c\t%s\t%lld\t%lld\n", what, path, (long long)offset, (long long)length);
    struct iovec parts[2] = {{head, n}, {(void *)bytes, bytes ? length : 0}};
    pthread_mutex_lock(&lock);
    if (REAL(writev)(log_fd, parts, bytes ? 2 : 1) < 0) abort();
    pthread_mutex_unlock(&lock);
}

static int opened(int fd, const char *path, int flags) {
    if (fd >= 0 && fd < FILES) {
        path_of[fd] = is_meant(path) ? strdup(path) : 0;
        if (path_of[fd] && (flags & O_TRUNC)) note('t', path, 0, 0, 0);
    }
    return fd;
}

#define MODE(flags) ({ mode_t mode = 0; if ((flags) & (O_CREAT | O_TMPFILE)) { va_list rest; va_start(rest, flags); mode = va_arg(rest, mode_t); va_end(rest); } mode; })
int open(const char *path, int flags, ...) { return opened(REAL(open)(path, flags, MODE(flags)), path, flags); }
int open64(const char *path, int flags, ...) { return opened(REAL(open64)(path, flags, MODE(flags)), path, flags); }
int close(int fd) {
    if (fd >= 0 && fd < FILES) path_of[fd] = 0;
    return REAL(close)(fd);
}

static ssize_t written(ssize_t n, const char *path, int64_t offset, const void *bytes) {
    if (n > 0) note('w', path, offset, bytes, n);
    return n;
}

ssize_t pwrite64(int fd, const void *bytes, size_t length, off64_t offset) {
    const char *path = meant(fd);
    if (!path) return REAL(pwrite64)(fd, bytes, length, offset);
    return fails() ? -1 : written(REAL(pwrite64)(fd, bytes, length, offset), path, offset, bytes);
}
ssize_t pwrite(int fd, const void *bytes, size_t length, off_t offset) { return pwrite64(fd, bytes, length, offset); }
ssize_t write(int fd, const void *bytes, size_t length) {
    const char *path = meant(fd);
    if (!path) return REAL(write)(fd, bytes, length);
    int64_t offset = lseek(fd, 0, SEEK_CUR);
    return fails() ? -1 : written(REAL(write)(fd, bytes, length), path, offset, bytes);
}
ssize_t writev(int fd, const struct iovec *parts, int count) {
    /* A short write is a write: the rest is asked for again. */
    return meant(fd) && count > 0 ? write(fd, parts[0].iov_base, parts[0].iov_len) : REAL(writev)(fd, parts, count);
}
ssize_t pread64(int fd, void *bytes, size_t length, off64_t offset) {
    return meant(fd) && read_fails() ? -1 : REAL(pread64)(fd, bytes, length, offset);
}
ssize_t pread(int fd, void *bytes, size_t length, off_t offset) { return pread64(fd, bytes, length, offset); }
ssize_t read(int fd, void *bytes, size_t length) { return meant(fd) && read_fails() ? -1 : REAL(read)(fd, bytes, length); }
int ftruncate64(int fd, off64_t length) {
    const char *path = meant(fd);
    if (path && fails()) return -1;
    if (path) note('t', path, length, 0, 0);
    return REAL(ftruncate64)(fd, length);
}
int ftruncate(int fd, off_t length) { return ftruncate64(fd, length); }
int fsync(int fd) {
    const char *path = meant(fd);
    if (path && fails()) return -1;
    int answer = REAL(fsync)(fd);
    if (path) note('s', path, 0, 0, 0);
    return answer;
}
int fdatasync(int fd) {
    const char *path = meant(fd);
    if (path && fails()) return -1;
    int answer = REAL(fdatasync)(fd);
    if (path) note('s', path, 0, 0, 0);
    return answer;
}
int unlink(const char *path) {
    if (is_meant(path)) note('u', path, 0, 0, 0);
    return REAL(unlink)(path);
}
int rename(const char *from, const char *to) {
    if (is_meant(from)) note('r', from, 0, to, strlen(to));
    return REAL(rename)(from, to);
}
