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

# What `make lock` wrote: every file that pip fetches is held to its hash. Wheels alone, so that no
# package's own build runs, for what that would fetch is locked nowhere; but for those in BUILD.
PIP := $(BIN)/pip --quiet --disable-pip-version-check
locked = $(PIP) install --require-hashes --only-binary :all: $(BUILD:%=--no-binary %) $(1:%=-r locks/%.txt)

# Programs that read what sixlight writes, for the tests in a browser alone.
NPM_PACKAGES := three@0.187.0 ktx-parse@2.0.0

define CHROMIUM_INSTALL
if [ "$$(id -u)" = 0 ] && command -v apt-get > /dev/null; then \
	apt-get update -qq && \
	DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends chromium > /dev/null; \
else \
	echo "There is no Chromium; the tests in a browser are skipped. To install it:"; \
	echo "    sudo apt-get install chromium"; \
fi
endef

.DEFAULT_GOAL := help

help:  ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-14s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup: $(STAMP)  ## virtual environment, the package, OpenGL

$(STAMP): pyproject.toml locks/run.txt locks/dev.txt locks/simulate.txt
	$(PYTHON) -m venv $(VENV)
	$(call locked,run dev simulate)
	$(PIP) install --no-deps --no-build-isolation -e .
	@$(LIBRARIES_FOUND) || $(LIBRARIES_INSTALL)
	@$(BIN)/python -m pipeline.compiling
	@touch $@

$(VENV)/.with-%: locks/%.txt | $(STAMP)
	$(call locked,run $*)
	@touch $@

envmap: $(STAMP)  ## raw brackets to six-channel cubemaps: CAPTURE=dir [OUT=dir]
	@$(BIN)/sixlight envmap "$(or $(CAPTURE),$(error say which: make envmap CAPTURE=dir))" $(OUT_OPTION)

batch: $(STAMP)  ## all captures below folders, side by side: DIR="dir ..." [OUT=dir] [JOBS=n]
	@$(BIN)/sixlight batch $(or $(DIR),$(error say which: make batch DIR=dir)) $(OUT_OPTION) $(if $(JOBS),--jobs $(JOBS))

fit: $(STAMP)  ## M_S from chart photographs and spectra: CALIBRATION=dir [OUT=file]
	@$(BIN)/sixlight fit "$(or $(CALIBRATION),$(error say which: make fit CALIBRATION=dir))" $(OUT_OPTION)

preview: $(STAMP)  ## render a finished map: ENVMAP=dir
	@$(BIN)/sixlight preview "$(or $(ENVMAP),$(error say which: make preview ENVMAP=dir))"

view: $(STAMP)  ## a page that renders a finished map live: ENVMAP=dir
	@$(BIN)/sixlight view "$(or $(ENVMAP),$(error say which: make view ENVMAP=dir))"

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
	@$(BIN)/python -m pytest -n auto --dist loadfile -m "not slow" --ignore tests/browser

test-slow: $(STAMP)  ## the tests that take long
	@$(BIN)/python -m pytest -n auto --dist loadgroup -m slow --durations 12 --ignore tests/browser

test-browser: $(STAMP) $(VENV)/.with-browser  ## the tests in a headless Chromium; screenshots in build/browser
	@{ command -v chromium || command -v google-chrome; } > /dev/null || $(CHROMIUM_INSTALL)
	@test -d build/browser/node_modules/three || ! command -v npm > /dev/null || \
		npm install --silent --no-save --no-audit --no-fund --prefix build/browser $(NPM_PACKAGES)
	@$(BIN)/python -m pytest tests/browser

test-cluster: $(STAMP) $(VENV)/.with-cluster  ## the tests with a Dask cluster, and of captures by URL
	@$(BIN)/python -m pytest -n auto --dist loadfile tests/test_cluster.py tests/test_remote.py tests/test_storage.py

docs: $(STAMP) $(VENV)/.with-docs  ## the documentation as pages, in build/site; a broken link is an error
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --strict
	@echo build/site/index.html

lint: $(STAMP)  ## ruff and mypy
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy

lock: $(STAMP) $(VENV)/.with-supply  ## dependencies locked anew, with hashes and licences: [UPGRADE=1]
	@$(BIN)/python -m supply.lock $(if $(UPGRADE),--upgrade)

sbom: $(STAMP)  ## a bill of materials of all that is locked, CycloneDX, in build/sbom.json
	@$(BIN)/python -m supply.sbom

audit: $(STAMP) $(VENV)/.with-supply  ## known vulnerabilities of all that is locked: [OSV=url]
	@$(BIN)/python -m supply.audit $(if $(OSV),--osv "$(OSV)")

clean:  ## remove results and caches, keep the environment
	rm -rf build dist .mypy_cache .pytest_cache .ruff_cache

.PHONY: help setup envmap batch fit preview view tables figures sample check-sample bench test test-slow test-browser test-cluster docs lint lock sbom audit clean
