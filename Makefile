# `make test` and `make lint` need only a C compiler, Rust and Python >= 3.10 with venv; everything
# else goes into .venv, .cache and target.

PYTHON ?= python3
VENV := $(CURDIR)/.venv
WHEELS := $(CURDIR)/.cache/wheels
# Always the whole workspace: with fewer packages, Cargo chooses other features of the dependencies and
# compiles them again.
CARGO_TEST_FLAGS ?= --workspace
PYTEST_FLAGS ?=

# The HDF5 library's build needs a CMake that not every distribution has: it finds the one in .venv.
export PATH := $(VENV)/bin:$(PATH)

.PHONY: build demo test test-faults test-readers test-maniskill lint format schema clean

# Installs the command and the Python package into .venv.
build: $(VENV)/.tools
	rm -rf $(WHEELS)
	maturin build --quiet --release --interpreter $(VENV)/bin/python --out $(WHEELS)
	pip install --quiet --disable-pip-version-check --force-reinstall --no-deps $(WHEELS)/*.whl
	pip install --quiet --disable-pip-version-check "$$(echo $(WHEELS)/*.whl)"

# Everything once, on built-in inputs: a kitchen is generated, TIAGo opens three things in it, and a page shows
# what came of it.
DEMO ?= akrobat-demo
demo: build
	pip install --quiet --disable-pip-version-check "$$(echo $(WHEELS)/*.whl)[demo]"
	rm -rf $(DEMO)
	$(VENV)/bin/akrobat demo --output $(DEMO)

# All tests, Rust and Python, with a private software Vulkan driver where the machine has none.
test: build
	pip install --quiet --disable-pip-version-check "$$(echo $(WHEELS)/*.whl)[export,physics,sapien,test,video]"
	environment="$$(scripts/vulkan.sh)" && eval "$$environment" && \
	    cargo test --release $(CARGO_TEST_FLAGS) && \
	    AKROBAT_SAMPLE_DATASET=$(CURDIR)/target/release/examples/sample_dataset pytest $(PYTEST_FLAGS)

# A hundred runs killed at random instants, full and read-only disks, killed Ray workers: every dataset is the one that
# an undisturbed run writes. Some 4 minutes of two idle cores.
test-faults: build
	pip install --quiet --disable-pip-version-check "$$(echo $(WHEELS)/*.whl)[ray,test]"
	pytest -m slow tests/python/test_faults.py

# Reads exports of 20 real episodes with LeRobot, robomimic, PyTorch and zarr themselves, trains policies a little and
# tries them in closed loop: 5 GB of packages and some 20 minutes, so not part of `make test`. LeRobot needs Python 3.12.
PYTHON312 ?= $(shell scripts/python312.sh)
READERS := $(CURDIR)/.cache/readers
EXPORTS ?= $(CURDIR)/.cache/exports
test-readers: build
	pip install --quiet --disable-pip-version-check "$$(echo $(WHEELS)/*.whl)[demo,export]"
	test -x $(READERS)/bin/python || "$(PYTHON312)" -m venv $(READERS)
	$(READERS)/bin/pip install --quiet --disable-pip-version-check -r tests/readers/requirements.txt
	$(READERS)/bin/pip install --quiet --disable-pip-version-check --no-deps lerobot-doctor==0.2.0 robomimic==0.3.0
	$(READERS)/bin/pip install --quiet --disable-pip-version-check "$$(echo $(WHEELS)/*.whl)[physics]"
	$(READERS)/bin/pip install --quiet --disable-pip-version-check --force-reinstall --no-deps $(WHEELS)/*.whl
	$(VENV)/bin/python tests/readers/make_exports.py $(EXPORTS)
	AKROBAT_EXPORTS=$(EXPORTS) HF_HUB_OFFLINE=1 $(READERS)/bin/python -m pytest tests/readers

# ManiSkill's own tools, unmodified, replay an export, and the first policy is trained a little and tried: 6.5 GB of
# packages (PyTorch brings its CUDA libraries), so not part of `make test`.
MANISKILL := $(CURDIR)/.cache/maniskill
test-maniskill: build
	test -x $(MANISKILL)/bin/python || $(PYTHON) -m venv $(MANISKILL)
	$(MANISKILL)/bin/pip install --quiet --disable-pip-version-check 'pytest>=8' 'example-robot-data>=4.2' \
	    "$$(echo $(WHEELS)/*.whl)[maniskill,physics,policy]"
	$(MANISKILL)/bin/pip install --quiet --disable-pip-version-check --force-reinstall --no-deps $(WHEELS)/*.whl
	environment="$$(scripts/vulkan.sh)" && eval "$$environment" && \
	    $(MANISKILL)/bin/python -m pytest tests/maniskill

lint: $(VENV)/.tools
	cargo fmt --all --check
	cargo clippy --quiet --release --workspace --all-targets -- -D warnings
	judge/check_independence.sh
	ruff format --check python tests benchmarks
	ruff check python tests benchmarks

format: $(VENV)/.tools
	cargo fmt --all
	ruff format python tests benchmarks
	ruff check --fix python tests benchmarks

# Regenerates the JSON Schemas; a test fails where they are out of date.
schema: build
	$(VENV)/bin/akrobat schema --write schema

$(VENV)/.tools: pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit("Python 3.10 or newer is needed") if sys.version_info < (3, 10) else None'
	test -x $(VENV)/bin/python || $(PYTHON) -m venv $(VENV)
	pip install --quiet --disable-pip-version-check 'cmake>=3.26' 'maturin>=1.9.4,<2' 'ruff==0.17.6'
	touch $@

clean:
	rm -rf $(VENV) .cache target akrobat-demo
