#!/bin/bash
# A small Linux machine with a real V4L2 stack, for hosts whose kernel has none (containers, most virtual machines).
#
#   small_machine.sh prepare                                    make it: packages, kernel, modules, initramfs; quick when done
#   small_machine.sh run [-t SECONDS] [-m 'MODULE ARGS']… [-u UNIT] -- PROGRAM ARGS…
#
# QEMU boots Debian's own kernel (in software: no KVM is needed), loads the modules and runs PROGRAM on
# the host's root file system, which the guest sees read-only. Writable in the guest: /run, and /run/out, which is
# $SMALL_MACHINE_OUT on the host. In the guest `/run/machine/modprobe NAME ARGS` loads another module.
# With -u the guest's first process is systemd, which knows the service in the file UNIT, the root file system may be
# changed (the changes are forgotten), and PROGRAM runs as root when the basic system is up.
# Output and exit status are PROGRAM's own; 124: no end in time; 125: the guest died; 126: a module did not load.
set -euo pipefail
HOME_DIR=${SMALL_MACHINE_HOME:-${XDG_CACHE_HOME:-$HOME/.cache}/plumb-small-machine}
PACKAGES=(qemu-system-x86 busybox-static cpio kmod v4l-utils xz-utils systemd)
MODULES=(vivid v4l2loopback uvcvideo vhci_hcd overlay virtio_pci 9pnet_virtio 9p)
# Raised when a change here must remake what is prepared.
RECIPE=3

fail() { echo "small machine: $*" >&2; exit 125; }

prepare() {
  mkdir -p "$HOME_DIR"
  exec 9>"$HOME_DIR/lock"; flock 9
  local missing=() package
  for package in "${PACKAGES[@]}"; do installed "$package" || missing+=("$package"); done
  if [ ${#missing[@]} -eq 0 ] && [ "$(cat "$HOME_DIR/made" 2>/dev/null)" = "$RECIPE" ]; then return 0; fi
  local log=$HOME_DIR/prepare.log
  dpkg --configure -a >"$log" 2>&1 || true  # an installation that was cut off
  apt-get update -qq >>"$log" 2>&1 || true
  local image version
  image=$(apt-cache depends linux-image-amd64 | awk '$1 == "Depends:" { print $2; exit }')
  [ -n "$image" ] || fail "the package index knows no linux-image-amd64 (see $log)"
  version=${image#linux-image-}
  missing+=("linux-headers-$version" gcc-12 make)
  DEBIAN_FRONTEND=noninteractive apt-get -qq -o DPkg::Lock::Timeout=900 install -y --no-install-recommends "${missing[@]}" \
    >>"$log" 2>&1 || fail "apt-get could not install ${missing[*]} (see $log)"
  local tree=$HOME_DIR/tree
  rm -rf "$tree"; mkdir -p "$tree"
  unpack_kernel "$image" "$tree" >>"$log" 2>&1 || fail "the kernel $image could not be fetched (see $log)"
  build_loopback "$version" "$tree" >>"$log" 2>&1 || fail "v4l2loopback did not build (see $log)"
  /sbin/depmod -b "$tree" "$version"
  make_initramfs "$version" "$tree"
  cp "$tree/boot/vmlinuz-$version" "$HOME_DIR/vmlinuz"
  rm -rf "$tree"
  echo "$RECIPE" >"$HOME_DIR/made"
}

installed() { [ "$(dpkg-query -W -f '${db:Status-Status}' "$1" 2>/dev/null)" = installed ]; }

unpack_kernel() {
  local image=$1 tree=$2
  (cd "$HOME_DIR" && rm -f ./*.deb && apt-get download "$image")
  dpkg-deb --extract "$HOME_DIR/${image}"_*.deb "$tree"
  # From Debian 13 on the modules are under /usr, and compressed.
  if [ -d "$tree/usr/lib/modules" ]; then mkdir -p "$tree/lib"; mv "$tree/usr/lib/modules" "$tree/lib/"; fi
  rm -f "$HOME_DIR/${image}"_*.deb
}

build_loopback() {
  local version=$1 tree=$2 source=$HOME_DIR/loopback
  rm -rf "$source"
  (cd "$HOME_DIR" && apt-get download v4l2loopback-dkms && dpkg-deb -x v4l2loopback-dkms_*.deb "$source" && rm -f ./*.deb)
  local build; build=$(echo "$source"/usr/src/v4l2loopback-*)
  make -s -C "/lib/modules/$version/build" M="$build" modules
  mkdir -p "$tree/lib/modules/$version/extra"
  strip -g -o "$tree/lib/modules/$version/extra/v4l2loopback.ko" "$build/v4l2loopback.ko"
  rm -rf "$source"
}

make_initramfs() {
  local version=$1 tree=$2 root=$HOME_DIR/root module path
  rm -rf "$root"; mkdir -p "$root"/{bin,modules,lists,proc,sys,dev,run,host}
  cp "$(command -v busybox)" "$root/bin/busybox"
  for module in "${MODULES[@]}"; do
    # The order in which insmod must load them.
    /sbin/modprobe -d "$tree" -S "$version" --show-depends "$module" | awk '$1 == "insmod" { print $2 }' |
      while read -r path; do unpacked_module "$path" "$root/modules"; done >"$root/lists/$module"
  done
  cat >"$root/modprobe" <<'GUEST'
#!/run/machine/busybox sh
# modprobe NAME ARGS: loads what NAME needs, then NAME with its arguments.
bb=/run/machine/busybox; name=$1; shift
last=$($bb tail -n1 /run/machine/lists/$name)
for file in $($bb cat /run/machine/lists/$name); do
  loaded=$(echo ${file%.ko} | $bb tr - _)
  [ -d /sys/module/$loaded ] && continue
  if [ $file = $last ]; then $bb insmod /run/machine/modules/$file "$@" || exit 1; else $bb insmod /run/machine/modules/$file || exit 1; fi
done
GUEST
  cat >"$root/init" <<'GUEST'
#!/bin/busybox sh
bb=/bin/busybox
$bb mount -t proc proc /proc; $bb mount -t sysfs sys /sys; $bb mount -t devtmpfs dev /dev
$bb ln -s / /run/machine; $bb ln -s /bin/busybox /busybox
for module in virtio_pci 9pnet_virtio 9p; do $bb sh /modprobe $module; done
$bb mount -t 9p -o trans=virtio,version=9p2000.L,ro,cache=loose,msize=524288 hostroot /host
new=/host
if $bb grep -q small_machine.systemd /proc/cmdline; then
  $bb sh /modprobe overlay
  $bb mkdir /above; $bb mount -t tmpfs above /above; $bb mkdir /above/changed /above/work /above/root
  new=/above/root
  $bb mount -t overlay -o lowerdir=/host,upperdir=/above/changed,workdir=/above/work root $new
fi
$bb mount -t tmpfs run $new/run; $bb mkdir -p $new/run/machine $new/run/out
$bb cp -r /modules /lists /modprobe $new/run/machine/; $bb cp /bin/busybox $new/run/machine/busybox
$bb chmod 755 $new/run/machine/modprobe
$bb mount -t 9p -o trans=virtio,version=9p2000.L,msize=524288 hostout $new/run/out
$bb ifconfig lo 127.0.0.1 up
$bb stty -F /dev/ttyS1 raw -echo
if [ $new != /host ]; then
  $bb mkdir -p $new/run/systemd/system
  $bb cp $new/run/out/units/* $new/run/systemd/system/
  for dir in proc sys dev; do $bb mount --move /$dir $new/$dir; done
  # By this file systemd would take itself to be in a container, like the host.
  $bb rm -f $new/.dockerenv
  exec $new/run/machine/busybox switch_root $new /lib/systemd/systemd --unit=small-machine.service
fi
for dir in proc sys dev; do $bb mount --bind /$dir /host/$dir; done
$bb chroot /host /run/out/command.sh </dev/null >/dev/ttyS1 2>&1
$bb echo $? >/host/run/out/status
$bb sync; $bb sleep 0.1; $bb reboot -f
GUEST
  chmod +x "$root/init" "$root/modprobe"
  (cd "$root" && find . | cpio -o -H newc --quiet) | gzip -1 >"$HOME_DIR/initramfs"
  rm -rf "$root"
}

# Copies a module, without its compression, and prints its name.
unpacked_module() {
  local name; name=$(basename "$1" .xz)
  if [ ! -e "$2/$name" ]; then
    if [ "$name" = "$(basename "$1")" ]; then cp "$1" "$2/$name"; else xz -dc "$1" >"$2/$name"; fi
  fi
  echo "$name"
}

run() {
  local seconds=180 modules=() unit='' init='' out status=0
  while [ $# -gt 0 ]; do
    case $1 in -t) seconds=$2; shift 2 ;; -m) modules+=("$2"); shift 2 ;; -u) unit=$2; shift 2 ;; --) shift; break ;; *) break ;; esac
  done
  [ -s "$HOME_DIR/initramfs" ] || fail "not prepared: run $0 prepare"
  out=${SMALL_MACHINE_OUT:-$(mktemp -d /tmp/small-machine.XXXXXX)}
  mkdir -p "$out"; rm -f "$out/status"
  command_file "$out" "${modules[@]+"${modules[@]}"}" -- "$@"
  if [ -n "$unit" ]; then
    units "$out" "$unit"
    # /tmp stays as it is: the program may lie there.
    init="small_machine.systemd systemd.show_status=no systemd.condition-needs-update=0"
    init="$init systemd.mask=tmp.mount systemd.mask=systemd-tmpfiles-setup.service"
  fi
  timeout -k 5 "$seconds" qemu-system-x86_64 -M pc -accel tcg,thread=multi -cpu max -m "${SMALL_MACHINE_MB:-1024}" -smp 2 \
    -kernel "$HOME_DIR/vmlinuz" -initrd "$HOME_DIR/initramfs" \
    -append 'console=ttyS0 quiet panic=-1 reboot=t mitigations=off random.trust_cpu=on '"$init" \
    -display none -monitor none -no-reboot -net none -serial "file:$out/console.log" -serial stdio \
    -virtfs local,path=/,mount_tag=hostroot,security_model=none,readonly=on,multidevs=remap \
    -virtfs local,path="$out",mount_tag=hostout,security_model=none </dev/null 2>"$out/qemu.log" || status=$?
  if [ "$status" = 124 ] || [ "$status" = 137 ]; then echo "small machine: no end within $seconds s (kernel messages: $out/console.log)" >&2; return 124; fi
  [ -s "$out/status" ] || fail "the guest died: $(tail -n1 "$out/qemu.log") (kernel messages: $out/console.log)"
  return "$(cat "$out/status")"
}

# The service that is tried, and one that runs the command and ends the guest.
units() {
  mkdir -p "$1/units"; cp "$2" "$1/units/"
  cat >"$1/units/small-machine.service" <<'UNIT'
[Service]
Type=oneshot
TimeoutStartSec=infinity
ExecStart=/bin/sh -c '/run/out/command.sh </dev/null >/dev/ttyS1 2>&1; echo $$? >/run/out/status; sync; /run/machine/busybox sleep 0.1; /run/machine/busybox reboot -f'
UNIT
}

# What the guest runs: the modules, then the program, in this directory and with nothing of this environment but $GUEST_ENV.
command_file() {
  local out=$1 module; shift
  {
    echo '#!/bin/sh'
    while [ "$1" != -- ]; do printf '/run/machine/modprobe %s || exit 126\n' "$1"; shift; done
    shift
    echo 'export SMALL_MACHINE_GUEST=1 TMPDIR=/run HOME=/run PATH=/usr/local/bin:/usr/bin:/bin:/sbin:/usr/sbin'
    for module in ${GUEST_ENV:-}; do printf 'export %s=%q\n' "$module" "${!module}"; done
    printf 'cd %q\nexec' "$PWD"; printf ' %q' "$@"; echo
  } >"$out/command.sh"
  chmod +x "$out/command.sh"
}

case ${1:-} in
  prepare) prepare ;;
  run) shift; run "$@" ;;
  *) sed -n '2,14s/^# \{0,1\}//p' "$0" >&2; exit 2 ;;
esac
