# The environment is private to this folder; the two main jobs need only python3 (with venv) and make.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
OUT ?= results
# What a user may install beside the program; the rest are for those who work on it.
EXTRAS := pardiso view excel gmsh batch sensitivity dask control serve
empty :=
comma := ,

.PHONY: install reproduce test test-long coverage portable portable-plain portable-avx2 portable-threads numerical lint types docs constraints sbom wheel check bench plants images clean

install: $(INSTALLED)

reproduce: $(INSTALLED)
	$(BIN)/thermojoint reproduce --out $(OUT)

# For two cores, in the order of tests/conftest.py: two processes compute while two others wait.
# Without a worker that was lost the rest may wait for ever: end then.
SHARED := -n 4 --dist loadscope --no-loadscope-reorder --max-worker-restart 0

# Bytecode is written whatever the environment says: each of the many processes that tests start would
# compile all sources.
PYTEST := env -u PYTHONDONTWRITEBYTECODE $(BIN)/python -m pytest

# What is marked `long` is left out here alone: whoever names a test or a folder runs all of it.
test: $(INSTALLED)
	$(PYTEST) $(SHARED) -m 'not long'

test-long: $(INSTALLED)
	$(PYTEST) $(SHARED) -m long

# Lines of the program that `make test` runs; with ALL=1, the long tests as well.
coverage: $(INSTALLED)
	$(BIN)/coverage erase
	$(BIN)/coverage run -m pytest $(SHARED) $(if $(ALL),,-m 'not long')
	$(BIN)/coverage combine --quiet
	$(BIN)/coverage report --sort=miss

# What is computed, as other processors compute it: without vector instructions and with the other
# direct solver; with those of AVX2, MKL's most compatible under PARDISO; and with two threads where
# matrices are large (elsewhere they only wait for each other). Long tests are run the first way alone.
NUMERICAL := tests/fesim/solid tests/fesim/joint tests/fesim/march tests/calibrate tests/estimator/fchs \
	tests/thermojoint/models tests/thermojoint/verification
THREADED := $(patsubst %,tests/fesim/solid/test_%.py,condensation elasticity heat linear_solver) \
	tests/fesim/march/test_march.py
PLAIN := OPENBLAS_CORETYPE=Prescott NPY_DISABLE_CPU_FEATURES='X86_V3 X86_V4 AVX512_ICL AVX512_SPR' \
	NUMBA_CPU_NAME=generic THERMOJOINT_SOLVER=superlu
AVX2 := OPENBLAS_CORETYPE=Haswell NPY_DISABLE_CPU_FEATURES='X86_V4 AVX512_ICL AVX512_SPR' \
	NUMBA_CPU_NAME=haswell MKL_CBWR=COMPATIBLE THERMOJOINT_SOLVER=pardiso

portable: portable-plain portable-avx2 portable-threads

# As this processor computes it: for another Python than the tests have run with.
numerical: $(INSTALLED)
	$(PYTEST) $(SHARED) -m 'not long' $(NUMERICAL)

portable-plain: $(INSTALLED)
	$(PLAIN) $(BIN)/python -m pytest $(SHARED) $(NUMERICAL)

portable-avx2: $(INSTALLED)
	$(AVX2) $(BIN)/python -m pytest $(SHARED) -m 'not long' $(NUMERICAL)

portable-threads: $(INSTALLED)
	$(PLAIN) OMP_NUM_THREADS=2 $(BIN)/python -m pytest $(THREADED)

lint: $(INSTALLED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(INSTALLED)
	$(BIN)/mypy

# Every link, anchor, image and docstring is checked on the way. To search in it:
# python3 -m http.server -d site
docs: $(INSTALLED)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

# The versions in this environment, with the hashes of their files for every platform. Run it when the
# tests have passed with them.
constraints: $(INSTALLED)
	$(BIN)/python -m pip freeze --exclude-editable > $(VENV)/tested.txt
	$(BIN)/uv pip compile pyproject.toml $(EXTRAS:%=--extra %) --universal --generate-hashes --no-annotate \
		--custom-compile-command 'make constraints' --constraints $(VENV)/tested.txt --quiet \
		--output-file constraints.txt

# What this environment is made of: names, versions, licences and what needs what (CycloneDX).
sbom: $(INSTALLED)
	mkdir -p dist
	$(BIN)/cyclonedx-py environment --pyproject pyproject.toml --output-reproducible --of JSON \
		--output-file dist/thermojoint.cdx.json $(BIN)/python

# A release in dist/: wheel, sources, tested versions and SBOM; and the whole chain run from the wheel alone.
wheel: $(INSTALLED)
	rm -rf dist
	$(BIN)/python -m build --outdir dist
	cp constraints.txt dist
	$(MAKE) sbom
	.ci/wheel_alone dist/*.whl

check: lint types docs test test-long

# Half an hour to an hour; alone on the machine, or both sides wait for others.
bench: $(INSTALLED)
	$(BIN)/python -m benchmarks.performance --out bench.json

# Every estimator on 100 machines drawn at random. Stopped in any way, it goes on from there.
plants: $(INSTALLED)
	$(BIN)/python -m benchmarks.plants --out plants.json
	$(BIN)/python -m benchmarks.plants --family structural --count 25 --estimator joint-aware \
		--out structural.json

# The film at the top of the README, and those of a machine that moves.
images: $(INSTALLED)
	$(BIN)/thermojoint view thermojoint/cases/reference.toml --film --frames 32 --out docs/images/warm-up.gif
	$(BIN)/thermojoint view thermojoint/cases/three_axes.toml --film --frames 40 --out docs/images/moving.gif
	$(BIN)/thermojoint view thermojoint/cases/three_axes.toml --show volume --out docs/images/moving-volume.png

$(INSTALLED): pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --upgrade pip setuptools
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[$(subst $(empty) ,$(comma),$(EXTRAS) docs dev)]'
	touch $@

clean:
	rm -rf $(VENV) $(OUT) build dist site
