"""What clears a finding does: flown at the height named, or moved as named, nothing is found, by points every 20 cm."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import shapely

import jaxurban as ju
from jaxurban.flights.missions.parts import Leg, Mission, Place
from jaxurban.io.city import City
from jaxurban.io.zone import Zone
from jaxurban.typing import MissionCheck
from jaxurban.world.footprints import Footprints, HeightOrigin
from tests.flights.test_check import (
    CLEARANCE_M,
    OFF,
    ON,
    checked,
    random_mission,
    truth_of,
)
from tests.flights.test_check import scene as scene
from tests.made_maps import made_maps

TOP_M, WEST_M, EAST_M = 90.0, 280.0, 320.0


def tower() -> tuple[ju.MetricMaps, City]:
    """Return maps of 600 m and their city: one tower of 90 m, from 280 to 320 m both ways."""
    maps = made_maps(60, 60, (0.5, 400.0))
    corner_m = np.array([maps.grid.x_min_m, maps.grid.y_min_m])
    outline = shapely.box(*(corner_m + WEST_M), *(corner_m + EAST_M))
    kinds = np.array([HeightOrigin.HEIGHT], np.uint8)
    building = Footprints(
        np.array([outline]), np.array([TOP_M]), np.zeros(1), kinds, np.zeros(1, bool)
    )
    return maps, City(maps.grid.crs, (*corner_m, *(corner_m + 600.0)), building)


def place(maps: ju.MetricMaps, x_m: float, y_m: float, height_m: float) -> Place:
    lon, lat = maps.grid.lonlat_of_xy(maps.grid.x_min_m + x_m, maps.grid.y_min_m + y_m)
    return Place(float(lon), float(lat), height_m, "ground")


def flown(maps, city, *places: Place, **more) -> MissionCheck:
    """Return the check of a mission through places."""
    legs = tuple(Leg(*pair, "leg", number) for number, pair in enumerate(pairwise(places), 1))
    mission = Mission("made", legs, places[0][:2], None, (), None)
    more = {"constraints": ju.Constraints(clearance_m=4.0)} | more
    return ju.check(maps, mission, sources=city, **more)


@pytest.mark.parametrize(("x_m", "right_m"), [(305.0, 19.0), (295.0, -19.0), (319.0, 5.0)])
def test_a_tower_is_cleared_over_its_roof_or_past_its_nearer_wall(x_m, right_m):
    maps, city = tower()
    result = flown(maps, city, place(maps, x_m, 200, 60), place(maps, x_m, 400, 60))
    (row,) = result.findings.to_dict("records")
    assert row["clear_m"] == TOP_M + 3.0
    assert abs(right_m) <= abs(row["aside_m"]) <= abs(right_m) + 1
    assert np.sign(row["aside_m"]) == np.sign(right_m)
    (sentence,) = result.sentences
    side = "right" if right_m > 0 else "left"
    assert sentence.endswith(
        f"It is clear at 93 m above the ground or {abs(row['aside_m']):.0f} m to the {side}."
    )
    assert result.to_dict()["findings"][0]["clear_m"] == 93.0


def test_of_a_leg_with_several_findings_a_note_says_what_clears_all_of_it():
    maps, city = tower()
    lower = replace(
        city.buildings,
        polygons=np.array([shapely.affinity.translate(city.buildings.polygons[0], 0.0, 60.0)]),
        height_m=np.array([80.0]),
    )
    both = replace(city, buildings=city.buildings.joined(lower))
    ends = place(maps, 305, 200, 60), place(maps, 305, 450, 60)
    assert flown(maps, city, *ends).notes == ()
    result = flown(maps, both, *ends)
    note = "Leg to item 1: 93 m above the ground clears all that is judged of it."
    assert (len(result.findings), result.notes) == (2, (note,))
    assert f"  note: {note}" in result.lines
    high = [each._replace(height_m=93.0) for each in ends]
    assert flown(maps, both, *high).findings.empty
    (note,) = flown(maps, both, *ends, ceiling_m=92).notes
    assert note.startswith("Leg to item 1: no height up to 92 m above the ground is known to clear")
    of_bound = ju.Constraints.read(require="density<=0")  # no height is known to open its cells
    result = flown(maps, both, *ends, constraints=of_bound)
    assert ("closed" in set(result.findings["kind"]), result.notes) == (True, ())


def test_legs_above_what_most_countries_allow_are_named_once():
    maps, city = tower()
    for height_m, is_high in ((120.0, False), (200.0, True)):
        ends = place(maps, 100, 200, height_m), place(maps, 100, 400, height_m)
        result = flown(maps, city, *ends, place(maps, 150, 400, height_m))
        said = [note for note in result.notes if "over the 120 m that most countries" in note]
        assert (len(said), len(result.findings)) == (int(is_high), 0)
        assert not said or said[0].startswith("Legs reach 200 m above the ground")


def test_a_home_inside_a_building_is_named_with_what_to_give_and_the_nearest_free_place():
    maps, city = tower()
    names = ["roof", "roof_touched"]
    roofs = maps.ds[names].copy(deep=True)
    for name in names:
        roofs[name][{"y": slice(28, 32), "x": slice(28, 32)}] = TOP_M
    maps = replace(maps, ds=maps.ds.assign(roofs))
    ground = place(maps, 310, 300, 0)
    climb = Leg(ground, ground._replace(height_m=150.0), "climb", 1)
    mission = Mission("made", (climb,), ground[:2], None, (), None)
    (note,) = (text for text in ju.check(maps, mission, sources=city).notes if "Home" in text)
    assert note.startswith("Home is inside a building of 90.0 m: if it is on the roof, name its")
    named = note.partition("--home ")[2].split()[0].split(",")
    xy_m = np.array(maps.grid.xy_of_lonlat(*map(float, named)))
    assert city.buildings.polygons[0].distance(shapely.Point(xy_m)) == pytest.approx(5.0, abs=0.1)
    on_roof = ju.check(maps, mission, sources=city, home_above_ground_m=90.0)
    assert not any("Home" in text for text in on_roof.notes)


def test_no_height_above_the_ceiling_is_named():
    maps, city = tower()
    ends = place(maps, 305, 200, 60), place(maps, 305, 400, 60)
    assert flown(maps, city, *ends, ceiling_m=93).findings["clear_m"].tolist() == [93.0]
    result = flown(maps, city, *ends, ceiling_m=92)
    assert np.isnan(result.findings["clear_m"]).all()
    assert result.sentences[0].endswith(" It is clear 20 m to the right.")
    with pytest.raises(ju.InputError, match="ceiling_m must be 0 or a positive number"):
        flown(maps, city, *ends, ceiling_m=-1)


def test_a_take_off_through_a_roof_has_no_way_out():
    maps, city = tower()
    ground = place(maps, 310, 300, 0)
    climb = Leg(ground, ground._replace(height_m=150.0), "climb", 1)
    mission = Mission("made", (climb,), ground[:2], None, (), None)
    result = ju.check(maps, mission, sources=city)
    assert result.findings["kind"].tolist() == ["building"]
    assert result.findings[["clear_m", "aside_m"]].isna().all(axis=None)
    assert "clear" not in result.sentences[0]


def test_what_nothing_bounds_is_no_way_out_though_it_is_guessed_lower_than_the_flight():
    maps, city = tower()
    guessed = replace(
        city.buildings,
        polygons=np.array([shapely.affinity.translate(city.buildings.polygons[0], 40.0)]),
        height_m=np.array([20.0]),
        origin=np.array([HeightOrigin.DEFAULT], np.uint8),
        limit_m=np.array([math.inf]),
    )
    both = replace(city, buildings=city.buildings.joined(guessed))
    ends = place(maps, 305, 200, 60), place(maps, 305, 400, 60)
    assert flown(maps, city, *ends).findings["aside_m"].tolist() == [20.0]
    assert flown(maps, both, *ends).findings["aside_m"].tolist() == [-30.0]


@pytest.mark.parametrize(("top_m", "clear_m"), [(75.0, 78.0), (117.0, 120.0), (117.5, math.nan)])
def test_a_zone_is_cleared_over_its_ceiling_up_to_that_of_the_flight(top_m, clear_m):
    maps, city = tower()
    corner_m = np.array([maps.grid.x_min_m, maps.grid.y_min_m])
    middle_m = shapely.Point(corner_m[0] + 100.0, corner_m[1] + 300.0)
    shape = shapely.box(*shapely.buffer(middle_m, 10.0).bounds)
    zone = Zone("mast", shape, maps.grid.crs, ceiling_m=top_m)
    limits = ju.Constraints(zones=(zone,), clearance_m=4.0)
    ends = place(maps, 100, 200, 60), place(maps, 100, 400, 60)
    result = flown(maps, city, *ends, constraints=limits)
    (row,) = result.findings.to_dict("records")
    assert row["kind"] == "zone"
    assert row["clear_m"] == pytest.approx(clear_m, nan_ok=True)
    assert abs(row["aside_m"]) in (14.0, 15.0)
    if not math.isnan(clear_m):
        over = [each._replace(height_m=clear_m) for each in ends]
        assert flown(maps, city, *over, constraints=limits).findings.empty


def test_past_a_corner_the_corner_moves_with_both_legs():
    maps, city = tower()
    bend = place(maps, 300, 300, 60)
    ends = place(maps, 300, 200, 60), bend, place(maps, 400, 300, 60)
    result = flown(maps, city, *ends)
    (row,) = result.findings.to_dict("records")
    assert (row["item"], row["to_item"], row["aside_m"]) == (1, 2, -25.0)
    words = "25 m to the left, with each corner from item 1 to before item 2 moved so that its legs stay parallel."
    assert result.sentences[0].endswith(words)

    # Legs that are moved so to the left cross at a new corner, and nothing is there.
    moved = [(275, 200), (275, 325), (400, 325)]
    assert flown(maps, city, *(place(maps, *each, 60) for each in moved)).findings.empty
    near = [(277, 200), (277, 323), (400, 323)]
    assert len(flown(maps, city, *(place(maps, *each, 60) for each in near)).findings)


def test_a_cut_corner_is_named_with_its_item():
    maps, city = tower()
    around = [(279.5, 200), (279.5, 320.5), (330, 320.5), (450, 320.5)]
    places = [place(maps, *each, 60) for each in around]
    result = flown(maps, city, *places, constraints=ju.Constraints())
    (said,) = [text for text in result.not_judged if "corners" in text]
    assert "(at item 1)" in said
    assert "move these corners away" in said


@pytest.mark.parametrize(
    ("floor_m", "top_m", "words"),
    [
        (-math.inf, math.inf, "from the ground up, closed at all heights up to 120 m"),
        (-math.inf, 150.0, "from the ground to 150 m, closed at all heights up to 120 m"),
        (-math.inf, 75.0, "from the ground to 75 m, open above 75 m"),
        (50.0, math.inf, "from 50 m up, open below 50 m"),
        (50.0, 75.0, "from 50 m to 75 m, open below 50 m or above 75 m"),
    ],
)
def test_a_zone_says_at_which_heights_it_is_passed(floor_m, top_m, words):
    maps, city = tower()
    west_m, south_m = maps.grid.bounds_m[:2]
    shape = shapely.box(west_m + 90, south_m + 290, west_m + 110, south_m + 310)
    zone = Zone("mast", shape, maps.grid.crs, floor_m=floor_m, ceiling_m=top_m)
    limits = ju.Constraints(zones=(zone,), clearance_m=4.0)
    ends = place(maps, 100, 200, 60), place(maps, 100, 400, 60)
    result = flown(maps, city, *ends, constraints=limits)
    assert result.findings["what"].tolist() == [f"enters the no-fly zone 'mast', {words}"]
    for height_m, is_open in ((49.0, "below" in words), (76.0, "above" in words)):
        other = [each._replace(height_m=height_m) for each in ends]
        assert flown(maps, city, *other, constraints=limits).findings.empty == is_open


def test_limits_and_closed_cells_have_no_way_out():
    maps, city = tower()
    ends = place(maps, 100, 200, 60), place(maps, 100, 400, 60)
    bounds = ju.Constraints.read(require="gps>=1").bounds
    result = flown(maps, city, *ends, constraints=ju.Constraints(bounds=bounds, clearance_m=4.0))
    assert set(result.findings["kind"]) == {"closed"}
    assert result.findings[["clear_m", "aside_m"]].isna().all(axis=None)
    assert "clear" not in result.sentences[0]


@pytest.mark.slow
@pytest.mark.parametrize("is_flat", [True, False])
def test_parts_that_are_flown_as_named_meet_nothing(scene, is_flat):
    if is_flat:
        ds = scene.maps.ds
        maps = replace(scene.maps, ds=ds.assign(terrain=0 * ds["terrain"]))
        level = replace(scene.city.terrain, values=0 * scene.city.terrain.values)
        scene = scene._replace(maps=maps, city=replace(scene.city, terrain=level))
    rng = np.random.default_rng(11)
    num_heights = num_sides = 0
    while min(num_heights, num_sides) < 3:
        mission, time = random_mission(scene, rng), str(rng.choice([ON, OFF]))
        if any(leg.end.datum != "ground" for leg in mission.legs):
            mission = replace(
                mission,
                legs=tuple(
                    leg._replace(
                        start=leg.start._replace(datum="ground"),
                        end=leg.end._replace(datum="ground"),
                    )
                    for leg in mission.legs
                ),
            )
        result = checked(scene, mission, CLEARANCE_M, time)
        for row in result.findings.to_dict("records"):
            for steps in (result.flight.steps, result.flight.variants):
                is_there = (steps.along_m >= row["along_m"]) & (steps.along_m <= row["to_m"])
                part = steps.take(is_there.all(axis=1))
                if len(part.leg):
                    break
            xy_m = np.vstack([part.ends_m[:, 0], part.ends_m[-1:, 1]]) - scene.corner_m
            own_m = (part.z_m + part.ground_m).min()
            tries = []
            if not math.isnan(row["clear_m"]):
                num_heights += 1
                tries.append((xy_m, np.full(len(xy_m), row["clear_m"])))
            if not math.isnan(row["aside_m"]):
                num_sides += 1
                moved = shapely.LineString(xy_m).parallel_offset(
                    abs(row["aside_m"]), "left" if row["aside_m"] < 0 else "right"
                )
                moved_m = shapely.get_coordinates(moved.segmentize(1.0))
                tries.append((moved_m, own_m - scene.ground_m(*moved_m.T)))
            for there_m, z_m in tries:
                places = [
                    scene.place(*each, float(up_m)) for each, up_m in zip(there_m, z_m, strict=True)
                ]
                legs = [Leg(*pair, "leg", 1, turn_m=0.0) for pair in pairwise(places)]
                tried = Mission("tried", tuple(legs), places[0][:2], None, (), None)
                again = checked(scene, tried, CLEARANCE_M, time)
                assert again.findings.empty, (row, again.sentences)
                truth = truth_of(scene, tried, CLEARANCE_M - 0.05, time)
                assert not (truth.hit | truth.buried | truth.in_zone).any(), row
                assert truth.slack_m[0] > -0.05, row
