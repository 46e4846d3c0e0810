# Everything a checkout needs: rustc with cargo (1.89 or newer), Python 3.11 or newer, make. `make` alone lists the targets.
#
# One cargo profile (release) and one target folder serve the package, the tests and the checks, because compiling the
# dependencies takes minutes. Nothing is done twice: the stamps in .venv say what is up to date.

PYTHON ?=
VENV   := .venv
BIN    := $(CURDIR)/$(VENV)/bin
TARGET := $(abspath $(or $(CARGO_TARGET_DIR),target))

# The wheel's sources: when one of them changes, the compiled module is built anew. Python files need nothing: the
# package is installed in place.
RUST_SOURCES := $(shell find rust -name '*.rs' -o -name Cargo.toml) Cargo.toml Cargo.lock pyproject.toml

# Tests run the optimised code with the assertions of our own crate switched on. The dependencies stay as they are, so
# that they are the ones already compiled for the package.
TEST_FLAGS := --release --locked --workspace --config profile.release.package.trackrs.debug-assertions=true

# maturin tells pyo3 about the interpreter through these; with other values pyo3 would be compiled again at every turn.
PYO3_ENV = PYO3_BUILD_EXTENSION_MODULE=1 PYO3_CONFIG_FILE=$(shell ls -t $(TARGET)/maturin/pyo3-config-*.txt | head -1)

.PHONY: help demo test test-rust test-python coverage lint quick bench docs soak clean
.NOTPARALLEL:

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "  make %-8s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

demo: $(VENV)/.package ## build, track the five harbour recordings, print the scores, leave tracks and pictures in out/
	$(BIN)/python examples/harbour.py

test: test-rust test-python ## cargo test, then pytest

# Neither half needs the other: a machine with two processors may run both at once.
test-rust: $(VENV)/.package
	cargo test $(TEST_FLAGS)

test-python: $(VENV)/.package $(VENV)/.dev
	$(BIN)/python -m pytest

# Branches are counted by an option that the compiler still calls unstable, hence RUSTC_BOOTSTRAP. What reads the counts is
# LLVM's own: rustup's component or, where that is not installed, a distribution's (19 and newer know the format).
coverage: $(VENV)/.pip ## branches of the core that the Rust tests reach; fails below 90 %
	@command -v cargo-llvm-cov > /dev/null || { echo 'make coverage needs cargo-llvm-cov, and it is not here: cargo install --locked cargo-llvm-cov@0.9.1' >&2; exit 1; }
	@tools="$$(rustc --print target-libdir)/../bin"; cov="$$tools/llvm-cov"; profdata="$$tools/llvm-profdata"; \
	for n in 19 20 21 22; do test -x "$$cov" || { cov=$$(command -v llvm-cov-$$n); profdata=$$(command -v llvm-profdata-$$n); }; done; \
	test -x "$$cov" && test -x "$$profdata" || { echo 'make coverage needs llvm-cov and llvm-profdata, and they are not here: rustup component add llvm-tools (Debian, Ubuntu: apt-get install llvm-19)' >&2; exit 1; }; \
	export RUSTC_BOOTSTRAP=1 TRACKRS_FUZZ_CASES=2000 LLVM_COV="$$cov" LLVM_PROFDATA="$$profdata"; \
	cargo llvm-cov --branch --json --output-path $(TARGET)/coverage.json --no-cfg-coverage --no-cfg-coverage-nightly --release --locked -p trackrs
	$(BIN)/python tests/core_coverage.py $(TARGET)/coverage.json

lint: quick docs ## formatting, clippy, rustdoc, ruff, mypy, stubs
	$(PYO3_ENV) cargo clippy --release --locked --workspace --all-targets -- -D warnings
	$(BIN)/python -m mypy
	$(BIN)/python -m mypy.stubtest --mypy-config-file pyproject.toml trackrs._trackrs

quick: $(VENV)/.dev ## the part of lint that takes seconds
	cargo fmt --all --check
	$(BIN)/ruff check
	$(BIN)/ruff format --check

bench: $(VENV)/.package ## side by side with peers into benchmarks/RESULTS.md; BENCH=folder of the peers' benchmark
	cargo bench --manifest-path benchmarks/core/Cargo.toml --target-dir $(TARGET)/benches
	$(BIN)/python benchmarks/run.py '$(BENCH)'

# Every entry of the fuzzing tests gets so many cases: ten million in all.
SOAK_CASES := 300000

soak: $(VENV)/.package $(VENV)/.dev ## a quarter of an hour of faults: 10 million cases, 1,000 kills, a day of 50 targets in clutter
	TRACKRS_FUZZ_CASES=$(SOAK_CASES) cargo test $(TEST_FLAGS) fuzz
	TRACKRS_FORKS=1000 $(BIN)/python -m pytest -q tests/test_boundary.py
	rm -rf out/kills && mkdir -p out/kills
	TRACKRS_KILLS=1000 $(BIN)/python tests/live_kills.py out/kills
	$(BIN)/python tests/soak.py

docs: $(VENV)/.package ## the Rust documentation, into target/doc
	$(PYO3_ENV) RUSTDOCFLAGS='-D warnings' cargo doc --release --locked --workspace --no-deps

clean: ## remove everything that was built
	rm -rf $(TARGET) $(VENV) out dist .pytest_cache .mypy_cache .ruff_cache .hypothesis python/trackrs/*.so
	find python tests examples -name __pycache__ -type d -exec rm -rf {} +

# --- the environment -------------------------------------------------------------------------------------------------

$(VENV)/.pip:
	@command -v cargo > /dev/null || { echo 'trackrs needs Rust 1.89 or newer, and there is no cargo here: install it with rustup' >&2; exit 1; }
	@python=; for p in $(or $(PYTHON),python3 python3.13 python3.12 python3.11); do \
	    if $$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2> /dev/null; then python=$$p; break; fi; done; \
	if test -z "$$python"; then \
	    echo 'trackrs needs Python 3.11 or newer, and $(or $(PYTHON),python3) is not: name one with make PYTHON=/path/to/python' >&2; exit 1; \
	elif $$python -c 'import venv, ensurepip' 2> /dev/null; then \
	    $$python -m venv $(VENV); \
	elif $$python -c 'import venv, pip' 2> /dev/null; then \
	    $$python -m venv --without-pip $(VENV) && $$python -m pip -q --python $(BIN)/python install pip; \
	else \
	    echo "$$python cannot make virtual environments: install its venv package (Debian, Ubuntu: apt-get install python3-venv)" >&2; exit 1; \
	fi
	$(BIN)/python -m pip -q install pip==26.3
	@touch $@

$(VENV)/.run: $(VENV)/.pip pyproject.toml
	$(BIN)/python -m pip -q install --group run
	@touch $@

$(VENV)/.package: $(VENV)/.run $(RUST_SOURCES)
	VIRTUAL_ENV=$(CURDIR)/$(VENV) PIP_QUIET=1 $(BIN)/maturin develop --release --group run
	@touch $@

$(VENV)/.dev: $(VENV)/.pip pyproject.toml
	$(BIN)/python -m pip -q install --group dev
	@touch $@
