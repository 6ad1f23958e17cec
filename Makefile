# Plumb. `make demo` shows it, `make test` checks it; both install what they need on a Debian machine that has Rust.

.PHONY: demo test lint rust-test python-test device-test build system-packages python
.DEFAULT_GOAL := build

VENV := target/venv
CARGO_TEST_SECONDS := 1200
PYTHON_TEST_SECONDS := 300
DEVICE_TEST_SECONDS := 600
export CARGO_TERM_COLOR ?= auto

build: system-packages
	cargo build --release

# Everything that must hold, in the order in which a failure is cheapest.
test: rust-test python-test device-test

# One build serves the unit tests, the system tests, and the Python checks that run the same binary.
rust-test: system-packages
	timeout --kill-after=10 $(CARGO_TEST_SECONDS) cargo test --all-targets
	timeout --kill-after=10 $(CARGO_TEST_SECONDS) cargo test --doc

# What other programs read from Plumb: OpenCV, mrcal, a YAML parser, the Python readers of recordings.
python-test: system-packages python
	cargo build
	PLUMB=target/debug/plumb timeout --kill-after=10 $(PYTHON_TEST_SECONDS) $(VENV)/bin/python -m pytest -q tests/python

# Real cameras: a small machine with a real V4L2 stack, and the RealSense library itself.
device-test: system-packages python
	timeout --kill-after=10 $(DEVICE_TEST_SECONDS) cargo test --test device
	export PATH="$(CURDIR)/$(VENV)/bin:$$PATH" && environment="$$(tests/device/realsense_library.sh)" && eval "$$environment" && \
	timeout --kill-after=10 $(DEVICE_TEST_SECONDS) cargo test --features realsense --test realsense

lint:
	cargo fmt --check
	cargo clippy --all-targets -- -D warnings

system-packages:
	@tests/setup/system-packages

python: $(VENV)/installed

$(VENV)/installed: tests/python/requirements.txt | system-packages
	/usr/bin/python3 -m venv $(VENV)
	$(VENV)/bin/pip install --quiet --disable-pip-version-check --requirement $<
	touch $@
