"""A machine on which nothing is compiled yet gives what any other does: same statuses, routes and costs.

In processes of their own, each with empty folders for all that is kept between sessions. Budgets are less than
compiling takes, and more than the searches do.
"""

import json
import os
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest

import jaxurban as ju
from jaxurban.io.store import write_zarr
from tests.made_maps import made_maps

pytestmark = pytest.mark.slow

CACHES = ("NUMBA_CACHE_DIR", "JAX_COMPILATION_CACHE_DIR", "XDG_CACHE_HOME")
BUDGET_S = 1.0
COMPILING = "jaxurban compiles its kernels, which takes some 30 s, once a machine"
SCRIPT = """
import sys
import pandas as pd
import jaxurban as ju

done, folder, out = sys.argv[1:]
maps, budget_s = ju.open_maps(folder), {budget_s}
if done == "plan_many":
    queries = pd.read_parquet(out + ".queries.parquet")
    ju.plan_many(maps, queries, altitude_m=20.0, budget_s=budget_s, file=out, num_threads=2, progress=False)
else:
    settings = ju.studies.Study(planners=("ptp", "astar-dist", "astar-plus"), budget_s=budget_s)
    ju.studies.study(maps, out, 3, settings=settings, progress=False)
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("maps")
    write_zarr(made_maps().ds, folder)
    return folder


@pytest.fixture
def in_new_session(tmp_path):
    """Run Python with arguments where every cache is empty; return stdout and stderr."""

    def run(*arguments):
        folders = {name: str(tmp_path / name) for name in CACHES}
        for empty in folders.values():
            os.mkdir(empty)
        command = [sys.executable, *map(str, arguments)]
        ended = subprocess.run(
            command, env={**os.environ, **folders}, capture_output=True, text=True, timeout=600, check=False
        )
        assert ended.returncode == 0, ended.stderr
        assert ended.stderr.count(COMPILING) == 1
        return ended.stdout, ended.stderr

    return run


def test_plan(folder, in_new_session):
    maps = ju.open_maps(folder)
    ends = [maps.grid.lonlat_of_xy(*maps.grid.xy_of_cell(*cell)) for cell in np.argwhere(maps.is_free(20.0))[[40, -40]]]
    places = [",".join(repr(float(value)) for value in np.ravel(end)) for end in ends]
    arguments = ["--start", places[0], "--goal", places[1], "--altitude", "20", "--budget", BUDGET_S, "--snap"]
    out, _ = in_new_session("-m", "jaxurban", "plan", folder, *arguments, "--json")
    cold = json.loads(out)
    start, goal = (tuple(map(float, place.split(","))) for place in places)
    warm = ju.plan(maps, start, goal, altitude_m=20.0, budget_s=BUDGET_S, snap=True).to_dict()
    assert cold["setup_s"] > BUDGET_S > cold["elapsed_s"]
    assert cold["status"] == warm["status"] == "optimal"
    assert cold["heuristic"] == warm["heuristic"]
    assert (cold["cost"], cold["length_m"], cold["num_points"]) == pytest.approx(
        (warm["cost"], warm["length_m"], warm["num_points"]), rel=1e-12
    )


def test_plan_many(folder, in_new_session, tmp_path):
    maps = ju.open_maps(folder)
    free = np.random.default_rng(0).choice(np.argwhere(maps.is_free(30.0)), (30, 2))
    xy_m = np.moveaxis(np.stack(maps.grid.xy_of_cell(free[..., 0], free[..., 1])), 0, -1).reshape(30, 4)
    queries = pd.DataFrame(xy_m, columns=["start_x_m", "start_y_m", "goal_x_m", "goal_y_m"])
    queries.to_parquet(tmp_path / "cold.parquet.queries.parquet")
    _, err = in_new_session("-c", SCRIPT.format(budget_s=BUDGET_S), "plan_many", folder, tmp_path / "cold.parquet")
    assert err.startswith(COMPILING)
    cold = pd.read_parquet(tmp_path / "cold.parquet")
    given = {"altitude_m": 20.0, "budget_s": BUDGET_S, "progress": False}
    ju.plan_many(maps, queries, **given, file=tmp_path / "warm.parquet")
    warm = pd.read_parquet(tmp_path / "warm.parquet")
    assert (cold["status"] == "optimal").sum() > 10
    assert cold["setup_s"].max() > BUDGET_S > cold["elapsed_s"].max()
    clocks = ["elapsed_s", "setup_s", "search"]
    pd.testing.assert_frame_equal(cold.drop(columns=clocks), warm.drop(columns=clocks), rtol=1e-12)


def test_study(folder, in_new_session, tmp_path):
    in_new_session("-c", SCRIPT.format(budget_s=BUDGET_S), "study", folder, tmp_path / "cold")
    settings = ju.studies.Study(planners=("ptp", "astar-dist", "astar-plus"), budget_s=BUDGET_S)
    warm = ju.studies.study(ju.open_maps(folder), tmp_path / "warm", 3, settings=settings, progress=False).rows
    cold = pd.read_parquet(tmp_path / "cold" / "rows.parquet")
    assert cold["setup_s"].max() > BUDGET_S > cold["elapsed_s"].max()
    clocks = ["elapsed_s", "setup_s"]
    pd.testing.assert_frame_equal(cold.drop(columns=clocks), warm.drop(columns=clocks), rtol=1e-12)
