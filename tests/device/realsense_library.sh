#!/bin/bash
# The real RealSense library, without a camera: for building and testing `--features realsense` where Intel's own package
# (librealsense2-dev) is not installed. Prints the environment that cargo needs; quick when done.
#
#   eval "$(tests/device/realsense_library.sh)" && cargo test --features realsense --test realsense
#
# The library is taken from the Python wheel, whose one shared object exports the whole C interface; what it expects of
# Python is answered by a stub that is never called.
set -euo pipefail
HOME_DIR=${REALSENSE_HOME:-${XDG_CACHE_HOME:-$HOME/.cache}/plumb-realsense}
WHEEL=pyrealsense2==2.56.5.9235
VERSION=2.56.5
PACKAGES=(patchelf libusb-1.0-0 libudev1)

make_library() {
  local work=$HOME_DIR/work object package missing=()
  for package in "${PACKAGES[@]}"; do
    [ "$(dpkg-query -W -f '${db:Status-Status}' "$package" 2>/dev/null)" = installed ] || missing+=("$package")
  done
  if [ ${#missing[@]} -gt 0 ]; then
    apt-get update -qq || true
    DEBIAN_FRONTEND=noninteractive apt-get -qq -o DPkg::Lock::Timeout=900 install -y --no-install-recommends "${missing[@]}"
  fi
  rm -rf "$work"; mkdir -p "$work/wheel" "$HOME_DIR/lib"
  python3 -m pip download --quiet --disable-pip-version-check --no-deps --only-binary=:all: --python-version 3.11 -d "$work" "$WHEEL"
  (cd "$work/wheel" && python3 -m zipfile -e ../*.whl .)
  object=$(find "$work/wheel" -name 'pyrealsense2*.so' | head -n1)
  cp "$object" "$HOME_DIR/lib/librealsense2.so"
  find "$work/wheel" -path '*pyrealsense2.libs/*' -name '*.so*' -exec cp {} "$HOME_DIR/lib/" \;
  # Every Python symbol as both: called, it ends the program; looked at, it is empty memory.
  nm -D --undefined-only "$HOME_DIR/lib/librealsense2.so" | awk '$2 ~ /^_?Py/ { print $2 }' | sort -u |
    awk '{ if ($1 ~ /_Type$|^PyExc_|Struct$/) print "char " $1 "[4096] __attribute__((aligned(16)));"; else print "void " $1 "(void) { abort(); }" }' |
    { echo '#include <stdlib.h>'; cat; } >"$work/stub.c"
  gcc -shared -fPIC -w -o "$HOME_DIR/lib/libplumb_no_python.so" "$work/stub.c"
  # One change a run: patchelf 0.14 confuses several.
  patchelf --set-soname librealsense2.so "$HOME_DIR/lib/librealsense2.so"
  patchelf --set-rpath '$ORIGIN' "$HOME_DIR/lib/librealsense2.so"
  patchelf --add-needed libplumb_no_python.so "$HOME_DIR/lib/librealsense2.so"
  cat >"$HOME_DIR/realsense2.pc" <<PC
prefix=$HOME_DIR
libdir=\${prefix}/lib
Name: realsense2
Description: the RealSense library from its Python wheel
Version: $VERSION
Libs: -L\${libdir} -lrealsense2
Cflags:
PC
  rm -rf "$work"
  echo "$WHEEL" >"$HOME_DIR/made"
}

mkdir -p "$HOME_DIR"
exec 9>"$HOME_DIR/lock"; flock 9
if [ "$(cat "$HOME_DIR/made" 2>/dev/null)" != "$WHEEL" ]; then
  make_library >"$HOME_DIR/make.log" 2>&1 || { echo "the RealSense library could not be made, see $HOME_DIR/make.log" >&2; exit 1; }
fi
echo "export PKG_CONFIG_PATH=$HOME_DIR\${PKG_CONFIG_PATH:+:\$PKG_CONFIG_PATH} LD_LIBRARY_PATH=$HOME_DIR/lib\${LD_LIBRARY_PATH:+:\$LD_LIBRARY_PATH}"
