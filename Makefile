# make install | demo | test | test-quick | lint | docs | settings | bench | vectors
# (PYTHON picks the interpreter that makes .venv)
PYTHON ?= python3
BIN := .venv/bin
STAMP := .venv/.installed

.PHONY: install demo test test-quick lint docs settings bench vectors clean

install: $(STAMP)

$(STAMP): pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	touch $@

demo: install
	$(BIN)/heliograph demo --output demo

test: install
	$(BIN)/python -m pytest

# a test of each room, under a minute
test-quick: install
	$(BIN)/python -m pytest -m "not slow" tests

docs: install
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[docs]'
	$(BIN)/python -m sphinx -W --keep-going -q -b html docs docs/_build

settings: install
	$(BIN)/python scripts/make_settings.py

lint: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: install
	$(BIN)/python -m benchmarks

vectors: install
	$(BIN)/python scripts/make_vectors.py

clean:
	rm -rf .venv demo
