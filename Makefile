# `make help` lists the targets. Two work on a fresh machine with nothing set up:
#   make envmap CAPTURE=sample_captures/room
#   make test

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.ready
OUT_OPTION = $(if $(OUT),-o "$(OUT)")

# OpenGL without a screen: EGL, and Mesa's software renderer where there is no GPU; and a library
# that Mitsuba, which simulates captures, takes for granted.
LIBRARIES := libegl1 libgl1 libgl1-mesa-dri libatomic1
LIBRARIES_FOUND = /sbin/ldconfig -p | grep -q 'libEGL\.so\.1' && /sbin/ldconfig -p | grep -q 'libEGL_.*\.so' && /sbin/ldconfig -p | grep -q libatomic
define LIBRARIES_INSTALL
if [ "$$(id -u)" = 0 ] && command -v apt-get > /dev/null; then \
	apt-get update -qq && \
	DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $(LIBRARIES) > /dev/null; \
else \
	echo "OpenGL is missing; everything but the previews works without it. To install it:"; \
	echo "    sudo apt-get install $(LIBRARIES)"; \
fi
endef

.DEFAULT_GOAL := help

help:  ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-14s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup: $(STAMP)  ## virtual environment, the package, OpenGL

$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[dev,plots,simulate]"
	@$(LIBRARIES_FOUND) || $(LIBRARIES_INSTALL)
	@touch $@

envmap: $(STAMP)  ## raw brackets to six-channel cubemaps: CAPTURE=dir [OUT=dir]
	@$(BIN)/sixlight envmap "$(or $(CAPTURE),$(error say which: make envmap CAPTURE=dir))" $(OUT_OPTION)

fit: $(STAMP)  ## M_S from chart photographs and spectra: CALIBRATION=dir [OUT=file]
	@$(BIN)/sixlight fit "$(or $(CALIBRATION),$(error say which: make fit CALIBRATION=dir))" $(OUT_OPTION)

preview: $(STAMP)  ## render a finished map: ENVMAP=dir
	@$(BIN)/sixlight preview "$(or $(ENVMAP),$(error say which: make preview ENVMAP=dir))"

tables: $(STAMP)  ## the paper's tables beside ours, and those past it; pictures in build/tables
	@$(BIN)/sixlight evaluate --pictures build/tables

figures: $(STAMP)  ## the paper's figures, maps of errors, and docs/figures.md: [ONLY=name]
	@$(BIN)/sixlight envmap sample_captures/room --quiet > /dev/null
	@$(BIN)/python -m benchmarks.figures $(if $(ONLY),--only $(ONLY))

sample: $(STAMP)  ## render the bundled capture anew, ten minutes: [OUT=dir]
	@$(BIN)/sixlight simulate room -o "$(or $(OUT),build/sample_room)"

check-sample: $(STAMP)  ## compare the bundled capture's result with its truth
	@$(BIN)/sixlight envmap sample_captures/room --quiet > /dev/null
	@$(BIN)/python -m benchmarks.check_sample

bench: $(STAMP)  ## benchmarks, a table and build/bench/NAME.json: [ONLY=name]
	@$(BIN)/python -m benchmarks $(ONLY)

test: $(STAMP)  ## the tests
	@$(BIN)/python -m pytest -n auto --dist loadfile -m "not slow"

test-slow: $(STAMP)  ## the tests that take long
	@$(BIN)/python -m pytest -n auto --dist load -m slow

lint: $(STAMP)  ## ruff and mypy
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy

clean:  ## remove results and caches, keep the environment
	rm -rf build dist .mypy_cache .pytest_cache .ruff_cache

.PHONY: help setup envmap fit preview tables figures sample check-sample bench test test-slow lint clean
