"""How long a run says it takes."""

from dataclasses import replace

import pytest

from jaxurban.maps.duration import foretold_s, told
from jaxurban.maps.task import MapTask
from jaxurban.world.grid import Grid
from tests import tiled_runs


@pytest.fixture(scope="module")
def task() -> MapTask:
    """300 x 280 cells of 4 m amid buildings."""
    city = tiled_runs.city()
    first_col, first_row = (int(value // 4) + 40 for value in city.extent_m[:2])
    return MapTask(city, Grid(city.crs, 4.0, first_row, first_col, 300, 280), tiled_runs.sky(), tiled_runs.params())


def test_the_time_grows_with_what_is_made_and_shrinks_with_cores(task):
    alone = foretold_s([task])
    assert alone > 0
    assert foretold_s([task, task]) == pytest.approx(2 * alone)
    assert foretold_s([task], num_workers=2) == pytest.approx(alone / 2)
    larger = replace(task, region=replace(task.region, num_rows=600))
    assert foretold_s([larger]) == pytest.approx(2 * alone)
    more = tuple(range(20, 20 + 10 * 2 * len(task.params.altitudes_m), 10))
    higher = replace(task, params=replace(task.params, altitudes_m=more))
    assert 1.5 * alone < foretold_s([higher]) < 2.5 * alone
    assert foretold_s([replace(task, params=replace(task.params, oversample=2))]) > alone
    assert foretold_s([task], ("all",)) > alone


@pytest.mark.parametrize(
    ("seconds", "said"),
    [(3, "a few seconds"), (47, "about 50 s"), (600, "about 10 min"), (9000, "about 2.5 h")],
)
def test_it_is_told_as_people_read_it(seconds, said):
    assert told(seconds) == said
