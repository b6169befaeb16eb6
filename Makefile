# Every target sets up what it needs in .venv; nothing else has to be installed but Python 3.11 and make.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READERS := tests/e2e/readers
LINTER := tests/api/linter
BLENDER := .venv-blender

.DEFAULT_GOAL := help
.PHONY: help setup demo serve browser readers linter test verify-exports soak hostile check benchmark format lock clean

help:  ## Say what there is
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 12

setup: $(VENV)/.compiled  ## Install everything, pinned and checked by hash, into .venv

$(VENV)/.installed: requirements.lock pyproject.toml
	$(PYTHON) -m venv --clear $(VENV)
	$(BIN)/python -P -m pip install --quiet --disable-pip-version-check --require-hashes --no-deps \
		--only-binary :all: --no-binary bvh-converter -r requirements.lock
	$(BIN)/python -P -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	touch $@

# Of kernels, and of all that is compiled into them: a `git pull` that changes them has them compiled anew here, before
# anything is started. It takes a moment where nothing has to be.
KERNELS := pipeline/compiled.py pipeline/warm_up.py $(foreach folder,$(sort $(dir $(wildcard pipeline/*/*kernels.py))),$(wildcard $(folder)*.py))

$(VENV)/.compiled: $(VENV)/.installed $(KERNELS)
	@echo "Compiling the numeric kernels; the first time takes about a minute."
	$(BIN)/python -P -m pipeline.warm_up
	touch $@

demo: setup  ## Start the service, send it a real four-camera capture, leave the results in demo-output/
	$(BIN)/multicap demo

serve: setup  ## Run the service on this machine until Ctrl-C
	$(BIN)/multicap models install movenet-multipose
	$(BIN)/multicap models install openpose-mobilenet-thin
	$(BIN)/multicap serve

browser:  ## Install Chromium for the tests of the page, where Debian's packages are at hand
	@command -v chromium google-chrome >/dev/null || { [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null \
		&& apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends chromium >/dev/null; } \
		|| echo "There is no Chromium, and it can't be installed here: the tests of the page are skipped."

readers: $(READERS)/node_modules/.installed  ## Install three.js, the glTF validator and tus-js-client for the tests

$(READERS)/node_modules/.installed: $(READERS)/package-lock.json $(VENV)/.installed
	@mkdir -p $(@D)
	@$(BIN)/npm ci --prefix $(READERS) --silent --no-audit --no-fund && mkdir -p $(@D) && touch $@ \
		|| echo "npm's packages can't be installed here: what needs three.js, the glTF validator or tus-js-client is skipped."

linter: $(LINTER)/node_modules/.installed  ## Install the linter of the API's contract

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

verify-exports: setup readers $(BLENDER)/.installed  ## Open exports in Blender (800 MB), three.js and other software
	$(BIN)/multicap models install movenet-multipose
	$(BIN)/multicap samples install
	MULTICAP_PICTURES=build/exports $(BIN)/python -P -m pytest -m "not benchmark" tests/e2e/test_exports.py tests/pipeline/export
	@echo "Blender's pictures are in build/exports/."

test: setup browser readers  ## Run the tests
	$(BIN)/multicap models install movenet-multipose
	$(BIN)/multicap models install openpose-mobilenet-thin
	$(BIN)/multicap samples install
	$(BIN)/python -P -m pytest -n 2 --dist loadgroup -m "not benchmark and not blender and not soak and not hostile"

soak: setup  ## Disturb 200 jobs by faults at random moments; half an hour
	$(BIN)/python -P -m pytest -s -m soak tests/faults

hostile: setup  ## Send 6,000 damaged and malicious sessions to a service; an hour
	$(BIN)/multicap models install movenet-multipose
	$(BIN)/python -P -m pytest -s -m hostile tests/hostile

check: setup linter  ## What CI runs: format, lint, types, import contracts, the API's contract, Dockerfiles, tests
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -P -m api.openapi --check
	$(BIN)/python -P -m api.problem_codes.page --check
	@test ! -e $(LINTER)/node_modules/.installed || REDOCLY_SUPPRESS_UPDATE_NOTICE=true $(BIN)/node \
		$(LINTER)/node_modules/@redocly/cli/bin/cli.js lint --config openapi/redocly.yaml openapi/openapi.json
	$(BIN)/hadolint docker/*.Dockerfile
	$(MAKE) test

benchmark: setup  ## Measure what the README states of the service; quiet machines only
	$(BIN)/multicap benchmark pipeline
	$(BIN)/multicap benchmark service
	$(BIN)/python -P -m pytest -m benchmark

format: setup  ## Format and mend what can be mended
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

LOCK := uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-header --no-annotate \
	--no-emit-index-url --no-emit-find-links

lock:  ## Pin the dependencies anew (needs uv)
	$(LOCK) --extra dev --extra evaluation --output-file requirements.lock pyproject.toml
	$(LOCK) --constraint requirements.lock --output-file docker/requirements.lock pyproject.toml

clean:  ## Remove what the targets made
	rm -rf $(VENV) $(BLENDER) $(READERS)/node_modules $(LINTER)/node_modules build demo-output .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
