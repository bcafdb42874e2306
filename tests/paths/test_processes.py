"""Processes of their own plan as this one does: where nothing is compiled yet, and in a child of `os.fork`.

The first have empty folders for all that is kept between sessions, and budgets that are less than compiling takes and
more than the searches do. A fork is how `multiprocessing` starts children on Linux, where JAX waits for ever.
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
from jaxurban.programs import SENTENCE
from tests.volumes import ends_at, options_of

CACHES = ("NUMBA_CACHE_DIR", "JAX_COMPILATION_CACHE_DIR", "XDG_CACHE_HOME")
BUDGET_S = 1.0
NEW = "from tests.paths.test_processes import JOBS; import sys; JOBS[sys.argv[1]](*sys.argv[2:])"
FORKED = """
import os, signal, warnings
import numpy as np
import jax.numpy as jnp
import jaxurban as ju
from tests.made_maps import made_maps

warnings.simplefilter("ignore")  # Python 3.12 and JAX warn of forks
jnp.ones(3).sum().block_until_ready()
maps = made_maps(60, 80)
constraints = ju.Constraints(clearance_m=5.0, vertical_clearance_m=3.0)
cells = np.argwhere(ju.cost_map(maps, 20.0, constraints=constraints).is_free)[[0, -1]]
ends = [tuple(map(float, maps.grid.lonlat_of_cell(*cell))) for cell in cells]

def costs():
    how = {"constraints": constraints, "cost_model": "line", "snap": True}
    paths = [ju.plan(maps, *ends, altitude_m=20.0, planner=name, **how) for name in ("ptp", "astar-plus", "theta-star")]
    paths.append(ju.plan(maps, *ends, altitude_m=ju.Levels(20.0, 60.0, 20.0), **how))
    ju.explain(paths[1], maps)
    paths += list(ju.plan_many(maps, [ends] * 3, altitude_m=60.0, snap=True, progress=False))
    return [path.cost for path in paths]

before = costs()
child = os.fork()
if not child:
    signal.alarm(60)
    os._exit(0 if costs() == before else 1)
status = os.waitpid(child, 0)[1]
assert status == 0, f"the child ended with {status} ({signal.SIGALRM} is a hang)"
"""


def plan(folder, out):
    """Plan by the command."""
    maps = ju.open_maps(folder)
    ends = ends_at(maps, *np.argwhere(maps.is_free(20.0))[[40, -40]])
    options = ("--planner", f"budget_s={BUDGET_S}", "--snap", "-o", f"{out}/route.geojson")
    with pytest.raises(SystemExit):
        main([str(word) for word in ("plan", folder, *options_of(maps, **ends), *options)])
    gpd.read_file(f"{out}/route.geojson").drop(columns="geometry").to_parquet(f"{out}/rows.parquet")


def plan_many(folder, out):
    maps = ju.open_maps(folder)
    cells = np.random.default_rng(0).choice(np.argwhere(maps.is_free(30.0)), (30, 2))
    xy_m = np.stack(maps.grid.xy_of_cell(cells[..., 0], cells[..., 1]), axis=-1)
    queries = pd.DataFrame(
        xy_m.reshape(30, 4), columns=["start_x_m", "start_y_m", "goal_x_m", "goal_y_m"]
    )
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
    command = [sys.executable, "-c", NEW, job, folder, cold]
    env = {**os.environ, **dict(zip(CACHES, map(str, caches), strict=True))}
    ended = subprocess.run(
        command, env=env, capture_output=True, text=True, timeout=600, check=False
    )
    assert ended.returncode == 0, ended.stderr
    assert ended.stderr.count(SENTENCE) == 1
    JOBS[job](folder, warm)
    found, expected = (pd.read_parquet(place / "rows.parquet") for place in (cold, warm))
    assert found["setup_s"].max() > BUDGET_S > found["elapsed_s"].max()
    assert (found["status"] == "optimal").mean() > 1 / 3
    clocks = found.columns.intersection(["elapsed_s", "setup_s", "search"])
    pd.testing.assert_frame_equal(
        found.drop(columns=clocks), expected.drop(columns=clocks), rtol=1e-12
    )


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
def test_plans_after_a_fork_are_those_before_it():
    ended = subprocess.run(
        [sys.executable, "-c", FORKED], capture_output=True, text=True, timeout=300, check=False
    )
    assert ended.returncode == 0, ended.stderr
