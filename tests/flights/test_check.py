"""check: missions with planted faults and clean ones, against points sampled every 20 cm and looked up one by one."""

import json
import re
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pandas as pd
import pytest
import shapely
import xarray as xr
from matplotlib.legend import Legend
from scipy.interpolate import RegularGridInterpolator

import jaxurban as ju
from jaxurban.flights.missions.parts import GEOD, Leg, Mission, Place
from jaxurban.flights.report import check_report, plot_flown_heights, plot_mission
from jaxurban.io.city import City
from jaxurban.io.zone import Zone
from jaxurban.knowledge import Guess, GuessKind
from jaxurban.planners.base import Status
from jaxurban.settings import parse_time
from jaxurban.world.footprints import Footprints, HeightOrigin
from jaxurban.world.raster import Raster
from tests.guess_records import attribute
from tests.made_maps import made_maps, maps_of_kinds
from tests.volumes import ends_at

SIDE_M, GEOID_M, CLEARANCE_M = 600.0, 37.0, 4.0
DENSE_M = 0.2  # between the points that tell the truth
FEW_M = 5.0  # a finding lies so near its first contact
ON, OFF = "2020-04-27T16:00:00Z", "2020-04-29T16:00:00Z"


class Scene(NamedTuple):
    """Maps with hills, and their city: houses turned by any angle, some hanging, and a zone over a part."""

    maps: ju.MetricMaps
    city: City
    zone: Zone
    corner_m: np.ndarray

    def place(self, x_m: float, y_m: float, height_m: float, datum: str = "ground") -> Place:
        """Return a place in metres from the corner of the maps."""
        lon, lat = self.maps.grid.lonlat_of_xy(*np.add(self.corner_m, (x_m, y_m)))
        return Place(float(lon), float(lat), height_m, datum)

    def ground_m(self, x_m, y_m) -> np.ndarray:
        """Return the ground at places from the corner, by SciPy."""
        ground_m, side_m = self.maps.m("terrain"), self.maps.grid.resolution_m
        centres_m = (np.arange(len(ground_m)) + 0.5) * side_m
        inside = np.clip(np.stack([y_m, x_m], axis=-1), centres_m[0], centres_m[-1])
        return RegularGridInterpolator((centres_m, centres_m), ground_m)(inside)

    def base_m(self, place: Place, home: Place) -> float:
        """Return the elevation of the zero of a place's datum."""
        x_m, y_m = self.xy_m(place if place.datum == "ground" else home)
        level_m = self.ground_m(x_m, y_m).item()
        return {"geoid": 0.0, "ellipsoid": -GEOID_M}.get(place.datum, level_m)

    def xy_m(self, place: Place) -> np.ndarray:
        """Return x and y of a place, from the corner."""
        return np.array(self.maps.grid.xy_of_lonlat(*place[:2])) - self.corner_m


@pytest.fixture(scope="module")
def scene() -> Scene:
    rng = np.random.default_rng(46)
    maps = made_maps(60, 60, (0.5, 400.0))
    row, col = np.indices(maps.grid.shape)
    hills_m = 30 + 12 * np.sin(row / 9) + 8 * np.cos(col / 7) + 0.3 * row
    ds = maps.ds.assign(terrain=(("y", "x"), hills_m.astype(np.float32)))
    later = ds["time"] + np.timedelta64(2, "D")
    timed = [name for name in ds if "time" in ds[name].dims]
    more = ds[timed].assign_coords(time=later)
    both = xr.concat([ds[timed], more], "time", join="exact")
    maps = replace(maps, ds=ds.drop_dims("time").assign(both))
    corner_m = np.array([maps.grid.x_min_m, maps.grid.y_min_m])
    centres_m = np.stack(np.meshgrid(*[np.arange(60, 600, 80)] * 2), axis=-1).reshape(-1, 2)
    outlines = []
    for centre_m in centres_m:
        width_m, depth_m = rng.uniform(12, 30, 2)
        box = shapely.box(-width_m / 2, -depth_m / 2, width_m / 2, depth_m / 2)
        turned = shapely.affinity.rotate(box, rng.uniform(0, 90), origin=(0, 0))
        outlines.append(shapely.affinity.translate(turned, *(centre_m + corner_m)))
    num = len(outlines)
    floor_m = np.where(np.arange(num) % 9 == 4, 8.0, 0.0)
    height_m = rng.choice([12.0, 25.0, 40.0, 90.0], num)
    origin = np.full(num, HeightOrigin.HEIGHT, np.uint8)
    buildings = Footprints(np.array(outlines), height_m, floor_m, origin, floor_m > 0)
    extent_m = (*corner_m, *(corner_m + SIDE_M))
    grid = maps.grid  # the file's pixels are the cells, from the north
    transform = (
        grid.resolution_m,
        0.0,
        grid.x_min_m,
        0.0,
        -grid.resolution_m,
        corner_m[1] + SIDE_M,
    )
    terrain = Raster(hills_m[::-1].astype(np.float32), transform, grid.crs)
    city = City(maps.grid.crs, extent_m, buildings, hanging="slabs", terrain=terrain)
    over = shapely.box(*np.add(corner_m, 400), *np.add(corner_m, (560, 590)))
    hours = parse_time("2020-04-27T12:00:00Z"), parse_time("2020-04-27T18:00:00Z")
    zone = Zone("stadium", over, maps.grid.crs, 0.0, 150.0, "", *hours)
    return Scene(maps, city, zone, corner_m)


class Truth(NamedTuple):
    """What points every 20 cm along a mission meet, one by one: ``[N]`` each, in the order of travel."""

    xy_m: np.ndarray
    hit: np.ndarray
    near: np.ndarray
    buried: np.ndarray
    in_zone: np.ndarray
    slack_m: np.ndarray  # [3] how much farther than asked from buildings, the ground and the zone


def truth_of(scene: Scene, mission: Mission, clearance_m: float, time: str) -> Truth:
    """Return the truth of a mission, by looking every point up against every prism."""
    lines = []
    home = Place(*mission.home, 0.0, "ground")
    for leg in mission.legs:
        ends_m = np.array([scene.xy_m(leg.start), scene.xy_m(leg.end)])
        follows = leg.end.datum == "ground"  # a leg is flown in the frame of its end
        z_m = np.array([leg.start.height_m, leg.end.height_m])
        z_m += np.array([scene.base_m(leg.start, home), scene.base_m(leg.end, home)])
        if follows:
            z_m -= scene.ground_m(*ends_m.T)
        length_m = np.hypot(np.linalg.norm(ends_m[1] - ends_m[0]), z_m[1] - z_m[0])
        share = np.linspace(0, 1, max(2, int(length_m / DENSE_M)))[:, None]
        xy_m = ends_m[0] + share * (ends_m[1] - ends_m[0])
        above_m = z_m[0] + share[:, 0] * (z_m[1] - z_m[0])
        ground_m = scene.ground_m(*xy_m.T)
        z_m = above_m if follows else above_m - ground_m
        lines.append(np.column_stack([xy_m, z_m, ground_m, np.full(len(xy_m), leg.kind == "leg")]))
    x_m, y_m, z_m, ground_m, is_leg = np.concatenate(lines).T
    held = scene.city.buildings
    hit, near = np.zeros(len(x_m), bool), np.zeros(len(x_m), bool)
    slack_m = np.full(len(x_m), np.inf)
    points = shapely.points(x_m + scene.corner_m[0], y_m + scene.corner_m[1])
    for outline, top_m, floor_m in zip(
        held.polygons, held.height_m, held.min_height_m, strict=True
    ):
        apart_m = shapely.distance(points, outline)
        beside = (apart_m > 0) & (apart_m < 20)  # it stands on the ground at its nearest point
        foot = shapely.get_coordinates(shapely.shortest_line(outline, points[beside]))[::2]
        ground_there_m = ground_m.copy()
        ground_there_m[beside] = scene.ground_m(*(foot - scene.corner_m).T)
        above_m = np.where(apart_m > 0, z_m + ground_m - ground_there_m, z_m)
        bottom_m = floor_m if floor_m else -np.inf
        gap_m = np.maximum(above_m - top_m, bottom_m - above_m)
        hit |= (apart_m == 0) & (gap_m <= 0)
        near |= (apart_m <= clearance_m) & (gap_m < 3.0)
        signed_m = np.where(apart_m > 0, apart_m, -shapely.distance(points, outline.boundary))
        slack_m = np.minimum(slack_m, np.maximum(signed_m - clearance_m, gap_m - 3.0))
    zone = scene.zone
    is_on = time == ON
    from_zone_m = np.maximum(shapely.distance(points, zone.polygon), z_m - zone.ceiling_m)
    in_zone = is_on & (from_zone_m <= 0)
    least_m = [slack_m.min(), np.where(is_leg, z_m - 0.5, np.inf).min()]
    least_m.append(from_zone_m.min() if is_on else np.inf)
    return Truth(np.column_stack([x_m, y_m]), hit, near, z_m < -0.05, in_zone, np.array(least_m))


def first_contacts(truth: Truth, flags: np.ndarray) -> np.ndarray:
    """Return where each stretch of flagged points begins ``[K, 2]``."""
    begins = flags & ~np.append(False, flags[:-1])
    return truth.xy_m[begins]


def mission_of(*places: Place, home: Place, kind: str = "leg") -> Mission:
    """Return a mission through places, as it leaves home straight up and lands below the last place."""
    climb = Leg(
        home._replace(height_m=0.0, datum="ground"),
        places[0]._replace(lon=home.lon, lat=home.lat),
        "climb",
        1,
    )
    ways = [climb.end, *places[1:]]
    legs = [Leg(a, b, kind, n) for n, (a, b) in enumerate(pairwise(ways), 2)]
    ground = ways[-1]._replace(height_m=0.0, datum="ground")
    landing = Leg(ways[-1], ground, "land", len(legs) + 2)
    return Mission("made", (climb, *legs, landing), home[:2], None, (), None)


DATUMS = ("ground", "home", "geoid", "ellipsoid")


def random_mission(scene: Scene, rng: np.random.Generator) -> Mission:
    """Return a mission through streets or over roofs, in any mixture of datums."""
    places: list[Place] = []
    last_m = np.zeros(2)
    corners_m = np.stack([np.arange(20, 600, 80)] * 2)
    for _ in range(rng.integers(2, 6)):
        x_m, y_m = rng.choice(corners_m[0]), rng.choice(corners_m[1])
        if places and rng.random() < 0.6:  # along the street, most often
            x_m = last_m[0]
        last_m = np.array([x_m, y_m]) + rng.uniform(-6, 6, 2)
        height_m, datum = rng.choice([15.0, 30.0, 60.0, 110.0]), rng.choice(DATUMS)
        place = scene.place(*last_m, height_m, str(datum))
        home = places[0] if places else place
        flown_m = height_m + scene.ground_m(*last_m).item() - scene.base_m(place, home)
        places.append(place if datum == "ground" else place._replace(height_m=flown_m))
    return mission_of(*places, home=places[0])


def checked(scene: Scene, mission, clearance_m=CLEARANCE_M, time=ON, **more):
    """Return the check of a mission over the scene."""
    limits = ju.Constraints(zones=(scene.zone,), clearance_m=clearance_m)
    is_on_ellipsoid = any(leg.end.datum == "ellipsoid" for leg in getattr(mission, "legs", ()))
    return ju.check(
        scene.maps,
        mission,
        constraints=limits,
        sources=scene.city,
        geoid_m=GEOID_M if is_on_ellipsoid else None,
        time=time,
        **more,
    )


def assert_all_found(scene: Scene, truth: Truth, result) -> None:
    """Check that each first contact has a finding within `FEW_M`, and each finding has a truth."""
    found = result.findings
    xy_m = (
        np.stack(scene.maps.grid.xy_of_lonlat(*found[["lon", "lat"]].to_numpy().T), axis=-1)
        - scene.corner_m
    )
    flags = {"building": truth.hit, "terrain": truth.buried, "zone": truth.in_zone}
    for kind, flag in flags.items():
        at_m = xy_m[(found["kind"] == kind).to_numpy()]
        for contact_m in first_contacts(truth, flag):
            assert len(at_m), kind
            assert np.linalg.norm(at_m - contact_m, axis=1).min() < FEW_M, kind
    near_m = xy_m[(found["kind"] == "building").to_numpy()]
    for place_m in near_m:
        distance_m = np.linalg.norm(truth.xy_m[truth.near | truth.hit] - place_m, axis=1)
        assert distance_m.min(initial=np.inf) < 1.0, "invented"
    assert bool(len(near_m)) == bool((truth.near | truth.hit).any())


@pytest.mark.slow
@pytest.mark.parametrize("clearance_m", [0.0, CLEARANCE_M])
def test_random_missions_are_judged_as_points_every_20_cm_are(scene, clearance_m):
    rng = np.random.default_rng(7)
    num_clean = num_faulty = 0
    while min(num_clean, num_faulty) < 12:  # `test_random_missions` draws many more
        mission, time = random_mission(scene, rng), str(rng.choice([ON, OFF]))
        truth = truth_of(scene, mission, clearance_m, time)
        is_faulty = truth.hit.any() or truth.near.any() or truth.buried.any() or truth.in_zone.any()
        if ((truth.slack_m > -1.0) & (truth.slack_m < 0.7)).any():
            continue  # too near to call
        result = checked(scene, mission, clearance_m, time)
        if is_faulty:
            num_faulty += 1
            assert result.state == "findings"
            assert_all_found(scene, truth, result)
        else:
            num_clean += 1
            assert result.state == "clean", result


@pytest.fixture(scope="module")
def open_scene(scene) -> Scene:
    """The scene on level ground."""
    maps = replace(scene.maps, ds=scene.maps.ds.drop_vars("terrain"))
    return scene._replace(maps=maps, city=replace(scene.city, terrain=None))


def kinds_of(result) -> list[str]:
    """Return the kinds of the findings."""
    return result.findings["kind"].tolist()


def test_a_leg_through_a_tower_is_one_finding_where_it_enters(open_scene):
    tower = open_scene.city.buildings.polygons[np.argmax(open_scene.city.buildings.height_m)]
    x_m, y_m = np.array(tower.centroid.coords[0]) - open_scene.corner_m
    ends = [open_scene.place(x_m, y_m + side_m, 60.0) for side_m in (-40, 40)]
    mission = mission_of(*ends, home=ends[0])
    found = checked(open_scene, mission, time=OFF).findings
    way = shapely.LineString([open_scene.xy_m(each) + open_scene.corner_m for each in ends])
    enters_m = np.array(way.intersection(tower).coords[0])
    at_m = np.stack(open_scene.maps.grid.xy_of_lonlat(*found[["lon", "lat"]].to_numpy().T), axis=-1)
    assert (found["kind"] == "building").all()
    assert found["building_m"].iloc[0] == 90.0
    assert np.linalg.norm(at_m - enters_m, axis=1).tolist() == pytest.approx([0.0], abs=0.6)
    assert found["by_m"].iloc[0] == pytest.approx(30.0)
    assert found["item"].tolist() == [2]


@pytest.mark.parametrize(
    ("above_m", "kinds"), [(1.0, ["building"]), (3.0, []), (-0.5, ["building"])]
)
def test_one_metre_over_a_roof_is_found_and_three_are_clear(open_scene, above_m, kinds):
    held = open_scene.city.buildings
    house = int(np.flatnonzero((held.height_m == 25.0) & (held.min_height_m == 0))[0])
    x_m, y_m = np.array(held.polygons[house].centroid.coords[0]) - open_scene.corner_m
    ends = [open_scene.place(x_m, y_m + side_m, 25.0 + above_m) for side_m in (-38, 38)]
    result = checked(open_scene, mission_of(*ends, home=ends[0]), time=OFF)
    assert kinds_of(result) == kinds
    short_m = 3.0 - above_m if above_m > 0 else -above_m
    assert result.findings["by_m"].tolist() == pytest.approx([short_m] * len(kinds), abs=1e-6)
    assert (result.state == "clean") == (not kinds)


def test_a_zone_counts_in_its_hours_and_its_heights(open_scene):
    ends = [open_scene.place(580.0, y_m, 110.0) for y_m in (300.0, 590.0)]
    ends[1] = open_scene.place(480.0, 500.0, 110.0)
    mission = mission_of(*ends, home=ends[0])
    assert kinds_of(checked(open_scene, mission, time=ON)) == ["zone"]
    assert kinds_of(checked(open_scene, mission, time=[OFF, ON])) == ["zone"]
    assert kinds_of(checked(open_scene, mission, time=OFF)) == []
    for time, is_said in ((ON, True), (OFF, False)):
        lines = checked(open_scene, mission, time=time).return_lines
        assert any("No-fly zones are not counted" in line for line in lines) == is_said


def test_heights_whose_zero_nobody_names_are_not_judged(scene):
    ends = [scene.place(20.0, y_m, 150.0, "home") for y_m in (20.0, 500.0)]
    mission = mission_of(*ends, home=ends[0])
    assert checked(scene, mission).state == "clean"
    homeless = checked(scene, replace(mission, home=None))
    assert (homeless.state, "name it (home, --home)" in homeless.not_judged[0]) == (
        "not-judged",
        True,
    )
    on_ellipsoid = replace(
        mission,
        legs=tuple(leg._replace(end=leg.end._replace(datum="ellipsoid")) for leg in mission.legs),
    )
    unnamed = ju.check(scene.maps, on_ellipsoid, sources=scene.city)
    assert (unnamed.state, "geoid_m, --heights geoid_m=METRES" in unnamed.not_judged[0]) == (
        "not-judged",
        True,
    )


def test_a_geoid_for_a_mission_without_a_height_above_the_ellipsoid_is_refused(scene):
    ends = [scene.place(20.0, y_m, 60.0, "geoid") for y_m in (20.0, 500.0)]
    with pytest.raises(ju.InputError, match="no height above the ellipsoid: leave geoid_m out"):
        ju.check(scene.maps, mission_of(*ends, home=ends[0]), sources=scene.city, geoid_m=5.0)


def test_an_undulation_that_is_left_out_would_hide_the_ground(scene):
    ends = [scene.place(20.0, y_m, 60.0, "ellipsoid") for y_m in (20.0, 500.0)]
    mission = mission_of(*ends, home=ends[0])
    as_geoid = ju.check(scene.maps, mission, sources=scene.city, geoid_m=0.0)
    assert (kinds_of(as_geoid), as_geoid.state) == ([], "clean")
    assert set(kinds_of(checked(scene, mission))) == {"terrain"}


def test_what_lies_outside_the_data_is_never_clean(open_scene):
    out = [open_scene.place(20.0, y_m, 60.0) for y_m in (20.0, 700.0)]
    result = checked(open_scene, mission_of(*out, home=out[0]), 0.0, OFF)
    assert (result.state, result.not_judged) == (
        "not-judged",
        ["160 m lie outside the maps."],
    )
    far = [Place(lon, 0.0, 60.0, "ground") for lon in (10.0, 10.01)]
    assert checked(open_scene, mission_of(*far, home=far[0])).state == "not-judged"
    maps = open_scene.maps
    bare = maps.ds["has_data"].copy()
    bare[20:30] = False
    holed = open_scene._replace(maps=replace(maps, ds=maps.ds.assign(has_data=bare)))
    within = [open_scene.place(20.0, y_m, 60.0) for y_m in (20.0, 500.0)]
    result = checked(holed, mission_of(*within, home=within[0]), time=OFF)
    lon, lat = open_scene.place(20.0, 200.0, 60.0)[:2]
    words = f"It begins 240 m along the mission, toward item 2, at {lon:.6f}, {lat:.6f}."
    assert result.state == "not-judged"
    assert result.not_judged == [f"100 m lie over cells without data. {words}"]
    (row,) = result.to_dict()["unjudged"]
    assert (row["kind"], row["item"]) == ("data", 2)
    assert (row["along_m"], row["to_m"]) == pytest.approx((240.0, 340.0))
    assert (row["lon"], row["lat"]) == pytest.approx((lon, lat), abs=1e-8)
    high = [place._replace(height_m=450.0) for place in within]
    assert "above the maps" in checked(open_scene, mission_of(*high, home=high[0])).not_judged[0]


def test_a_mission_that_lies_elsewhere_says_where_it_and_the_maps_lie_and_what_looks_swapped(
    open_scene,
):
    lon, lat = open_scene.maps.grid.lonlat_of_cell(4, 4)
    zurich = [Place(8.54 + east, 47.39, 60.0, "ground") for east in (0.0, 0.01)]
    swapped = [Place(lat, lon + east, 60.0, "ground") for east in (0.0, 0.0001)]
    words = "Nothing was judged, as the mission lies elsewhere: the point {} is outside the region, which spans about "
    for places, point, is_swapped in ((zurich, "8.54, 47.39", False), (swapped, f"{lat}, ", True)):
        result = checked(open_scene, mission_of(*places, home=places[0]))
        assert result.state == "not-judged"
        assert result.sentence.startswith(words.partition("{}")[0] + point)
        assert ("longitude and latitude look swapped" in result.sentence) == is_swapped
        nothing_m = f"not known on {result.figures['length_m']:,.0f} m"
        texts = [result.facts.get(name) for name in ("no fix", "people overflown")]
        assert texts == [nothing_m] * 2
        assert "densest kilometre" not in result.facts
        assert (
            any(text.startswith("Home lies elsewhere") for text in result.not_judged) == is_swapped
        )


def test_an_item_with_swapped_coordinates_is_said_where_the_take_off_is_judged(open_scene):
    lon, lat = open_scene.maps.grid.lonlat_of_cell(4, 4)
    ends = [Place(lon, lat, 60.0, "ground"), Place(lat, lon, 60.0, "ground")]
    away = ends[1]._replace(lon=8.54, lat=47.39)
    for end, num_said in ((ends[1], 1), (away, 0)):
        result = checked(open_scene, mission_of(ends[0], end, home=ends[0]))
        said = [text for text in result.not_judged if "look swapped" in text]
        assert (result.state != "clean", len(said)) == (True, num_said)
        assert said == [] or said[0].startswith(f"Item 2 lies elsewhere: the point {lat}, {lon} ")


def test_the_return_is_said_after_all_of_the_mission(open_scene, tmp_path):
    ends = [open_scene.place(20.0, y_m, 150.0) for y_m in (20.0, 500.0)]
    result = checked(open_scene, mission_of(*ends, home=ends[0]))
    names = [line.strip().partition(":")[0] for line in result.lines]
    assert names[-len(result.return_lines) :] == ["return"] * len(result.return_lines)
    result.save(tmp_path / "checked")
    page = (tmp_path / "checked/report.md").read_text()
    assert page.index("## Findings") < page.index("## The mission") < page.index("## Return")


def test_where_the_source_of_buildings_ends_nothing_is_clean(open_scene):
    west, south, east, north = open_scene.city.extent_m
    half = replace(open_scene.city, extent_m=(west, south, east, north - 300))
    ends = [open_scene.place(20.0, y_m, 150.0) for y_m in (20.0, 500.0)]
    mission = mission_of(*ends, home=ends[0])
    result = checked(open_scene._replace(city=half), mission, 0.0, OFF)
    reason = "350 m lie where the source of the buildings does not know what stands."
    assert result.state == "not-judged"
    assert [text.partition(" It begins")[0] for text in result.not_judged] == [reason]
    guesses = attribute(Guess(GuessKind.WITHOUT_DATA, 0.5))
    maps = open_scene.maps
    bare = maps.ds.assign(roof_touched=0 * maps.ds["roof_touched"])
    assert ju.check(replace(maps, ds=bare), mission).state == "clean"
    unsure = replace(maps, ds=bare.assign_attrs(guesses))
    assert ju.check(unsure, mission).state == "not-judged"


def test_what_stands_nobody_knows_where_leaves_no_flight_clean(open_scene):
    street = [open_scene.place(20.0, y_m, 150.0) for y_m in (20.0, 500.0)]
    mission = mission_of(*street, home=street[0])
    assert checked(open_scene, mission, 0.0, OFF).state == "clean"
    guesses = attribute(Guess(GuessKind.WITHOUT_SHAPE, number=2))
    maps = open_scene.maps
    unsure = replace(maps, ds=maps.ds.assign_attrs(guesses))
    result = checked(open_scene._replace(maps=unsure), mission, 0.0, OFF)
    assert (result.state, result.not_judged) == ("not-judged", ["2 objects without a shape."])


def test_a_guessed_roof_is_not_judged_from_any_height(open_scene):
    held = open_scene.city.buildings
    guessed = replace(held, origin=np.full(len(held), HeightOrigin.LEVELS, np.uint8))
    unsure = open_scene._replace(city=replace(open_scene.city, buildings=guessed))
    x_m, y_m = np.array(held.polygons[0].centroid.coords[0]) - open_scene.corner_m
    over = [open_scene.place(x_m, y_m + side_m, 380.0) for side_m in (-38, 38)]
    assert checked(open_scene, mission_of(*over, home=over[0]), time=OFF).state == "clean"
    result = checked(unsure, mission_of(*over, home=over[0]), time=OFF)
    assert (result.state, "guessed" in result.not_judged[0]) == ("not-judged", True)
    street = [open_scene.place(20.0, y_m, 20.0) for y_m in (20.0, 500.0)]
    assert checked(unsure, mission_of(*street, home=street[0]), time=OFF).state == "clean"


def test_a_loiter_is_judged_all_round(open_scene):
    held = open_scene.city.buildings
    tower = int(np.argmax(held.height_m))
    x_m, y_m = np.array(held.polygons[tower].centroid.coords[0]) - open_scene.corner_m
    centre = open_scene.place(x_m + 40.0, y_m + 40.0, 60.0)
    mission = mission_of(centre, centre, home=centre)
    assert kinds_of(checked(open_scene, mission, time=OFF)) == []
    circle = mission.legs[1]._replace(kind="loiter", radius_m=40 * 2**0.5)
    round_it = replace(mission, legs=(mission.legs[0], circle, mission.legs[-1]))
    assert kinds_of(checked(open_scene, round_it, time=OFF)).count("building") >= 1


def plan_text(scene: Scene, places_m: np.ndarray, geofence: dict, firmware: int = 12) -> str:
    """Return a plan of QGroundControl through places, 380 m above home, with a geofence."""
    lonlats = [np.round(scene.place(*xy_m, 0.0)[:2], 8).tolist() for xy_m in places_m]
    items = []
    for number, (lon, lat) in enumerate([*lonlats, lonlats[-1]], 1):
        command = {1: 22, len(lonlats) + 1: 21}.get(number, 16)
        height_m = 0 if command == 21 else 380
        row = {"type": "SimpleItem", "doJumpId": number, "command": command, "frame": 3}
        items.append(row | {"params": [0, 0, 0, 0, lat, lon, height_m]})
    home = [*lonlats[0][::-1], 0]
    mission = {"version": 2, "firmwareType": firmware, "items": items, "plannedHomePosition": home}
    fence = {"version": 2, "polygons": [], "circles": []} | geofence
    plan = {"fileType": "Plan", "version": 1, "mission": mission, "geoFence": fence}
    return json.dumps(plan)


def random_geofence(scene: Scene, rng: np.random.Generator) -> dict:
    """Return one to three polygons and circles, each to keep out of or to stay in; corners may cross."""
    fence: dict = {"polygons": [], "circles": []}
    for _ in range(rng.integers(1, 4)):
        is_inclusion, size_m = bool(rng.random() < 0.4), rng.uniform(30, 150)
        centre_m = np.full(2, 300.0) if is_inclusion else rng.uniform(50, 550, 2)
        size_m += 200.0 * is_inclusion
        if rng.random() < 0.5:
            lon, lat = scene.place(*centre_m, 0.0)[:2]
            circle = {"center": [lat, lon], "radius": size_m}
            fence["circles"].append({"inclusion": is_inclusion, "circle": circle, "version": 1})
            continue
        corners_m = centre_m + rng.uniform(-size_m, size_m, (rng.integers(3, 7), 2))
        corners = [scene.place(*xy_m, 0.0)[1::-1] for xy_m in corners_m]
        fence["polygons"].append({"inclusion": is_inclusion, "polygon": corners, "version": 1})
    return fence


def is_in_area(part: dict, lon: np.ndarray, lat: np.ndarray) -> np.ndarray:
    """Return which places are in an area of a geofence: by their distance, or by counting crossings."""
    if "circle" in part:
        centre = np.full((len(lon), 2), part["circle"]["center"])
        return GEOD.inv(lon, lat, *centre.T[::-1])[2] <= part["circle"]["radius"]
    is_in = np.zeros(len(lon), bool)
    corners = [corner[::-1] for corner in part["polygon"]]
    for (lon_a, lat_a), (lon_b, lat_b) in pairwise([*corners, corners[0]]):
        if lat_a != lat_b:
            east = lon_a + (lat - lat_a) / (lat_b - lat_a) * (lon_b - lon_a)
            is_in ^= ((lat_a > lat) != (lat_b > lat)) & (lon < east)
    return is_in


@pytest.mark.slow
def test_geofences_of_a_file_are_judged_as_points_every_20_cm_are(open_scene, tmp_path):
    rng = np.random.default_rng(5)
    kinds = {"clean": 0, "breached": 0}
    for number in range(16):
        places_m = rng.uniform(60, 540, (3, 2))
        geofence = random_geofence(open_scene, rng)
        firmware = (3, 12)[number % 2]
        file = tmp_path / f"{number}.plan"
        file.write_text(plan_text(open_scene, places_m, geofence, firmware))
        found = checked(open_scene, file, time=OFF).findings.query("kind == 'zone'")

        # The truth: a place breaches an exclusion, or one of the inclusions.
        legs_m = [
            np.linspace(a, b, 2 + int(np.linalg.norm(b - a) / DENSE_M))
            for a, b in pairwise(places_m)
        ]
        points_m = np.concatenate(legs_m)
        lon, lat = open_scene.maps.grid.lonlat_of_xy(*(points_m + open_scene.corner_m).T)
        parts = [*geofence["polygons"], *geofence["circles"]]
        out = [is_in_area(part, lon, lat) for part in parts if not part["inclusion"]]
        inside = [is_in_area(part, lon, lat) for part in parts if part["inclusion"]]
        is_kept = np.all(inside, axis=0)
        is_breach = np.any([*out, ~is_kept if inside else np.zeros(len(lon), bool)], axis=0)

        num_steps = is_breach.sum()
        if 0 < num_steps < 5:
            continue  # too near to call
        assert bool(len(found)) == bool(num_steps), (number, geofence)
        kinds["breached" if num_steps else "clean"] += 1
        if num_steps:
            begin_m = points_m[np.argmax(is_breach)]
            at_m = [
                open_scene.xy_m(Place(*lonlat, 0.0, "ground"))
                for lonlat in found[["lon", "lat"]].to_numpy()
            ]
            assert np.linalg.norm(np.array(at_m) - begin_m, axis=1).min() < 1.0
    assert min(kinds.values()) > 3, kinds


def test_a_breach_of_the_geofence_names_the_area_of_the_file(open_scene, tmp_path):
    corners = [
        open_scene.place(*xy_m, 0.0)[1::-1] for xy_m in ((0, 200), (600, 200), (600, 300), (0, 300))
    ]
    across = {"inclusion": False, "polygon": corners}
    around = {"inclusion": True, "circle": {"center": corners[0], "radius": 260.0}}
    file = tmp_path / "m.plan"
    places_m = np.array([(20.0, 20.0), (20.0, 580.0)])
    file.write_text(plan_text(open_scene, places_m, {"polygons": [across], "circles": [around]}))
    result = checked(open_scene, file, time=OFF)
    what = result.findings["what"].tolist()
    assert [text[:60].partition(" of ")[0] for text in what] == [
        "enters the no-fly zone 'geofence polygon 1'",
        "enters the no-fly zone 'land outside the geofence'",
    ]
    assert result.findings["along_m"].tolist() == pytest.approx([380 + 180, 380 + 439.2], abs=0.6)
    assert {zone["name"]: zone["state"] for zone in result.limits["no_fly"]} == {
        "stadium": "open",  # at this time
        "geofence polygon 1": "closed",
        "land outside the geofence": "closed",
    }


def test_named_limits_are_findings_or_not_judged(open_scene):
    ds = open_scene.maps.ds.assign_coords(altitude=[10.0, 400.0])
    open_scene = open_scene._replace(maps=replace(open_scene.maps, ds=ds))
    ends = [open_scene.place(20.0, y_m, 60.0) for y_m in (20.0, 500.0)]
    mission = mission_of(*ends, home=ends[0])
    free = checked(open_scene, mission, time=OFF)
    lost_m, people = free.figures["no_fix_m"], free.figures["people_overflown"]
    assert lost_m > 1
    assert people > 1
    assert kinds_of(checked(open_scene, mission, time=OFF, max_no_fix_m=lost_m - 1)) == ["limit"]
    assert checked(open_scene, mission, time=OFF, max_no_fix_m=lost_m + 20).state == "clean"
    # The nine metres of climb and of landing below the maps are not known: they may lack a fix.
    unsure = checked(open_scene, mission, time=OFF, max_no_fix_m=lost_m + 10)
    assert (unsure.state, kinds_of(unsure)) == ("not-judged", [])
    assert kinds_of(checked(open_scene, mission, time=OFF, max_people=people - 1)) == ["limit"]
    hardly = checked(open_scene, mission, time=OFF, max_people=people - 1e-3)
    assert hardly.findings["what"].item().startswith(f"{people:.3g} people overflown")


def numbers_in(axes, found) -> list[int]:
    """Return the numbers beside the marks of a picture, once each is checked to be at its finding's place.

    Findings at one place have one text, with all their numbers.
    """
    places = [tuple(np.round(text.xy, 3)) for text in axes.texts if text.get_text()]
    assert len(set(places)) == len(places)
    marks = {
        int(number): text.xy
        for text in axes.texts
        for number in text.get_text().replace("\n", " ").split(", ")
        if number
    }
    for number, place in marks.items():
        assert place == pytest.approx(found.iloc[number - 1].tolist(), abs=1e-6)
    return sorted(marks)


@pytest.mark.parametrize(
    ("num_passes", "fewest"), [(1, 1), (8, 8), pytest.param(40, 30, marks=pytest.mark.slow)]
)
def test_pictures_show_the_mission_and_each_finding_by_its_number(open_scene, num_passes, fewest):
    tower = open_scene.city.buildings.polygons[np.argmax(open_scene.city.buildings.height_m)]
    x_m, y_m = np.array(tower.centroid.coords[0]) - open_scene.corner_m
    ends = [open_scene.place(x_m, y_m + side_m, 60.0) for side_m in (-40, 40)]
    places = (ends * num_passes)[: num_passes + 1]
    if num_passes == 40:  # apart
        apart_m = np.random.default_rng(2).uniform(20, 580, (18, 2))
        places = [open_scene.place(*xy_m, 11.0) for xy_m in apart_m]
    result = checked(open_scene, mission_of(*places, home=places[0]))
    found = result.findings
    assert len(found) >= fewest
    grid = open_scene.maps.grid
    xy_m = grid.xy_at(found[["lon", "lat"]].to_numpy())
    figure = plot_mission(result)
    axes = figure.axes[0]
    numbers = [*range(1, len(found) + 1)]
    assert numbers_in(axes, pd.DataFrame(xy_m)) == numbers
    profile = plot_flown_heights(result).axes[0]
    assert set(numbers_in(profile, found[["along_m", "height_m"]])) >= set(numbers[: fewest // 2])

    # The panel holds the mission with a margin, and is no larger than the maps.
    (west, east), (south, north) = axes.get_xlim(), axes.get_ylim()
    flown_m = grid.xy_at(np.array([place[:2] for place in places]))
    assert (flown_m.min(axis=0) >= (west, south)).all()
    assert (flown_m.max(axis=0) <= (east, north)).all()
    assert east - west <= SIDE_M
    labels = [text.get_text() for text in figure.findobj(Legend)[0].get_texts()]
    unjudged = ["not judged from here"] * int(result.unjudged["lon"].notna().any())
    of_ends = ["mission", "home", "start", "goal"]
    assert labels == [*of_ends, "findings, by number", *unjudged, "no-fly zone"]


@pytest.mark.slow
def test_the_map_of_a_short_mission_is_a_part_of_the_maps_with_zones_and_home(open_scene):
    fine = made_maps(200, 200, (0.5, 400.0))
    scene = open_scene._replace(maps=fine)
    ends = [scene.place(*xy_m, 200.0) for xy_m in ((800, 900), (1100, 1000))]
    mission = mission_of(*ends, home=ends[0])
    box = shapely.box(*np.add(scene.corner_m, 850), *np.add(scene.corner_m, 990))
    zoned = ju.Constraints(zones=(Zone("stadium", box, fine.grid.crs),))
    axes = plot_mission(ju.check(fine, mission)).axes[0]
    for limits, corner_m, middle_m in zip(
        (axes.get_xlim(), axes.get_ylim()), scene.corner_m, (950, 950), strict=True
    ):
        assert np.ptp(limits) == pytest.approx(600, abs=20)
        assert np.mean(limits) - corner_m == pytest.approx(middle_m, abs=20)
    (home,) = [line for line in axes.lines if line.get_label() == "home"]
    assert home.get_xydata()[0] - scene.corner_m == pytest.approx([800, 900], abs=1e-3)
    assert not axes.collections
    figure = plot_mission(ju.check(fine, mission, constraints=zoned))
    axes = figure.axes[0]
    labels = [text.get_text() for text in figure.findobj(Legend)[0].get_texts()]
    assert "no-fly zone" in labels
    assert "height guessed" not in labels
    (outline,) = axes.collections[0].get_paths()
    assert outline.vertices.min(axis=0) - scene.corner_m == pytest.approx([850, 850])
    assert outline.vertices.max(axis=0) - scene.corner_m == pytest.approx([990, 990])


def test_a_limit_of_people_is_a_number_of_people(open_scene):
    ends = [open_scene.place(20.0, y_m, 60.0) for y_m in (20.0, 500.0)]
    with pytest.raises(ju.InputError, match="max_people must be 0 or a positive number of people"):
        checked(open_scene, mission_of(*ends, home=ends[0]), time=OFF, max_people=-1)


@pytest.mark.slow
def test_the_report_has_each_finding_under_its_number(open_scene, tmp_path):
    ends = [open_scene.place(20.0, y_m, 60.0) for y_m in (20.0, 500.0)]
    result = checked(
        open_scene, mission_of(*ends, home=ends[0]), time=OFF, max_people=0, max_no_fix_m=0
    )
    result.save(tmp_path / "checked")
    report = (tmp_path / "checked" / "report.md").read_text()
    assert len(result.sentences) > 1
    for number, sentence in enumerate(result.sentences, 1):
        assert f"\n{number}. {sentence}\n" in report
    assert f"- no fix: {result.facts['no fix']}\n" in report
    free = checked(open_scene, mission_of(*ends, home=ends[0]), time=OFF)
    assert "## Findings\n\nNone.\n" in check_report(free).text


def test_a_bound_that_is_not_kept_closes_cells(open_scene):
    ends = [open_scene.place(20.0, y_m, 60.0) for y_m in (20.0, 500.0)]
    mission = mission_of(*ends, home=ends[0])
    bound = ju.Constraints.read(require="risk>=0.99")
    result = ju.check(open_scene.maps, mission, sources=open_scene.city, constraints=bound)
    assert set(kinds_of(result)) == {"closed"}


def test_cells_without_a_value_of_a_layer_are_closed(open_scene):
    maps = open_scene.maps
    values = np.full(maps.ds["risk"].shape, 0.5, np.float32)
    values[:, 20:30] = np.nan
    record = json.dumps(ju.Layer("noise.tif", "high-is-bad", (0.0, 1.0)).record)
    noise = maps.ds["risk"].copy(data=values).assign_attrs(layer=record)
    noisy = replace(maps, ds=maps.ds.assign(noise=noise))
    ends = [open_scene.place(20.0, y_m, 60.0) for y_m in (20.0, 500.0)]
    result = ju.check(noisy, mission_of(*ends, home=ends[0]), sources=open_scene.city)
    assert kinds_of(result) == ["closed"]
    assert result.findings["along_m"].tolist() == pytest.approx([60 + 180], abs=1)


def test_people_and_the_densest_kilometre_are_those_of_a_plain_sum(open_scene):
    ends = [open_scene.place(x_m, 15.0, 60.0) for x_m in (15.0, 585.0)]
    figures = checked(open_scene, mission_of(*ends, home=ends[0]), time=OFF).figures
    density = open_scene.maps.m("density")[1]
    x_m = np.arange(15.0, 585.0, 0.01) + 0.005
    people = density[(x_m // 10).astype(int)].sum() * 0.01 * 10.0 / 1e6
    assert figures["people_overflown"] == pytest.approx(people, rel=1e-2)
    assert figures["densest_km_people"] == pytest.approx(figures["people_overflown"])


@pytest.fixture(scope="module")
def lost_scene(open_scene) -> Scene:
    """The scene with a fix everywhere but in two strips, of 40 and 30 m at ``ON`` and of 10 m at ``OFF``."""
    hdop = open_scene.maps.ds["hdop"].copy(deep=True)
    hdop[:] = 1.0
    for at, first_row, end_row in ((0, 20, 24), (0, 30, 33), (1, 10, 11)):
        hdop[{"time": at, "y": slice(first_row, end_row)}] = np.inf
    maps = replace(open_scene.maps, ds=open_scene.maps.ds.assign(hdop=hdop))
    return open_scene._replace(maps=maps)


def test_a_limit_on_the_fix_is_shown_where_it_is_first_lost_at_the_worst_time(lost_scene):
    ends = [lost_scene.place(20.0, y_m, 60.0) for y_m in (20.0, 500.0)]
    mission = mission_of(*ends, home=ends[0])
    result = checked(lost_scene, mission, time=[OFF, ON], max_no_fix_m=30)
    (row,) = result.findings.to_dict("records")
    assert (row["kind"], row["item"], row["by_m"]) == ("limit", 2, pytest.approx(40.0, abs=1))
    assert (row["along_m"], row["to_m"]) == pytest.approx((60 + 180, 60 + 310), abs=1)
    assert lost_scene.xy_m(Place(row["lon"], row["lat"], 0.0, "ground")) == pytest.approx(
        (20.0, 200.0), abs=1
    )
    assert row["height_m"] == pytest.approx(60.0)
    (point,) = result.to_geojson()["features"]
    assert point["geometry"]["coordinates"] == [row["lon"], row["lat"]]
    assert "above all from 240 to 370 m along the mission, toward item 2" in result.sentences[0]


def test_figures_are_in_words_and_their_keys_stay(lost_scene):
    ends = [lost_scene.place(20.0, y_m, 60.0) for y_m in (20.0, 500.0)]
    result = checked(lost_scene, mission_of(*ends, home=ends[0]), time=[ON, OFF])
    lost = "70 m at 2020-04-27 16:00 UTC, 10 m at 2020-04-29 16:00 UTC"
    assert result.facts["no fix"] == lost
    assert f"no fix: {lost}" in result.lines
    unknown = result.figures | {"fix_unknown_m": 1234.4, "people_unknown_m": 0.4}
    unsure = replace(result, figures=unknown).facts
    assert unsure["no fix"] == f"{lost}; not known on 1,234 m"
    assert "not known" not in unsure["people overflown"]
    assert result.facts["length"] == "600 m, 600 m of it over the maps at a known height"
    assert all("_" not in line for line in result.lines if "return: " not in line)
    one = checked(lost_scene, mission_of(*ends, home=ends[0]))
    assert one.facts["time"].startswith("2020-04-27 16:00 UTC; the maps hold ")
    assert "time" not in result.facts or len(lost_scene.maps.times) > 2
    by_time = result.to_dict()["figures"]["no_fix_by_time_m"]
    assert by_time == {ON: pytest.approx(70, abs=1), OFF: pytest.approx(10, abs=1)}
    no_gps = replace(lost_scene.maps, ds=lost_scene.maps.ds.drop_vars("hdop"))
    without = checked(lost_scene._replace(maps=no_gps), mission_of(*ends, home=ends[0]))
    assert "no fix" not in without.facts


def test_a_limit_on_people_is_shown_where_the_densest_kilometre_begins(open_scene):
    density = open_scene.maps.ds["density"].copy(deep=True)
    density[:] = 10.0
    density[{"y": slice(30, 60), "x": slice(40, 60)}] = 5_000.0
    scene = open_scene._replace(
        maps=replace(open_scene.maps, ds=open_scene.maps.ds.assign(density=density))
    )
    corners = [(15, 15), (585, 15), (585, 585), (15, 585), (15, 15)]
    places = [scene.place(*xy_m, 60.0) for xy_m in corners]
    result = checked(scene, mission_of(*places, home=places[0]), time=OFF, max_people=5)
    (row,) = result.findings.to_dict("records")
    # By a plain sum: people below every half metre of the square, and below any kilometre of it.
    people = []
    for begin_m, end_m in pairwise(np.array(corners, float)):
        shares = (np.arange(1140) + 0.5)[:, None] / 1140
        col, row_m = ((begin_m + shares * (end_m - begin_m)) // 10).astype(int).T
        people.append(density.values[0][row_m, col] * 0.5 * 10 / 1e6)
    sums = np.append(0, np.cumsum(people))
    in_km = sums[2000:] - sums[:-2000]
    assert row["along_m"] == pytest.approx(60 + np.argmax(in_km) * 0.5, abs=12)
    assert row["to_m"] - row["along_m"] == pytest.approx(1000, abs=1)
    assert result.figures["densest_km_people"] == pytest.approx(in_km.max(), rel=0.02)
    assert "above all from" in result.sentences[0]


def test_without_the_city_cells_are_looked_at_and_the_result_says_so(open_scene):
    ends = [open_scene.place(20.0, y_m, 60.0) for y_m in (20.0, 500.0)]
    result = ju.check(open_scene.maps, mission_of(*ends, home=ends[0]))
    assert result.outlines.startswith("by cells")
    assert "by cells" in repr(result)


@pytest.mark.slow
def test_ten_thousand_items_are_judged(open_scene):
    rng = np.random.default_rng(3)
    places = [open_scene.place(*xy_m, 395.0) for xy_m in rng.uniform(2, 120, (10_000, 2))]
    places[0] = open_scene.place(15.0, 15.0, 395.0)
    x_m, y_m = (
        np.array(open_scene.city.buildings.polygons[0].centroid.coords[0]) - open_scene.corner_m
    )
    places[5_000] = open_scene.place(x_m, y_m, 5.0)
    result = checked(open_scene, mission_of(*places, home=places[0]), time=OFF)
    assert {"building"} <= set(kinds_of(result))
    assert 4_990 <= result.findings["item"].min() <= result.findings["item"].max() <= 5_010


@pytest.mark.parametrize("text", ["[" * 10_000, "{}", '{"mission": 3}', "no json", ""])
def test_a_hostile_file_is_refused_in_one_sentence(open_scene, tmp_path, text):
    (tmp_path / "x.plan").write_text(text)
    with pytest.raises(ju.InputError):
        checked(open_scene, tmp_path / "x.plan")


def test_a_planned_mission_is_clean_without_guesses(town, tmp_path):
    city = ju.demo_city(1_000, 1_000)
    on_ground = np.argwhere(town.is_free(20.0) & (town.m("roof_touched") == 0))
    path = ju.plan(town, altitude_m=20.0, **ends_at(town, *on_ground[[10, -10]]))
    path.save(tmp_path / "x.plan")
    result = ju.check(town, tmp_path / "x.plan", sources=city)
    assert result.state == "clean", result
    assert json.loads(json.dumps(result.to_dict()))["state"] == "clean"
    origin = np.full(len(city.buildings), HeightOrigin.DEFAULT, np.uint8)
    buildings = replace(city.buildings, origin=origin, limit_m=None)
    guessed = replace(city, buildings=buildings)
    ends = on_ground[[len(on_ground) // 3, -10]]
    high = ju.plan(town, altitude_m=600.0, objective="distance", **ends_at(town, *ends))
    high.save(tmp_path / "high.plan")
    assert ju.check(town, tmp_path / "high.plan", sources=city).state == "clean"
    unsure = ju.check(town, tmp_path / "high.plan", sources=guessed)
    assert (unsure.state, kinds_of(unsure)) == ("not-judged", [])


def test_missions_keep_the_fences_that_they_are_written_with(town, tmp_path):
    city = ju.demo_city(1_000, 1_000)
    on_ground = np.argwhere(town.is_free(20.0) & (town.m("roof_touched") == 0))
    ends = ends_at(town, *on_ground[[10, -10]])
    straight = ju.plan(town, altitude_m=20.0, **ends)
    middle_m = straight.xy_m[len(straight.xy_m) // 2]
    zone = Zone("stadium", shapely.box(*(middle_m - 50), *(middle_m + 50)), town.grid.crs)
    limits = ju.Constraints(zones=(zone,))
    path = ju.plan(town, altitude_m=20.0, constraints=limits, **ends)
    path.save(tmp_path / "x.plan")
    result = ju.check(town, tmp_path / "x.plan", sources=city)
    assert result.state == "clean", result
    assert result.figures["num_zones"] == 1
    through = json.loads((tmp_path / "x.plan").read_text())
    straight.save(tmp_path / "y.plan")
    other = json.loads((tmp_path / "y.plan").read_text()) | {"geoFence": through["geoFence"]}
    (tmp_path / "y.plan").write_text(json.dumps(other))
    assert "zone" in kinds_of(ju.check(town, tmp_path / "y.plan", sources=city))


@pytest.mark.parametrize("planner", ["astar-plus", "theta-star"])
def test_a_path_is_judged_as_its_file_is_but_for_climb_and_landing(town, tmp_path, planner):
    city = ju.demo_city(1_000, 1_000)
    limits = ju.Constraints.read(clearance_m=5.0, require="gps>=0.01")
    cells = np.argwhere(ju.cost_map(town, 60.0, constraints=limits).is_free)
    ends = ends_at(town, *cells[[10, -10]])
    path = ju.plan(
        town, altitude_m=60.0, planner=planner, constraints=limits, objective="distance", **ends
    )
    path.save(tmp_path / "x.kml")
    of_path = ju.check(town, path, sources=city)
    of_file = ju.check(town, tmp_path / "x.kml", sources=city, constraints=limits)
    assert of_path.limits == of_file.limits == path.settings["limits"]
    assert kinds_of(of_path) == kinds_of(of_file) == []
    assert [*of_path.figures] == [*of_file.figures]
    for name in ("length_m", "no_fix_m", "people_overflown"):
        assert of_path.figures[name] == pytest.approx(of_file.figures[name], abs=0.01, rel=5e-3)
    assert of_path.figures["length_m"] == pytest.approx(path.length_m, abs=0.5)
    assert [sentence[:32] for sentence in of_path.not_judged] == [
        "A path begins and ends in the ai"
    ]


def test_a_path_is_judged_under_its_own_zones_and_none_is_none(open_scene):
    start, goal = (open_scene.place(x_m, 590.0, 60.0) for x_m in (400.0, 590.0))
    path = ju.plan(open_scene.maps, start[:2], goal[:2], altitude_m=60.0, objective="distance")
    maps, city = open_scene.maps, open_scene.city
    assert "zone" not in kinds_of(ju.check(maps, path, sources=city))
    closed = replace(path, zones=(replace(open_scene.zone, floor_m=-np.inf, ceiling_m=np.inf),))
    assert "zone" in kinds_of(ju.check(maps, closed, sources=city))
    none = replace(path, status=Status.NO_PATH)
    with pytest.raises(ju.InputError, match="there is no path to check"):
        ju.check(maps, none, sources=city)


def test_a_height_above_the_ellipsoid_says_what_is_missing_once_the_geoid_is_named(scene):
    flat = ju.MetricMaps(scene.maps.ds.drop_vars("terrain"))
    place = scene.place(100.0, 100.0, 30.0, "ellipsoid")
    leg = Leg(place, scene.place(200.0, 100.0, 30.0, "ellipsoid"), "leg", 1)
    mission = Mission("made", (leg,), None, None, (), None)
    for geoid_m, word in ((None, "geoid_m"), (37.0, "above the geoid, and neither")):
        city = replace(scene.city, terrain=None)
        result = ju.check(flat, mission, sources=city, geoid_m=geoid_m)
        assert word in " ".join(result.not_judged)
        assert result.state == "not-judged"
        assert any(line.startswith("  not judged: ") for line in result.lines)


AT_WALLS = ju.Constraints(clearance_m=0.0, vertical_clearance_m=0.0)


def test_what_is_flown_into_is_named_by_its_kind_by_outlines_and_by_cells():
    maps, city = maps_of_kinds()
    corner_m = np.array(maps.grid.bounds_m[:2])

    def told(height_m: float, *corners, sources) -> list[str]:
        places = [
            Place(*map(float, maps.grid.lonlat_of_xy(*(corner_m + corner))), height_m, "ground")
            for corner in corners
        ]
        mission = mission_of(*places, home=places[0])
        result = ju.check(maps, mission, sources=sources, constraints=AT_WALLS)
        return [re.sub(r", up to [\d.]+ m", "", text) for text in result.findings["what"]]

    # Through a tree, plants of the raster, another tree and a wood; and through a wire.
    through = (31, 60), (31, 150), (41, 150), (41, 80), (80, 30), (160, 30)
    for sources in (city, None):
        assert told(9.0, *through, sources=sources) == [
            "flies through a tree below its top of guessed height",
            "flies through a wood below its top",
            "flies through a tree below its top of guessed height",
            "flies through a wood below its top",
        ]
        wire = "flies below or beside a wire below its top, whose height is taken as 10.0 m"
        assert told(9.0, (100, 190), (100, 170), sources=sources) == [wire]


def test_a_home_with_swapped_coordinates_is_refused(scene, tmp_path):
    lon, lat = scene.maps.grid.centre_lonlat
    path = tmp_path / "line.kml"
    path.write_text(
        '<kml xmlns="http://www.opengis.net/kml/2.2"><Placemark><LineString><coordinates>'
        f"{lon},{lat},60 {lon + 1e-3},{lat},60</coordinates></LineString></Placemark></kml>"
    )
    how = {"heights": "home", "sources": scene.city}
    assert ju.check(scene.maps, path, home=(lon, lat), **how).sentence
    with pytest.raises(ju.InputError, match=r"^home: .*longitude and latitude look swapped"):
        ju.check(scene.maps, path, home=(lat, lon), **how)
