# Every target makes what it needs: Python 3.11 or newer and make are enough.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check -q
SOURCES := pyproject.toml constraints.txt
CUDA_VENV := .venv-cuda
RAN := out/notebooks/.ran
CUDA_PIP := $(CUDA_VENV)/bin/python -m pip --disable-pip-version-check -q
CUDA_COMPILER := jax-cuda13-plugin jax-cuda13-pjrt nvidia-cuda-nvcc nvidia-nvvm nvidia-cuda-runtime nvidia-nvjitlink

.PHONY: demo test test-slow test-docs campaign lint wheel notebooks figures bench bench-gpu cuda-compile docs clean

demo: $(VENV)/.run
	$(BIN)/jaxurban demo -o out/demo --overwrite
	@echo "To look at it in a browser: $(BIN)/jaxurban view out/demo"

test: $(VENV)/.dev
	$(BIN)/python -m pytest -n 2 --dist loadfile

# All tests that are marked slow, by the marker alone: tests/test_suite.py holds that `.ci/run` runs each.
test-slow: $(VENV)/.dev
	$(BIN)/python -m pytest -n 2 --dist loadfile -m slow

# Some 1,300 hostile inputs and 60 kills: half an hour. PART and KILLS make it less.
campaign: $(VENV)/.dev
	$(BIN)/python -m tests.campaign --part $(or $(PART),1) --kills $(or $(KILLS),60)

test-docs: $(VENV)/.dev
	$(BIN)/python -m pytest -m 'slow or not slow' tests/test_docs.py

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy jaxurban
	$(BIN)/lint-imports --no-logo

wheel: $(VENV)/.dev
	rm -rf dist
	$(BIN)/python -m build --wheel --no-isolation -o dist
	sh tests/try_wheel.sh $(BIN)/python dist

notebooks: $(VENV)/.dev
	$(BIN)/python notebooks/run_all.py -o out/notebooks
	touch $(RAN)

figures: $(VENV)/.run
	$(BIN)/python -m figures

# The site shows the notebooks as they ran.
$(RAN): $(wildcard notebooks/*.py) $(shell find jaxurban kernels planners -name '*.py')
	$(MAKE) notebooks

docs: $(VENV)/.docs $(RAN)
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict

bench: $(VENV)/.bench
	$(BIN)/python -m benchmarks.run_all

bench-gpu: $(VENV)/.run
	$(BIN)/python -m benchmarks.gpu

# Compiles every kernel for a GPU that is not there, in an environment of its own: beside the tests JAX would see the
# plugin and complain. Only where pip cannot install the packages is it skipped.
cuda-compile: $(CUDA_VENV)/.compiler
	@if [ -e $< ]; then $(CUDA_VENV)/bin/python -m benchmarks.cuda_compile; \
	  else echo "make cuda-compile is skipped, as pip cannot install the compiler:" \
	    "$$(grep -m 1 ERROR $(CUDA_VENV)/pip.log || tail -n 1 $(CUDA_VENV)/pip.log)"; fi

clean:
	rm -rf $(VENV) $(CUDA_VENV) build dist out *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis

$(VENV)/bin/python $(CUDA_VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "jaxurban needs Python 3.11 or newer: name one with make PYTHON=python3.12" >&2; exit 2; }
	$(PYTHON) -m venv $(dir $(@D))

$(VENV)/.run: $(VENV)/bin/python $(SOURCES)
	$(PIP) install -c constraints.txt setuptools
	$(PIP) install -c constraints.txt --no-build-isolation -e .
	touch $@

$(VENV)/.dev: $(VENV)/.run
	$(PIP) install -c constraints.txt --no-build-isolation -e '.[dev]'
	touch $@

$(VENV)/.bench: $(VENV)/.run
	$(PIP) install -c constraints.txt --no-build-isolation -e '.[bench]'
	touch $@

$(VENV)/.docs: $(VENV)/.run
	$(PIP) install -c constraints.txt --no-build-isolation -e '.[docs]'
	touch $@

$(CUDA_VENV)/.compiler: $(CUDA_VENV)/bin/python $(SOURCES) constraints-cuda.txt
	@rm -f $@
	@echo "installing the compiler for GPUs into $(CUDA_VENV)"
	@if $(CUDA_PIP) install -c constraints-cuda.txt setuptools 2> $(CUDA_VENV)/pip.log && \
	  $(CUDA_PIP) install -c constraints-cuda.txt --no-build-isolation -e . $(CUDA_COMPILER) 2> $(CUDA_VENV)/pip.log; \
	  then touch $@; fi
