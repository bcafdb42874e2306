"""Planning goes on in a child of `os.fork`, as `multiprocessing` starts them on Linux, where JAX waits for ever."""

import os
import subprocess
import sys

import pytest

SCRIPT = """
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


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
def test_plans_after_a_fork_are_those_before_it():
    ended = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, timeout=300, check=False)
    assert ended.returncode == 0, ended.stderr
