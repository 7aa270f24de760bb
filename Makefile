# The environment is private to this folder; the two main jobs need only python3 (with venv) and make.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
OUT ?= results

.PHONY: install reproduce test portable lint types docs wheel check bench clean

install: $(INSTALLED)

reproduce: $(INSTALLED)
	$(BIN)/thermojoint reproduce --out $(OUT)

test: $(INSTALLED)
	$(BIN)/python -m pytest -n 2 --dist loadscope

# What is computed, once more as other processors compute it. First without vector instructions, with
# the other direct solver and two threads (each process has both cores, so there is one); then as a
# processor with AVX2 does it, with MKL's plainest kernels under PARDISO.
NUMERICAL := $(addprefix tests/test_, $(addsuffix .py, calibrate_fictitious calibrate_linear \
	compiled_gap condensation curved_cells deformation driven_deformation elasticity fchs_stream fleet \
	gap heat invariance inverse_filter joint_law least_squares linear_solver march placement \
	pole_residue reduced_march reduction ring_source state_file stress study verification \
	without_joints))
PLAIN := OPENBLAS_CORETYPE=Prescott NPY_DISABLE_CPU_FEATURES='X86_V3 X86_V4 AVX512_ICL AVX512_SPR' \
	NUMBA_CPU_NAME=generic THERMOJOINT_SOLVER=superlu OMP_NUM_THREADS=2
AVX2 := OPENBLAS_CORETYPE=Haswell NPY_DISABLE_CPU_FEATURES='X86_V4 AVX512_ICL AVX512_SPR' \
	NUMBA_CPU_NAME=haswell MKL_CBWR=COMPATIBLE THERMOJOINT_SOLVER=pardiso

portable: $(INSTALLED)
	$(PLAIN) $(BIN)/python -m pytest $(NUMERICAL)
	$(AVX2) $(BIN)/python -m pytest -n 2 --dist loadscope $(NUMERICAL)

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
