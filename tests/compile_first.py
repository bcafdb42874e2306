"""Compiles what most tests run: ``python -m tests.compile_first maps`` and ``paths``, at the same time.

`tests/conftest.py` does so once, before the workers of a first run start: else either would compile the same.
"""

import sys

import jaxurban as ju
from jaxurban.planners.registry import PLANNERS, VOLUME_PLANNERS, find_planner
from tests.kernels.test_protection import drawn, levels_of
from tests.planners.problems import random_problem


def maps() -> None:
    """Build the maps of a small city, and the protection levels of a few satellites."""
    ju.build_maps(ju.demo_city(400, 400), resolution_m=20.0, altitudes_m=(20.0, 60.0))
    levels_of(drawn(0, (5,)))


def paths() -> None:
    """Plan by every planner, on a plane and between levels."""
    plane, volume = (
        random_problem(0, shape, share_free=1.0, kind="line") for shape in ((6, 6), (2, 6, 6))
    )
    for problem, planners in ((plane, PLANNERS), (volume, VOLUME_PLANNERS)):
        for name in planners:
            find_planner(name, is_for_volumes=problem is volume)(problem, budget_s=0.05, seed=0)


if __name__ == "__main__":
    {"maps": maps, "paths": paths}[sys.argv[1]]()
