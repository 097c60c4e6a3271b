# make install | install-docs | demo | test | test-quick | test-lowest | test-wheel | lint | docs | settings | web | check-web |
# bench | vectors
# (PYTHON picks the interpreter that makes .venv)
PYTHON ?= python3
BIN := .venv/bin
DEMO_STAMP := .venv/.installed-demo
STAMP := .venv/.installed
DOCS_STAMP := .venv/.installed-docs
LOWEST := .venv-lowest
WHEEL := .wheel
# the tests start many processes: each loads bytecode, wherever that may be written
export PYTHONDONTWRITEBYTECODE :=
export PYTHONPYCACHEPREFIX := $(CURDIR)/.venv/bytecode

.PHONY: install install-docs demo test test-quick test-lowest test-wheel lint docs settings web check-web bench vectors clean

install: $(STAMP)

$(DEMO_STAMP): pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --no-compile --disable-pip-version-check --editable .
	touch $@

# what the tests, the examples and the tools need beyond the package
$(STAMP): $(DEMO_STAMP)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev,examples,codes]'
	touch $@

demo: $(DEMO_STAMP)
	$(BIN)/heliograph demo --output demo

# two processes, a file of tests each: what a file's tests share is made once
test: install
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder

# the tests that are quick
test-quick: install
	$(BIN)/python -m pytest -n 2 --dist loadfile -m "not slow" tests

docs: install-docs
	$(BIN)/python -m sphinx -W --keep-going -q -b html docs docs/_build

install-docs: $(DOCS_STAMP)

$(DOCS_STAMP): $(STAMP)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[docs]'
	touch $@

settings: install
	$(BIN)/python scripts/make_settings.py

# the pages of `heliograph serve`, built into the package; this alone takes Node, 20.19 or newer
web: web/node_modules/.installed
	cd web && npm run --silent build

web/node_modules/.installed: web/package-lock.json
	cd web && npm ci --silent
	touch $@

# the built pages that are committed are those that a fresh build gives
check-web: web
	git diff --exit-code --stat -- src/heliograph/web/pages
	test -z "$$(git status --porcelain -- src/heliograph/web/pages)"

# in an environment of the lowest versions that pyproject.toml allows, which call much that is deprecated now
test-lowest: $(LOWEST)/.installed
	NUMBA_CACHE_DIR=$(CURDIR)/$(LOWEST)/kernels $(LOWEST)/bin/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder \
		-W ignore::DeprecationWarning -W ignore::numpy.VisibleDeprecationWarning

$(LOWEST)/.installed: pyproject.toml scripts/lowest_versions.py
	mkdir -p $(LOWEST)
	$(PYTHON) scripts/lowest_versions.py > $(LOWEST)/constraints.txt
	test -x $(LOWEST)/bin/python || $(PYTHON) -m venv $(LOWEST)
	$(LOWEST)/bin/python -m pip install --quiet --disable-pip-version-check --only-binary :all: \
		--constraint $(LOWEST)/constraints.txt --editable '.[dev]'
	touch $@

# the wheel alone, in an empty environment without the tools of developers, and away from the sources
test-wheel: install
	rm -rf $(WHEEL)
	$(BIN)/python -m pip wheel --quiet --disable-pip-version-check --no-deps --wheel-dir $(WHEEL) .
	$(PYTHON) -m venv $(WHEEL)/venv
	$(WHEEL)/venv/bin/python -m pip install --quiet --disable-pip-version-check $(WHEEL)/*.whl
	$(PYTHON) -m zipfile --list $(WHEEL)/heliograph-*.whl | grep --quiet heliograph/web/pages/watch.html
	cd $(WHEEL) && sh -e $(CURDIR)/scripts/try_wheel.sh venv/bin/heliograph

lint: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# one table of speeds beside peers; BENCH=--keep adds it to benchmarks/history.jsonl
bench: install
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[bench]'
	$(BIN)/python -m benchmarks.table $(BENCH)

vectors: install
	$(BIN)/python scripts/make_vectors.py

clean:
	rm -rf .venv $(LOWEST) $(WHEEL) demo
