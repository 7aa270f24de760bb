# The environment is private to this folder; the two main jobs need only python3 (with venv) and make.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
OUT ?= results

.PHONY: reproduce test lint types docs wheel check bench clean

reproduce: $(INSTALLED)
	$(BIN)/thermojoint reproduce --out $(OUT)

test: $(INSTALLED)
	$(BIN)/python -m pytest -n 2 --dist loadscope

lint: $(INSTALLED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(INSTALLED)
	$(BIN)/mypy

# Every link, anchor, image and docstring is checked on the way. To search in it:
# python3 -m http.server -d site
docs: $(INSTALLED)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

# The wheel in dist/, and the whole chain run from it alone.
wheel: $(INSTALLED)
	rm -rf dist
	$(BIN)/python -m build --outdir dist
	.ci/wheel_alone dist/*.whl

check: lint types docs test

# Half an hour to an hour; alone on the machine, or both sides wait for others.
bench: $(INSTALLED)
	$(BIN)/python -m benchmarks.performance --out bench.json

$(INSTALLED): pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[pardiso,view,gmsh,dask,docs,dev]'
	touch $@

clean:
	rm -rf $(VENV) $(OUT) build dist site
