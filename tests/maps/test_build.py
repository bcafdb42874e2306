"""What the maps of a whole city obey, and what sections of a scenario ask for."""

import numpy as np
import pytest
import xarray as xr

import jaxurban as ju
from jaxurban.errors import InputError
from jaxurban.io.files import read_json
from jaxurban.knowledge import guesses_to
from jaxurban.maps.provenance import run_key
from jaxurban.maps.run import run_scenario
from jaxurban.maps.scenario import Scenario
from jaxurban.metrics.protection import Protection
from jaxurban.metrics.registry import ON_REQUEST
from jaxurban.settings import SLABS, TO_GROUND
from tests.made_maps import city_of_boxes


@pytest.fixture(scope="module")
def city() -> ju.City:
    return ju.demo_city(1_500, 1_500)


@pytest.fixture(scope="module")
def maps(city) -> ju.MetricMaps:
    return ju.build_maps(city, resolution_m=10.0)


def test_values_are_metrics_and_a_cell_is_an_obstacle_exactly_where_a_roof_reaches_it(maps):
    for altitude_m in maps.altitudes_m:
        for name in ("gps", "lidar", "risk", "population"):
            values = maps.m(name, altitude_m)[maps.is_free(altitude_m, "centre")]
            assert ((values >= 0) & (values <= 1)).all()
        np.testing.assert_array_equal(
            maps.m("obstacle", altitude_m) == 1, maps.m("roof") >= altitude_m
        )
    assert (maps.ds.attrs["risk_threshold_m"], maps.ds.attrs["risk_distance"]) == (50.0, "slice")


def test_gps_improves_and_lidar_fades_with_altitude(maps):
    gps, lidar = (
        [float(maps.m(name, z).mean()) for z in maps.altitudes_m] for name in ("gps", "lidar")
    )
    assert gps == sorted(gps)
    assert lidar == sorted(lidar, reverse=True)
    assert lidar[-1] == 0.0  # nothing stands within 100 m of 600 m


def test_maps_and_cities_show_what_they_are(city, maps):
    assert repr(maps).startswith(
        "MetricMaps(grid: 150 x 150 cells of 10 m; CRS: EPSG:32618; altitudes: 20, 60, 122, "
    )
    assert "metrics: gps, lidar, population, risk" in repr(maps)
    assert "'gps': <GPS quality: 1 means" in repr(maps.metrics)
    assert " at 0x" not in repr(maps.metrics)
    assert repr(city).startswith("City(CRS: EPSG:32618; extent: 1.5 x 1.5 km; buildings: ")
    for shown in (maps, city):
        assert all(
            f"<th>{name}</th>" in shown._repr_html_() for name, fact in shown.facts.items() if fact
        )


def test_maps_with_an_own_layer_are_written_as_netcdf_by_xarray_alone(tmp_path):
    layer = ju.Layer(source=np.ones((10, 10)), cost="high-is-bad", scale=(0.0, 80.0))
    made = ju.build_maps(
        ju.demo_city(500, 500), resolution_m=50, altitudes_m=[20.0], layers={"roofs": layer}
    )
    made.ds.to_netcdf(tmp_path / "maps.nc", engine="scipy")
    with xr.open_dataset(tmp_path / "maps.nc", engine="scipy") as read:
        np.testing.assert_array_equal(read["gps"], made.ds["gps"])
        assert read.attrs["guesses"] == guesses_to(made.guesses)


def test_a_lone_tower_shadows_the_north_more_than_the_south_and_endangers_what_stands_near():
    # Seen from New York most GPS satellites stand in the south: their orbits are inclined by 55 degrees.
    gps = ju.Gps(
        times=[f"2020-04-27T{hour:02d}:00:00Z" for hour in range(0, 24, 4)],
        reference=(-75.0, 40.65),
    )
    city = city_of_boxes([(180, 180, 220, 220)], 200.0, 400.0, (500_000.0, 4_500_000.0))
    maps = ju.build_maps(city, resolution_m=10.0, altitudes_m=(20.0, 250.0), gps=gps)
    assert maps.m("risk", 20.0)[20, 23] == pytest.approx(
        20.0 / 50.0
    )  # two cells east of the wall's last one
    assert (maps.m("risk", 250.0) == 1.0).all()
    seen, open_sky = maps.ds["num_visible"].values.astype(int).sum(axis=0)
    assert (open_sky == seen.max()).all()  # above the roof nothing is hidden
    assert 0 < seen[seen > 0].min() < seen.max()
    assert seen[22:32, 18:22].sum() < seen[8:18, 18:22].sum()
    assert tuple(maps.metrics) == ("gps", "lidar", "risk")  # no people, no population
    with pytest.raises(InputError, match="hold no 'population'"):
        maps.m("population")
    with pytest.raises(InputError, match="2020-04-27T20:00:00Z"):
        maps.m("gdop", 20.0, time="2021-01-01T00:00:00Z")


def test_normalised_map_spans_free_cells(maps):
    h = maps.normalised(20.0, time_of_day="day")
    free = maps.is_free(20.0, "centre")
    assert np.isnan(h[~free]).all()
    np.testing.assert_allclose((h[free].min(), h[free].max()), (0.0, 1.0), atol=1e-6)


@pytest.mark.slow
def test_one_run_over_several_resolutions_shares_its_box(tmp_path):
    region = {
        "bounds": [-74.0, 40.755, -73.995, 40.76],
        "resolution_m": [20, 10],
        "altitudes_m": 20,
    }
    scenario = Scenario.from_dict({"region": region, "buildings": {"source": "synthetic"}})
    run = run_scenario(scenario, tmp_path)
    assert len({maps.grid.bounds_m for maps in run.maps.values()}) == 1
    assert read_json(tmp_path / "run.json") == run.record
    with pytest.raises(InputError, match="choose one"):
        ju.open_maps(tmp_path)
    assert ju.open_maps(tmp_path, 10.0).grid.resolution_m == 10.0


BOUNDS = [-74.02, 40.70, -73.98, 40.73]


def of(**sections) -> Scenario:
    return Scenario.from_dict(
        {"region": {"bounds": BOUNDS}, "buildings": {"source": "x.osm"}} | sections
    )


def hanging(how: str) -> dict:
    return {"buildings": {"source": "x.osm", "hanging": how}}


def test_a_runs_key_tells_clocks_metrics_and_slabs_apart():
    others = {"gps": {"clocks": "one"}}, {"gps_horizontal": {}}, hanging(SLABS)
    plain, same, *keys = (
        run_key(of(**more), {}, "cpu") for more in ({}, hanging(TO_GROUND), *others)
    )
    assert same == plain
    assert len({plain, *keys}) == 1 + len(others)


@pytest.mark.parametrize("name", ON_REQUEST)
def test_a_section_or_a_weight_asks_for_a_metric_on_request(name):
    by_weight = ({"weights": {name: 2.0}}, 1), ({"weights": {name: 0}}, 0)
    for sections, is_there in (
        ({}, 0),
        ({name: {}}, 1),
        *(by_weight if ON_REQUEST[name].is_cost else ()),
    ):
        scenario = of(**sections)
        assert getattr(scenario, name) == (ON_REQUEST[name].params() if is_there else None)
        assert (
            (name in scenario.map_params.sections)
            == (f"[{name}]" in scenario.to_toml())
            == bool(is_there)
        )
        assert is_there or name not in scenario.model_dump()
    assert of(protection={"horizontal_alert_limit_m": 25}).protection == Protection(
        horizontal_alert_limit_m=25.0
    )


@pytest.mark.parametrize(
    ("sections", "words"),
    [
        ({"protection": {"isd": {"p_sat": 2}}}, r"protection.*p_sat must be a probability"),
        (hanging("floating"), r"buildings\.hanging"),
        (
            {"region": {"bounds": BOUNDS, "oversample": 4}, "gps": {"bounds": True}},
            "odd oversample",
        ),
    ],
)
def test_a_wrong_section_is_one_sentence(sections, words):
    with pytest.raises(InputError, match=words):
        of(**sections)
