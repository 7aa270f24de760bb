# The environment is private to this folder; the two main jobs need only python3 (with venv) and make.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
OUT ?= results

.PHONY: install reproduce test lint types check bench clean

install: $(INSTALLED)

reproduce: $(INSTALLED)
	$(BIN)/thermojoint reproduce --out $(OUT)

test: $(INSTALLED)
	$(BIN)/python -m pytest -n 2 --dist loadscope

lint: $(INSTALLED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(INSTALLED)
	$(BIN)/mypy

check: lint types test

# Half an hour to an hour; alone on the machine, or both sides wait for others.
bench: $(INSTALLED)
	$(BIN)/python -m benchmarks.performance --out bench.json

$(INSTALLED): pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[pardiso,view,gmsh,dask,dev]'
	touch $@

clean:
	rm -rf $(VENV) $(OUT)
