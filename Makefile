# Plumb. `make demo` shows it, `make test` checks it; both install what they need on a Debian machine that has Rust.

.PHONY: build demo test forget fetch lint examples audit rust-test device-build device-run device-test \
	realsense-build realsense-test python-test page-test fuzz torture elsewhere deb
.DEFAULT_GOAL := build

VENV := target/venv
PACKAGES := tests/setup/system-packages
# The one build of all tests, and of the binary they run: a plain `cargo build` would take other features and build it again.
# ROS 2 is tested too, although it is not built unless asked for.
FEATURES := --features ros2,nokhwa
TESTED := cargo test $(FEATURES) --lib --bins --tests
# Before a command that builds or runs with Intel's library.
WITH_REALSENSE = export PATH="$(CURDIR)/$(VENV)/bin:$$PATH" && \
	environment="$$(tests/device/realsense_library.sh)" && eval "$$environment" &&

build:
	$(PACKAGES) build
	cargo build --release

# The daemon on the bundled recording, a calibration over HTTP, and the live page until Ctrl-C.
demo:
	$(PACKAGES) build demo
	cargo build --release
	/usr/bin/python3 demo/calibrate.py target/release/plumb

# Everything that must hold. One build serves the unit tests, the system tests, and the checks that run the same binary.
# What is fetched comes while clippy computes, and builds that serve one check alone compute while the
# small machine mostly waits. At the end it prints what this machine did not let it check.
test: NOT_TESTED := target/tmp/not-tested
test: forget
	$(PACKAGES) build
	$(MAKE) --jobs=2 fetch lint
	$(MAKE) rust-test examples python-test page-test device-build
	$(MAKE) --jobs=2 device-run realsense-build elsewhere
	$(MAKE) realsense-test
	@if [ -s $(NOT_TESTED) ]; then echo "NOT TESTED ON THIS MACHINE:"; sort -u $(NOT_TESTED); else echo "all was tested"; fi

forget:
	@rm -f target/tmp/not-tested

# What tests need from elsewhere: Debian's packages, Python's, a kernel. The tests themselves say what
# could not be had.
fetch: $(VENV)/installed
	-tests/device/small_machine.sh prepare
	-$(WITH_REALSENSE) true

rust-test:
	$(PACKAGES) build test
	$(TESTED) --no-run
	timeout --kill-after=10 1200 $(TESTED)
	timeout --kill-after=10 300 cargo test $(FEATURES) --doc

# Each example, built and run; `tests/python/test_client.py` runs the one in Python.
examples:
	$(PACKAGES) build
	cargo build $(FEATURES) --examples
	timeout --kill-after=10 60 cargo run $(FEATURES) --quiet --example find_board -- examples/board.jpg 9x6
	timeout --kill-after=10 60 cargo run $(FEATURES) --quiet --example solve_correspondences
	timeout --kill-after=10 60 cargo run $(FEATURES) --quiet --example relative_pose
	timeout --kill-after=10 60 cargo run $(FEATURES) --quiet --example frame_source

# What other programs read from Plumb: OpenCV, mrcal, a YAML parser, the Python readers of recordings, DDS.
python-test: $(VENV)/installed
	$(TESTED) --no-run
	cargo build $(FEATURES) --example relative_pose
	PLUMB=target/debug/plumb timeout --kill-after=10 400 $(VENV)/bin/python -m pytest -q -rs -n 2 tests/python

# The live page, driven in a real browser.
page-test: $(VENV)/installed
	$(TESTED) --no-run
	PLUMB=target/debug/plumb timeout --kill-after=10 600 $(VENV)/bin/python -m pytest -q -rs tests/page

# Real cameras: a small machine with a real V4L2 stack. Says so where none can be made.
device-test: device-build
	$(MAKE) device-run

# The tests' own program, so that no cargo waits for another one's build.
DEVICE_TEST := target/tmp/device-test
device-build:
	$(PACKAGES) build test
	mkdir -p $(dir $(DEVICE_TEST))
	cargo test $(FEATURES) --test device --no-run --message-format=json-render-diagnostics | \
		sed -n 's|.*"executable":"\([^"]*/device-[^"]*\)".*|\1|p' > $(DEVICE_TEST)
	test -s $(DEVICE_TEST)

device-run:
	timeout --kill-after=10 900 "$$(cat $(DEVICE_TEST))"

# The RealSense library itself, on recordings: a real one, and one that it makes. With the features of
# the other tests, so that their dependencies serve; Plumb, built for this alone, at level 1: without
# optimization its session searches too few of the frames that the library gives. It is built at the
# lowest priority, as what `elsewhere` checks: the small machine's tests beside them have limits of time.
REALSENSE := cargo test $(FEATURES),realsense --config profile.dev.package.plumb.opt-level=1 --test realsense
realsense-build: $(VENV)/installed
	$(WITH_REALSENSE) nice -n 19 $(REALSENSE) --no-run

realsense-test: realsense-build
	$(WITH_REALSENSE) timeout --kill-after=10 600 $(REALSENSE)

# Coverage-guided fuzzing of everything that is read, for so many seconds; see tests/fuzz/README.md.
SECONDS ?= 600
fuzz:
	$(PACKAGES) build
	tests/fuzz/run $(SECONDS)

# Every fault at every moment, on this machine alone: the table of docs/reliability.md, in ten minutes or so.
torture: $(VENV)/installed
	$(TESTED) --no-run
	PLUMB=target/debug/plumb timeout --kill-after=10 1800 $(VENV)/bin/python tests/torture/torture.py

# That it compiles for macOS and Windows; says so where rustup cannot get their standard libraries.
elsewhere:
	$(PACKAGES) build
	nice -n 19 tests/setup/check-elsewhere

# A Debian package with the systemd unit; installs cargo-deb.
deb:
	$(PACKAGES) build
	cargo deb --version >/dev/null 2>&1 || cargo install --locked cargo-deb
	packaging/third-party-notices > target/THIRD-PARTY-NOTICES
	cargo deb --strip

# Format, clippy and documentation: no warning is accepted.
lint:
	$(PACKAGES) build
	cargo fmt --check
	cargo clippy $(FEATURES) --all-targets -- -D warnings
	RUSTDOCFLAGS=-Dwarnings cargo doc $(FEATURES) --no-deps

# Licenses, advisories, bans and sources of all dependencies; installs cargo-deny, which takes minutes.
audit:
	cargo deny --version >/dev/null 2>&1 || cargo install --locked cargo-deny
	cargo deny check

$(VENV)/installed: tests/python/requirements.txt
	$(PACKAGES) test
	/usr/bin/python3 -m venv $(VENV)
	$(VENV)/bin/pip install --quiet --disable-pip-version-check --requirement $<
	touch $@
