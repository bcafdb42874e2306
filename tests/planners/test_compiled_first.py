"""What a planner runs is compiled before its clock starts, and it is little."""

import os
import subprocess
import sys
import threading
from collections import Counter

import pytest

from jaxurban.planners.compiled_first import compiled_first
from jaxurban.planners.registry import PLANNERS, VOLUME_PLANNERS
from tests.planners.problems import random_problem

# In a process of its own, where no test has called a kernel yet; a child for each planner. A search on an uneven map
# may use no compiled function under a signature that a plan across a few cells has not used.
SCRIPT = """
import os, sys
from dataclasses import replace
import numpy as np
from jaxurban.planners.compiled_first import _few_cells, _few_points
from jaxurban.planners.refine import refine
from jaxurban.planners.registry import PLANNERS, VOLUME_PLANNERS
from jaxurban.planners.simplify import simplify_path
from tests.planners.problems import random_problem

def problem(dtype, kind, num_levels):
    drawn = random_problem(0, (num_levels, 40, 50) if num_levels else (40, 50), dtype, 0.9, kind=kind)
    return replace(drawn, leg_margin_m=0.5 if dtype == np.float64 else 0.0)

def used():
    modules = [module for name, module in sys.modules.items() if name.startswith("jaxurban")]
    functions = {each for module in modules for each in vars(module).values() if hasattr(each, "nopython_signatures")}
    assert functions
    return {(each.__module__, each.__name__, str(kinds)) for each in functions for kinds in each.signatures}

def check(name, num_levels):
    entry = (VOLUME_PLANNERS if num_levels else PLANNERS)[name]
    for dtype in (np.float32, np.float64):
        for kind in ("cell", "line"):
            if name == "theta-star" and kind == "cell":
                continue
            query = problem(dtype, kind, num_levels)
            limit = {"max_samples": 200} if "bitstar" in name else {}
            for heuristic in entry.heuristics or [None]:
                chosen = {"heuristic": heuristic} if heuristic else {}
                entry.run(_few_cells(query), budget_s=60.0, **chosen, **limit)
                before = used()
                path = entry.run(query, budget_s=60.0, **chosen, **limit)
                assert used() == before, (name, heuristic, dtype, kind, used() - before)
                assert path.setup_s < 1.0, path.setup_s
            alterations = [(simplify_path, 2.0)] + [(refine,)] * (kind == "line" and not num_levels)
            assert path.status.has_path or name == "ptp"
            for alter, *how in alterations if path.status.has_path else ():
                alter(_few_cells(query), _few_points(_few_cells(query)), *how)
                before = used()
                alter(query, path, *how)
                assert used() == before, (alter, dtype, kind, used() - before)

wrong = []
for name in sys.argv[1:]:
    child = os.fork()
    if not child:
        check(name, 3 if name in VOLUME_PLANNERS else 0)
        os._exit(0)
    wrong += [name] if os.waitpid(child, 0)[1] else []
sys.exit(f"compiled within a search: {wrong}" if wrong else 0)
"""


@pytest.mark.slow
def test_no_planner_compiles_within_its_search():
    command = [sys.executable, "-c", SCRIPT, *PLANNERS, *VOLUME_PLANNERS]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert ended.returncode == 0, ended.stderr


COMPILED = """
from numba.core import event
from jaxurban.planners.registry import find_planner
from tests.planners.problems import random_problem

class Print(event.Listener):
    def on_start(self, event):
        function = event.data["dispatcher"].py_func
        print(function.__module__, function.__name__)
    def on_end(self, event): ...

problem = random_problem(0, (6, 6), share_free=1.0, kind="line")
event.register("numba:compile", Print())
assert find_planner("astar-plus")(problem).setup_s > 0
"""
# Of jaxurban, each for one choice of types, and of Numba, for functions such as `min`: with Numba 0.68 these.
NUM_OWN, NUM_IN_ALL = 16, 28


@pytest.mark.slow
def test_one_plan_of_astar_compiles_few_functions_and_each_of_them_once(tmp_path):
    """Seconds are of the machine, and of its load; what is compiled from an empty cache is not."""
    command, environment = (
        [sys.executable, "-c", COMPILED],
        os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)},
    )
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    functions = Counter(ran.stdout.splitlines())
    own = {name: times for name, times in functions.items() if name.startswith("jaxurban.")}
    assert own["jaxurban.planners.grid_search advance"] == 1
    assert own == dict.fromkeys(own, 1)
    assert len(own) <= NUM_OWN
    assert functions.total() <= NUM_IN_ALL, functions


def test_a_planner_that_runs_another_one_is_compiled_first_too():
    """In a thread, since a lock that cannot be entered twice would never end it."""
    astar = PLANNERS["astar-plus"].run

    @compiled_first()
    def twice(problem, **query):
        astar(problem, **query)
        return astar(problem, **query)

    paths = []
    query = random_problem(0, (6, 6), share_free=1.0)
    thread = threading.Thread(target=lambda: paths.append(twice(query)), daemon=True)
    thread.start()
    thread.join(60)
    assert [path.status for path in paths] == [astar(query).status]
