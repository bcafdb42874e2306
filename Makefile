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

.PHONY: demo test test-slow test-long test-docs campaign lint wheel notebooks figures bench bench-gpu cuda-compile docs clean

demo: $(VENV)/.run
	$(BIN)/jaxurban demo -o out/demo --overwrite
	@echo "To look at it in a browser: $(BIN)/jaxurban view out/demo"

test: $(VENV)/.dev
	$(BIN)/python -m pytest -n 2 --dist loadfile

test-slow: $(VENV)/.dev
	$(BIN)/python -m pytest -m slow

test-long: $(VENV)/.dev
	$(BIN)/python -m pytest -n 2 --dist loadfile -m slow tests/test_damage.py tests/paths/test_cost_model.py \
	  tests/maps/test_own_layers.py tests/test_toy_metric.py tests/studies/test_buildings.py tests/cli/test_cli.py \
	  tests/test_manhattan.py tests/metrics/test_gps_embree.py tests/planners/test_walls.py tests/io/test_knownarea.py \
	  tests/kernels/test_lidar.py tests/metrics/soft/test_lidar.py tests/studies/test_sensitivity_study.py \
	  tests/maps/test_device.py tests/maps/test_held.py tests/scenario/test_additions.py tests/report/test_run_tuning.py \
	  tests/report/test_map_comparison.py tests/io/test_burn.py tests/report/test_figures.py \
	  tests/kernels/test_shadow_doubling.py tests/metrics/test_lidar_embree.py tests/studies/test_montecarlo.py \
	  tests/io/test_hanging.py tests/metrics/soft/test_gps.py tests/metrics/soft/test_risk.py tests/metrics/test_risk.py \
	  tests/studies/test_sensitivity.py tests/maps/test_pipeline.py tests/kernels/test_cost_to_go.py \
	  tests/test_compile_cache.py tests/kernels/test_sample_graph.py tests/kernels/test_dop_clocks.py \
	  tests/metrics/test_gps_clocks.py tests/test_clocks_page.py tests/maps/test_protection.py tests/maps/test_slabs.py \
	  tests/metrics/test_protection_sidereon.py tests/report/test_receiver.py tests/studies/test_receiver.py \
	  tests/test_receiver_page.py tests/world/test_grid.py tests/kernels/test_distance.py tests/world/test_synthetic.py \
	  tests/planners/test_bitstar_batched.py tests/maps/test_supersampling.py tests/scenario/test_run.py \
	  tests/viewer/test_page.py tests/viewer/test_widget.py tests/viewer/test_study.py tests/cli/test_view.py \
	  tests/planners/test_batch.py::test_a_sample_of_movingai_is_optimal_in_jax \
	  tests/planners/test_batch.py::test_the_frontier_is_exact_for_every_band_on_many_maps_at_once \
	  tests/maps/test_tiled.py::test_kill_9_of_the_run_loses_no_finished_tile_and_changes_no_byte \
	  tests/maps/test_tiled.py::test_kill_9_of_a_worker_costs_only_its_tile

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
