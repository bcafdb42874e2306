"""Gammas from a known total, on the census of Manhattan and on a handful of blocks."""

import numpy as np
import pytest
import shapely

from jaxurban.errors import InputError
from jaxurban.io.read.census import CensusFiles, read_blocks
from jaxurban.metrics.population import PopulationParams, population_totals
from jaxurban.studies.tuning.calibration import calibrate_gamma
from jaxurban.world.city import Blocks, Zoning


def blocks_of(commercial, residential):
    """Blocks of 100 m with so many people each."""
    counts = [*commercial, *residential]
    boxes = np.array([shapely.box(100 * i, 0, 100 * i + 100, 100) for i in range(len(counts))])
    zoning = [Zoning.COMMERCIAL] * len(commercial) + [Zoning.RESIDENTIAL] * len(residential)
    num = len(counts)
    return Blocks(
        boxes,
        np.array(counts, float),
        np.zeros(num, np.int32),
        np.array(zoning, np.uint8),
        np.arange(num).astype(object),
    )


BLOCKS = blocks_of([100, 200], [50, 350])


def test_the_gamma_found_gives_the_total():
    found = calibrate_gamma(BLOCKS, 1100, {"residential": 0.5})
    assert found.is_unique
    assert found.params.gamma_commercial == pytest.approx((1100 - 0.5 * 400) / 300, rel=1e-12)
    assert population_totals(BLOCKS, found.params)["day"]["total"] == pytest.approx(1100, rel=1e-12)
    other = calibrate_gamma(BLOCKS, 1100, {"commercial": 3.0}, params=PopulationParams(quantity="count"))
    assert other.params.gamma_residential == pytest.approx(0.5)
    assert (other.params.gamma_commercial, other.params.quantity) == (3.0, "count")


def test_an_hour_of_half_the_change_counts_half():
    found = calibrate_gamma(BLOCKS, 900, {"residential": 1.0}, time_of_day="weekday-08")  # two thirds of the change
    assert found.params.gamma_commercial == pytest.approx(1 + 200 / (300 * 2 / 3))


def test_only_the_blocks_of_a_box_count():
    found = calibrate_gamma(BLOCKS, 500, {"residential": 0.5}, bounds_m=(110.0, 0.0, 290.0, 100.0))
    assert found.params.gamma_commercial == pytest.approx((500 - 0.5 * 50) / 200)


def test_one_total_cannot_fix_two_gammas_and_the_line_of_solutions_comes_back():
    found = calibrate_gamma(BLOCKS, 1200)
    assert not found.is_unique
    assert found.params is None
    assert "cannot fix two gammas" in found.sentence
    for share in (0.0, 0.3, 1.0):
        commercial, residential = (1 - share) * found.solutions[0] + share * found.solutions[1]
        day = population_totals(BLOCKS, PopulationParams(float(commercial), float(residential)))["day"]
        assert day["total"] == pytest.approx(1200)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((100, {"residential": 0.5}), r"cannot be reached with gamma_residential held at 0.5.*-0.333"),
        ((1100, {"residential": 0.5, "commercial": 3.0}), "nothing is left to fit"),
        ((1100, {"residental": 0.5}), "residential"),
        ((1100, {"residential": -0.5}), "not negative"),
        ((float("nan"), {"residential": 0.5}), "target_total"),
    ],
)
def test_what_cannot_be_is_said_plainly(arguments, message):
    with pytest.raises(InputError, match=message):
        calibrate_gamma(BLOCKS, *arguments)


def test_where_nobody_lives_no_gamma_helps():
    with pytest.raises(InputError, match="nobody lives in commercial blocks"):
        calibrate_gamma(blocks_of([0], [100]), 300, {"residential": 0.5})
    with pytest.raises(InputError, match="census count stands"):
        calibrate_gamma(BLOCKS, 300, {"residential": 0.5}, time_of_day="night")


@pytest.mark.data
def test_manhattan_holds_the_published_day_total(data_dir):
    census = data_dir / "census"
    blocks, _ = read_blocks(
        CensusFiles(
            census / "tl_2010_36061_tabblock10.shp",
            census / "DECENNIALSF12010.P1_nyc_blocks.csv",
            districts=data_dir / "districts" / "nyc_community_districts.geojson",
            district_field="BoroCD",
            commercial=(101, 102, 103, 104, 105, 106),
        ),
        "EPSG:32618",
    )
    found = calibrate_gamma(blocks, 3.94e6, {"residential": 0.5})
    # 611,934 people live in commercial districts, of 1,585,873.
    assert found.params.gamma_commercial == pytest.approx((3.94e6 - 0.5 * (1_585_873 - 611_934)) / 611_934, rel=1e-9)
    assert population_totals(blocks, found.params)["day"]["total"] == pytest.approx(3.94e6, rel=1e-12)
