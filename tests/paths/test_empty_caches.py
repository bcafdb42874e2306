"""A machine on which nothing is compiled yet gives what any other does: same statuses, routes and costs.

In processes of their own, each with empty folders for all that is kept between sessions. Budgets are less than
compiling takes, and more than the searches do.
"""

import os
import subprocess
import sys

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest

import jaxurban as ju
from jaxurban.cli.main import main
from tests.paths.volumes import ends_at, options_of

CACHES = ("NUMBA_CACHE_DIR", "JAX_COMPILATION_CACHE_DIR", "XDG_CACHE_HOME")
BUDGET_S = 1.0
COMPILING = "jaxurban compiles its kernels, which takes some 30 s, once a machine"
SCRIPT = "from tests.paths.test_empty_caches import JOBS; import sys; JOBS[sys.argv[1]](*sys.argv[2:])"


def plan(folder, out):
    """Plan by the command."""
    maps = ju.open_maps(folder)
    ends = ends_at(maps, *np.argwhere(maps.is_free(20.0))[[40, -40]])
    options = ("--budget", BUDGET_S, "--snap", "-o", f"{out}/route.geojson")
    with pytest.raises(SystemExit):
        main([str(word) for word in ("plan", folder, *options_of(maps, **ends), *options)])
    gpd.read_file(f"{out}/route.geojson").drop(columns="geometry").to_parquet(f"{out}/rows.parquet")


def plan_many(folder, out):
    maps = ju.open_maps(folder)
    cells = np.random.default_rng(0).choice(np.argwhere(maps.is_free(30.0)), (30, 2))
    xy_m = np.stack(maps.grid.xy_of_cell(cells[..., 0], cells[..., 1]), axis=-1)
    queries = pd.DataFrame(xy_m.reshape(30, 4), columns=["start_x_m", "start_y_m", "goal_x_m", "goal_y_m"])
    how = {"altitude_m": 20.0, "budget_s": BUDGET_S, "num_threads": 2, "progress": False}
    ju.plan_many(maps, queries, **how, file=f"{out}/rows.parquet")


def study(folder, out):
    settings = ju.studies.Study(planners=("ptp", "astar-dist", "astar-plus"), budget_s=BUDGET_S)
    ju.studies.study(ju.open_maps(folder), out, 3, settings=settings, progress=False)


JOBS = {job.__name__: job for job in (plan, plan_many, study)}


@pytest.mark.slow
@pytest.mark.parametrize("job", JOBS)
def test_what_a_new_machine_plans_is_what_any_other_does(job, folder, tmp_path):
    places = [tmp_path / name for name in (*CACHES, "cold", "warm")]
    for place in places:
        place.mkdir()
    *caches, cold, warm = places
    command = [sys.executable, "-c", SCRIPT, job, folder, cold]
    env = {**os.environ, **dict(zip(CACHES, map(str, caches), strict=True))}
    ended = subprocess.run(command, env=env, capture_output=True, text=True, timeout=600, check=False)
    assert ended.returncode == 0, ended.stderr
    assert ended.stderr.count(COMPILING) == 1
    JOBS[job](folder, warm)
    found, expected = (pd.read_parquet(place / "rows.parquet") for place in (cold, warm))
    assert found["setup_s"].max() > BUDGET_S > found["elapsed_s"].max()
    assert (found["status"] == "optimal").mean() > 1 / 3
    clocks = found.columns.intersection(["elapsed_s", "setup_s", "search"])
    pd.testing.assert_frame_equal(found.drop(columns=clocks), expected.drop(columns=clocks), rtol=1e-12)
