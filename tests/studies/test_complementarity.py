"""Complementarity of GPS and lidar, on maps made so that the answer is known."""

import numpy as np
import pytest

from jaxurban.studies.montecarlo.analysis import complementarity
from tests.made_maps import made_maps


@pytest.fixture
def maps():
    """Maps where GPS is poor in the west, lidar good there; higher up less of both."""
    made = made_maps(300, 240)
    rng = np.random.default_rng(5)
    for level, share in enumerate((0.5, 0.2)):
        is_west = np.arange(240) < share * 240
        shape = (300, 240)
        made.ds["gps"][0, level] = np.where(is_west, 0.3, 0.9) + rng.uniform(-0.1, 0.1, shape)
        made.ds["lidar"][level] = np.where(is_west, 0.8, 0.1 - 0.05 * level) + rng.uniform(0, 0.05, shape)
    return made


def test_numbers_are_those_of_numpy_over_the_free_cells(maps):
    found = complementarity(maps).set_index("altitude_m")
    for altitude_m in maps.altitudes_m:
        is_free = maps.is_free(altitude_m, "centre")
        gps, lidar = (maps.m(name, altitude_m)[is_free].astype(float) for name in ("gps", "lidar"))
        row = found.loc[altitude_m]
        assert row.gps == pytest.approx(gps.mean())
        assert row.correlation == pytest.approx(np.corrcoef(gps, lidar)[0, 1])
        assert row.correlation_low <= row.correlation <= row.correlation_high
        assert row.lidar_where_gps_poor == pytest.approx(lidar[gps < 0.5].mean())
        assert row.lidar_where_gps_good == pytest.approx(lidar[gps >= 0.5].mean())
        assert row.either_serves == pytest.approx(((gps >= 0.5) | (lidar >= 0.5)).mean())


def test_altitudes_can_be_chosen(maps):
    assert complementarity(maps, altitudes_m=[60]).altitude_m.tolist() == [60.0]


def test_a_few_tiles_give_no_interval():
    table = complementarity(made_maps(100, 90))
    assert table.correlation.notna().all()
    assert table.correlation_low.isna().all()


def test_nothing_is_said_of_a_sky_without_buildings(maps):
    maps.ds["gps"][:] = 0.95
    maps.ds["lidar"][:] = 0.0
    table = complementarity(maps)
    assert table.correlation.isna().all()
    assert table.lidar_where_gps_poor.isna().all()
