# Every target sets up what it needs in .venv; only Python 3.11 and make have to be installed.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PORTAL := api/portal
READERS := tests/e2e/readers
LINTER := tests/api/linter
GENERATORS := tests/e2e/generators
CLIENT := clients/typescript
BLENDER := .venv-blender
LITERT := .venv-litert
PEERS := .venv-peers
SPEED := .venv-speed
UFBX := .venv-ufbx
WEBSITE := website

# Tests start many programs, which load what the first of them has compiled.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.PHONY: help setup docs demo demo-files serve browser ffmpeg readers clients generators linter test-data test test-slow test-shapes verify-exports verify-converters verify-calibration verify-speed verify-accuracy verify-containers soak load hostile check benchmark format lock clean blender-extension wheel

help:  ## List the targets
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 12

PIP_INSTALL := $(BIN)/python -P -m pip install --quiet --disable-pip-version-check --no-compile --no-deps

# The kernels are compiled by one processor, as soon as the service's own packages are there; all others, npm's and files
# come meanwhile. Python compiles modules when they are loaded: most of them never are.
AT_ONCE := @$(MAKE) --no-print-directory --jobs 3 $(VENV)/.installed $(VENV)/.compiled $(PORTAL)/vendor/.installed

setup:  ## Install all dependencies, pinned and checked by hash, into .venv
	$(AT_ONCE)

$(VENV)/.service: requirements.lock docker/requirements.lock
	$(PYTHON) -m venv --clear $(VENV)
	$(PIP_INSTALL) --require-hashes --only-binary :all: -r docker/requirements.lock
	touch $@

$(VENV)/.installed: $(VENV)/.service pyproject.toml
	$(PIP_INSTALL) --require-hashes --only-binary :all: --no-binary bvh-converter -r requirements.lock
	$(PIP_INSTALL) --no-build-isolation --editable .
	touch $@

# Sources of the compiled kernels: after a `git pull` that changes them the kernels are compiled here, before anything is
# started. It takes a moment if nothing has changed.
KERNELS := $(wildcard pipeline/core/data/*.py) pipeline/core/runtime/jit.py pipeline/run/warm_up.py \
	$(foreach folder,$(sort $(dir $(wildcard pipeline/*/*kernels.py pipeline/*/*/*kernels.py pipeline/*/*/*/*kernels.py))),$(wildcard $(folder)*.py))

$(VENV)/.compiled: $(VENV)/.service $(KERNELS)
	@echo "Compiling the numeric kernels; the first time takes two or three minutes."
	PYTHONPATH="$(CURDIR)" $(BIN)/python -P -m pipeline.run.warm_up
	touch $@

# Reports hold a bundle of the viewer.
$(PORTAL)/vendor/.installed: $(PORTAL)/package-lock.json $(PORTAL)/vendor.mjs $(shell find $(PORTAL)/viewer -type f) $(VENV)/.installed
	@$(BIN)/npm ci --prefix $(PORTAL) --silent --no-audit --no-fund && touch $@ \
		|| echo "npm's packages can't be installed here: the page at / shows how to install them, and reports have no 3D view; the rest works."

demo:  ## Start the service, send a real four-camera capture, write the results to demo-output/
	$(AT_ONCE) demo-files
	$(BIN)/multicap demo

# The networks of the default profile; `multicap demo` installs whatever else it needs.
demo-files: $(VENV)/.installed
	$(BIN)/multicap models install movenet-multipose-int8 blazepose-full
	$(BIN)/multicap bodies install
	$(BIN)/multicap samples install

serve: setup  ## Run the service at http://127.0.0.1:8000 until Ctrl-C
	$(BIN)/multicap models install
	$(BIN)/multicap models install openpose-mobilenet-thin
	$(BIN)/multicap bodies install
	$(BIN)/multicap opensim install
	@$(MAKE) --no-print-directory docs || echo "The documentation can't be built here: the page lacks its help; the rest works."
	$(BIN)/multicap serve

browser:  ## Install Chromium for the tests of the page (as root, on Debian)
	@command -v chromium google-chrome >/dev/null || { [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null \
		&& apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends chromium >/dev/null; } \
		|| echo "Chromium is not installed and can't be installed here: the tests of the page are skipped."

ffmpeg:  ## Install the program ffmpeg for the tests of its files (as root, on Debian)
	@command -v ffmpeg >/dev/null || { [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null \
		&& apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends ffmpeg >/dev/null; } \
		|| echo "ffmpeg is not installed and can't be installed here: the tests of its files are skipped."

readers: $(READERS)/node_modules/.installed  ## Install three.js, the glTF validator and tus-js-client for the tests

$(READERS)/node_modules/.installed: $(READERS)/package-lock.json $(VENV)/.installed
	@mkdir -p $(@D)
	@$(BIN)/npm ci --prefix $(READERS) --silent --no-audit --no-fund && mkdir -p $(@D) && touch $@ \
		|| echo "npm's packages can't be installed here: tests with three.js, the glTF validator or tus-js-client are skipped."

clients: $(CLIENT)/dist/.built  ## Build the client for npm into build/

$(CLIENT)/node_modules/.installed: $(CLIENT)/package-lock.json $(VENV)/.installed
	@mkdir -p $(@D)
	@$(BIN)/npm ci --prefix $(CLIENT) --silent --no-audit --no-fund && mkdir -p $(@D) && touch $@ \
		|| echo "npm's packages can't be installed here: the client for npm is not built, and its tests are skipped."

$(CLIENT)/dist/.built: $(CLIENT)/node_modules/.installed openapi/openapi.json $(filter-out %/contract.ts,$(wildcard $(CLIENT)/*.* $(CLIENT)/src/*))
	@test ! -e $< || { mkdir -p build && $(BIN)/node $(CLIENT)/build.mjs \
		&& $(BIN)/npm pack ./$(CLIENT) --silent --pack-destination build && touch $@; }

generators: $(GENERATORS)/node_modules/.installed  ## Install generators of TypeScript clients for the tests

$(GENERATORS)/node_modules/.installed: $(GENERATORS)/package-lock.json $(VENV)/.installed
	@mkdir -p $(@D)
	@$(BIN)/npm ci --prefix $(GENERATORS) --silent --no-audit --no-fund && mkdir -p $(@D) && touch $@ \
		|| echo "npm's packages can't be installed here: tests with generated TypeScript clients are skipped."

linter: $(LINTER)/node_modules/.installed  ## Install the linter of the OpenAPI contract

$(LINTER)/node_modules/.installed: $(LINTER)/package-lock.json $(VENV)/.installed
	@mkdir -p $(@D)
	@$(BIN)/npm ci --prefix $(LINTER) --silent --no-audit --no-fund && mkdir -p $(@D) && touch $@ \
		|| echo "npm's packages can't be installed here: the API's contract is not linted."

$(BLENDER)/.installed: $(READERS)/blender.lock
	@test "$$(id -u)" != 0 || ! command -v apt-get >/dev/null || { apt-get update -qq && DEBIAN_FRONTEND=noninteractive \
		apt-get install -qq -y --no-install-recommends libx11-6 libxrender1 libxfixes3 libxi6 libxkbcommon0 libsm6 \
		libgl1 >/dev/null; }
	$(PYTHON) -m venv --clear $(BLENDER)
	$(BLENDER)/bin/python -P -m pip install --quiet --disable-pip-version-check --require-hashes --no-deps \
		--only-binary :all: -r $<
	touch $@

# It is compiled here, for five minutes, and longer with more optimization.
$(UFBX)/.installed: $(READERS)/ufbx.lock
	$(PYTHON) -m venv --clear $(UFBX)
	CFLAGS=-O1 $(UFBX)/bin/python -P -m pip install --quiet --disable-pip-version-check --require-hashes --no-deps \
		--only-binary :all: --no-binary pufbx -r $<
	touch $@

verify-exports: setup readers $(BLENDER)/.installed $(UFBX)/.installed $(PEERS)/.installed  ## Open exports in Blender (installs 2 GB), three.js, aniposelib and other software; try the extension
	$(BIN)/multicap models install
	$(BIN)/multicap samples install
	$(BIN)/multicap bodies install
	$(BIN)/multicap opensim install
	MULTICAP_PICTURES=build/exports $(BIN)/python -P -m pytest -m "not benchmark" tests/e2e/test_exports.py tests/e2e/test_between_frames.py tests/e2e/test_blender_extension.py \
		tests/pipeline/export tests/api/blender tests/pipeline/calibration/test_programs.py
	@echo "Blender's pictures are in build/exports/."

wheel: docs  ## Build the wheel into dist/
	$(BIN)/python -P -m hatchling build -t wheel -d dist

docs: api/portal/help/topics.json  ## Build the site of the documentation, which the service serves at /help, into api/portal/help/

$(WEBSITE)/node_modules/.installed: $(WEBSITE)/package-lock.json $(VENV)/.installed
	$(PIP_INSTALL) --require-hashes --only-binary :all: -r $(WEBSITE)/requirements.lock
	$(BIN)/npm ci --prefix $(WEBSITE) --silent --no-audit --no-fund
	touch $@

# Broken links and pages that stand nowhere in the navigation are errors.
api/portal/help/topics.json: $(WEBSITE)/node_modules/.installed openapi/openapi.json \
		$(shell find docs $(WEBSITE) api multicap pipeline worker -name node_modules -prune -o -name help -prune -o -name __pycache__ -prune -o -type f -name '*.[mpy]*' -print)
	$(BIN)/python -P -m website.pages
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -P -m mkdocs build --config-file $(WEBSITE)/mkdocs.yml

blender-extension: $(VENV)/.installed  ## Build the extension for Blender into build/
	$(BIN)/python -P -m api.blender.build build

$(LITERT)/.installed: tests/pipeline/detection/conversion/litert/litert.lock
	$(PYTHON) -m venv --clear $(LITERT)
	$(LITERT)/bin/python -P -m pip install --quiet --disable-pip-version-check --require-hashes --no-deps \
		--only-binary :all: -r $<
	touch $@

verify-converters: setup $(LITERT)/.installed  ## Compare converted networks with LiteRT (installs 160 MB)
	$(BIN)/multicap models install movenet-multipose
	$(BIN)/multicap samples install
	$(BIN)/python -P -m pytest tests/pipeline/detection/conversion/test_litert.py

$(PEERS)/.installed: tests/pipeline/calibration/board/peers/peers.lock
	$(PYTHON) -m venv --clear $(PEERS)
	$(PEERS)/bin/python -P -m pip install --quiet --disable-pip-version-check --require-hashes --no-deps \
		--only-binary :all: -r $<
	touch $@

verify-calibration: setup $(PEERS)/.installed  ## Compare calibration from a board with aniposelib and Caliscope
	$(BIN)/python -P -m pytest -s tests/pipeline/calibration/board/test_peers.py

$(SPEED)/.installed: tests/pipeline/speed/peers/speed.lock
	$(PYTHON) -m venv --clear $(SPEED)
	$(SPEED)/bin/python -P -m pip install --quiet --disable-pip-version-check --require-hashes --no-deps \
		--only-binary :all: -r $<
	touch $@

verify-speed: setup $(SPEED)/.installed $(PEERS)/.installed  ## Compare speed and error with aniposelib, Pose2Sim and MediaPipe by turns (installs 2.1 GB); DATA=FOLDER of rendered people
	MULTICAP_RENDERED=$(abspath $(DATA)) $(BIN)/python -P -m pytest -s tests/pipeline/speed

verify-containers:  ## Bring both compose files up by podman, with kills, an upgrade and a restore (as root, on Debian; 10 GB)
	bash docker/verify/containers.sh

test-data: setup
	$(BIN)/multicap models install
	$(BIN)/multicap models install openpose-mobilenet-thin
	$(BIN)/multicap bodies install
	$(BIN)/multicap opensim install
	$(BIN)/multicap samples install

# More processes than processors: many tests wait. Threads of linear algebra would only wait for each other there. A test
# that hangs fails after a quarter of an hour.
PYTEST := OPENBLAS_NUM_THREADS=1 $(BIN)/python -P -m pytest -n 4 --dist loadgroup --no-loadscope-reorder \
	--timeout 900 --durations 40 --durations-min 5
DESELECTED := not benchmark and not blender and not soak and not hostile and not load and not accuracy

test: test-data browser ffmpeg readers docs  ## Run the tests, but for the slow ones (7 to 22 minutes)
	$(PYTEST) -m "$(DESELECTED) and not slow"

test-slow: test-data browser ffmpeg readers clients docs  ## Run the slow tests
	$(PYTEST) -m "$(DESELECTED) and slow and not real_time"
	$(PYTEST) -n 0 -m "real_time and slow" tests/e2e

verify-accuracy: test-data browser  ## Measure the accuracies that the documentation states again, of which the slow tests have a case or two
	$(PYTEST) -m accuracy tests/pipeline tests/e2e

test-shapes: test-data ffmpeg readers  ## Run the tests of the pipeline again, with shapes and types of all calls checked
	MULTICAP_CHECK_SHAPES=1 $(PYTEST) -m "$(DESELECTED) and not slow" tests/pipeline

soak: setup browser  ## Run 200 jobs disturbed by faults, 100 rounds of 20 jobs under outages, 200 jobs on a disturbed cluster (three hours), and a form whose requests wait
	$(BIN)/multicap samples install
	$(BIN)/python -P -m pytest -s -m soak tests/faults tests/e2e

load: setup  ## Time lists beside 100,000 jobs, and run 1,000 jobs of ten tenants on four workers (half an hour)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -P -m pytest -s -m load tests/load

hostile: setup  ## Send 6,000 damaged and malicious sessions to a service (an hour)
	$(BIN)/multicap models install
	$(BIN)/python -P -m pytest -s -m hostile tests/hostile

check: setup linter  ## Run everything that CI runs: format, lint, types, imports, API contract, Dockerfiles, tests
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	@test ! -e $(LINTER)/node_modules/.installed || REDOCLY_SUPPRESS_UPDATE_NOTICE=true $(BIN)/node \
		$(LINTER)/node_modules/@redocly/cli/bin/cli.js lint --config openapi/redocly.yaml openapi/openapi.json
	$(BIN)/hadolint docker/*.Dockerfile
	$(MAKE) test

benchmark: setup  ## Measure speed and memory of the pipeline and the service (on a quiet machine)
	$(BIN)/multicap benchmark all
	$(BIN)/multicap benchmark pipeline
	$(BIN)/python -P -m tests.benchmarks service
	$(BIN)/python -P -m pytest -m benchmark

format: setup  ## Format the code and apply automatic fixes
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

LOCK := uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-header --no-annotate \
	--no-emit-index-url --no-emit-find-links

lock:  ## Pin the dependencies again (needs uv)
	$(LOCK) --extra dev --extra evaluation --extra lsl --extra notebook --extra opensim --extra openvino --extra rerun --extra usd --output-file requirements.lock pyproject.toml
	$(LOCK) --constraint requirements.lock --output-file docker/requirements.lock pyproject.toml
	$(LOCK) --constraint requirements.lock --extra docs --output-file $(WEBSITE)/requirements.lock pyproject.toml

clean:  ## Remove everything that the targets made
	git clean -Xfq docs
	rm -rf $(VENV) $(BLENDER) $(LITERT) $(PEERS) $(SPEED) $(UFBX) $(PORTAL)/node_modules $(PORTAL)/vendor pipeline/export/report/assets/viewer.* $(READERS)/node_modules $(GENERATORS)/node_modules $(CLIENT)/node_modules $(CLIENT)/dist $(LINTER)/node_modules $(WEBSITE)/node_modules api/portal/help build demo-output .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
