# Every target makes what it needs: Python 3.11 or newer and make are enough.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP = $(@D)/bin/python -m pip --disable-pip-version-check -q
SOURCES := pyproject.toml constraints.txt
CUDA_VENV := .venv-cuda
NEWEST := .venv-newest
OLDEST := .venv-oldest
RAN := out/notebooks/.ran
CUDA_COMPILER := jax-cuda13-plugin jax-cuda13-pjrt nvidia-cuda-nvcc nvidia-nvvm nvidia-cuda-runtime nvidia-nvjitlink

# The first of these versions of Python that answers, by its name or through pyenv.
answering = $(shell for version in $(1); do for python in python$$version "env PYENV_VERSION=$$version python3"; do \
  $$python -c "import sys; sys.exit('%d.%d' % sys.version_info[:2] != '$$version')" 2> /dev/null && echo $$python && exit; \
  done; done)
NEWEST_PYTHON = $(call answering,3.14 3.13 3.12)
OLDEST_PYTHON = $(call answering,$(FLOOR))
EVERY ?= 1
FLOOR := $(shell sed -n 's/^requires-python = ">=\(.*\)"/\1/p' pyproject.toml)

.PHONY: demo owner test test-newest renew-newest test-oldest test-slow test-docs lint wheel placeholders notebooks figures figures-small bench bench-gpu cuda-compile docs clean

demo: $(VENV)/.run
	$(BIN)/jaxurban demo -o out/demo --overwrite

test: $(VENV)/.dev
	$(BIN)/python -m pytest -n 2 --dist loadfile

# The same tests with the packages that were the newest at the last `make renew-newest`; with EVERY=3 a third of them.
test-newest:
	@$(if $(NEWEST_PYTHON),$(MAKE) $(NEWEST)/.dev,echo "make test-newest is skipped: no Python 3.12 to 3.14 answers")
	@if [ -e $(NEWEST)/.dev ]; then $(NEWEST)/bin/python -m pytest -n 2 --dist loadfile --every $(EVERY); fi

renew-newest:
	rm -rf $(NEWEST)
	: > constraints-newest.txt
	$(MAKE) $(NEWEST)/.dev
	$(NEWEST)/bin/python -m pip freeze --all --exclude-editable > constraints-newest.txt
	touch $(NEWEST)/.dev

# The same tests with the oldest packages that pyproject.toml allows: these use what others of them have deprecated.
test-oldest:
	@$(if $(OLDEST_PYTHON),$(MAKE) $(OLDEST)/.dev,echo "make test-oldest is skipped: no Python $(FLOOR) answers")
	@if [ -e $(OLDEST)/.dev ]; then PYTHONWARNINGS=ignore::DeprecationWarning $(OLDEST)/bin/python -m pytest -n 2 \
	  --dist loadfile --every $(EVERY) -W ignore::DeprecationWarning -W ignore::PendingDeprecationWarning; fi

# All tests that are marked slow, by the marker alone: tests/test_repository.py holds that `.ci/run` runs each.
test-slow: $(VENV)/.dev
	$(BIN)/python -m pytest -n 2 --dist loadfile -m slow

test-docs: $(VENV)/.dev
	$(BIN)/python -m pytest -m 'slow or not slow' tests/test_docs.py tests/test_docstrings.py

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy jaxurban
	$(BIN)/lint-imports --no-logo

# The sdist, the wheel made from it, both of the last commit's time and so of the same bytes in every build, and the
# wheel in empty environments of the oldest and the newest Python.
wheel: export SOURCE_DATE_EPOCH := $(or $(shell git log -1 --format=%ct 2> /dev/null),$(shell date +%s))
wheel: $(VENV)/.dev $(VENV)/.release
	rm -rf dist
	$(BIN)/python -m build --no-isolation -o dist
	$(BIN)/twine check --strict dist/*
	$(BIN)/check-wheel-contents dist/*.whl
	sh tests/try_wheel.sh dist constraints.txt $(BIN)/mypy $(BIN)/python
	$(if $(NEWEST_PYTHON),sh tests/try_wheel.sh dist constraints-newest.txt $(BIN)/mypy $(NEWEST_PYTHON))

# What a release must not hold: an owner, a name, a text or a date that is still to be filled in. The files of the
# tests name such words on purpose.
placeholders:
	@git grep -nIE 'OWNER(@|\.github|/)|PLACE[H]OLDER|\(unreleased\)|^## Unreleased' -- ':!tests'; \
	  test $$? = 1 || { echo "fill these in before a release" >&2; exit 2; }

# Fills in who publishes: make owner NAME=account.
owner:
	@test -n "$(NAME)" || { echo "say who publishes: make owner NAME=account" >&2; exit 2; }
	sed -i.before 's|OWNER|$(NAME)|g' pyproject.toml
	rm pyproject.toml.before

notebooks: $(VENV)/.dev
	$(BIN)/python notebooks/run_all.py -o out/notebooks
	touch $(RAN)

figures: $(VENV)/.run
	$(BIN)/python -m figures

# Draws all of them, those of the paper on coarser cells: a tenth of the time, and no kept picture changes.
figures-small: $(VENV)/.run
	$(BIN)/python -m figures --small

# The site shows the notebooks as they ran.
$(RAN): $(wildcard notebooks/*.py) $(shell find jaxurban kernels planners -name '*.py')
	$(MAKE) notebooks

docs: $(VENV)/.dev $(VENV)/.docs $(RAN)
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict
	JAXURBAN_SITE=out/docs $(BIN)/python -m pytest -m slow tests/test_site.py

bench: $(VENV)/.bench
	$(BIN)/python -m benchmarks.run_all $(if $(RUNS),--runs $(RUNS))

bench-gpu: $(VENV)/.run
	$(BIN)/python -m benchmarks.gpu $(SECTION)

# Compiles every kernel for a GPU that is not there, in an environment of its own: beside the tests JAX would see the
# plugin and complain. Only where pip cannot install the packages is it skipped.
cuda-compile: $(CUDA_VENV)/.compiler
	@if [ -e $< ]; then $(CUDA_VENV)/bin/python -m benchmarks.cuda_compile; \
	  else echo "make cuda-compile is skipped, as pip cannot install the compiler:" \
	    "$$(grep -m 1 ERROR $(CUDA_VENV)/pip.log || tail -n 1 $(CUDA_VENV)/pip.log)"; fi

clean:
	rm -rf $(VENV) $(CUDA_VENV) $(NEWEST) $(OLDEST) build dist out *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis

$(NEWEST)/bin/python: PYTHON = $(or $(NEWEST_PYTHON),python3.12)
$(OLDEST)/bin/python: PYTHON = $(or $(OLDEST_PYTHON),python$(FLOOR))
$(VENV)/bin/python $(CUDA_VENV)/bin/python $(NEWEST)/bin/python $(OLDEST)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "jaxurban needs Python 3.11 or newer: name one with make PYTHON=python3.12" >&2; exit 2; }
	$(PYTHON) -m venv $(dir $(@D))

$(VENV)/.run: $(VENV)/bin/python $(SOURCES)
	$(PIP) install -c constraints.txt pip setuptools
	$(PIP) install -c constraints.txt --no-build-isolation -e .
	touch $@

$(VENV)/.dev: $(VENV)/.run
	$(PIP) install -c constraints.txt --no-build-isolation -e '.[cluster,export,lidar,notebook,ulog]' --group dev
	touch $@

$(VENV)/.bench: $(VENV)/.run
	$(PIP) install -c constraints.txt --no-build-isolation -e . --group bench
	touch $@

$(VENV)/.release: $(VENV)/.run
	$(PIP) install -c constraints.txt --group release
	touch $@

$(VENV)/.docs: $(VENV)/.run
	$(PIP) install -c constraints.txt --no-build-isolation -e . --group docs
	touch $@

$(NEWEST)/.dev: $(NEWEST)/bin/python pyproject.toml constraints-newest.txt
	$(PIP) install -c constraints-newest.txt pip setuptools
	$(PIP) install -c constraints-newest.txt --no-build-isolation -e '.[cluster,export,lidar,notebook,ulog]' --group dev
	touch $@

$(OLDEST)/.dev: $(OLDEST)/bin/python pyproject.toml
	grep -oE '[A-Za-z][A-Za-z0-9_-]*(\[[a-z0-9]+\])?>=[0-9.a-z]+' pyproject.toml | sed -E 's/(\[.*\])?>=/==/' > $(@D)/floors.txt
	$(PIP) install -c $(@D)/floors.txt pip setuptools
	$(PIP) install -c $(@D)/floors.txt --no-build-isolation -e '.[cluster,export,lidar,notebook,ulog]' --group dev
	touch $@

$(CUDA_VENV)/.compiler: $(CUDA_VENV)/bin/python $(SOURCES) constraints-cuda.txt
	@rm -f $@
	@echo "installing the compiler for GPUs into $(CUDA_VENV)"
	@if $(PIP) install -c constraints-cuda.txt setuptools 2> $(CUDA_VENV)/pip.log && \
	  $(PIP) install -c constraints-cuda.txt --no-build-isolation -e . $(CUDA_COMPILER) 2> $(CUDA_VENV)/pip.log; \
	  then touch $@; fi
