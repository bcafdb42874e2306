"""Where no height is known there are two: planners close, and check does not judge, what lies between them."""

from dataclasses import replace

import numpy as np
import pytest
import shapely

import jaxurban as ju
from jaxurban.io.rasterise import build_surface
from jaxurban.world.footprints import Footprints, HeightOrigin
from jaxurban.world.surface import obstacles_on
from tests.flights.test_judged_flight import WAYPOINT, World, checked
from tests.made_maps import city_of_boxes, made_maps
from tests.volumes import ends_at

SIDE_M, CELL_M = 600.0, 5.0
ALTITUDES_M = (10.0, 20.0, 40.0, 60.0, 200.0)
LIMIT_M, NOTHING = 35.0, {"clearance_m": 0.0, "vertical_clearance_m": 0.0}
HOUSE, MAST, UNKNOWN = (280, 280, 320, 320), (395, 295, 405, 305), (490, 280, 520, 320)


def town(boxes, heights_m, is_guessed, limit_m, structures=None) -> World:
    """Return a city of boxes, some of guessed height with bounds, and made maps with its roofs."""
    num = round(SIDE_M / CELL_M)
    maps = made_maps(num, num, ALTITUDES_M, CELL_M)
    grid = maps.grid
    corner_m = np.array(grid.bounds_m[:2])
    city = city_of_boxes(boxes, heights_m, SIDE_M, tuple(corner_m.tolist()))
    origin = np.where(is_guessed, HeightOrigin.DEFAULT, HeightOrigin.HEIGHT).astype(np.uint8)
    limits_m = np.broadcast_to(limit_m, len(boxes)).astype(float)
    buildings = replace(city.buildings, origin=origin, limit_m=limits_m)
    if structures is not None:
        moved = shapely.transform(structures.polygons, lambda xy: xy + corner_m)
        structures = replace(structures, polygons=moved)
    city = replace(city, buildings=buildings, structures=structures)

    surface = build_surface(city, grid, grid, has_guessed=True)
    rasters = {
        "roof": surface.roof_m,
        "roof_touched": surface.roof_touched_m,
        "roof_guessed": surface.roof_guessed,
        "roof_limit": surface.roof_limit_m,
    }
    ds = maps.ds.assign({name: (("y", "x"), values) for name, values in rasters.items()})
    obstacle = obstacles_on(surface, ALTITUDES_M).astype(np.uint8)
    return World(replace(maps, ds=ds.assign(obstacle=ds["obstacle"].copy(data=obstacle))), city)


def street(limit_m: float = LIMIT_M) -> World:
    """Return a house of guessed height, 10 m, a mast of 50 m, and something unknown that reaches 35 m at most."""
    beside = Footprints(
        shapely.box(*np.transpose([MAST, UNKNOWN])),
        np.array([50.0, 0.0]),
        np.zeros(2),
        np.array([HeightOrigin.HEIGHT, HeightOrigin.UNKNOWN], np.uint8),
        np.zeros(2, bool),
        np.array(["mast", "unknown"], object),
        np.array([np.inf, limit_m]),
    )
    return town([HOUSE], [10.0], [True], limit_m, beside)


def across(scene: World, box, height_m: float) -> str:
    """Return a .plan across the middle of a box from south to north."""
    x_m = (box[0] + box[2]) / 2
    return scene.plan(
        (WAYPOINT, 3, (100.0, 200.0), height_m, ()),
        (WAYPOINT, 3, (x_m, 200.0), height_m, ()),
        (WAYPOINT, 3, (x_m, 500.0), height_m, ()),
    )


@pytest.mark.slow
@pytest.mark.parametrize("by_outlines", [True, False])
@pytest.mark.parametrize(
    ("box", "height_m", "state"),
    [
        (HOUSE, 8.0, "findings"),
        (HOUSE, 14.0, "not-judged"),
        (HOUSE, LIMIT_M - 0.1, "not-judged"),
        (HOUSE, LIMIT_M + 0.1, "clean"),
        (UNKNOWN, 14.0, "not-judged"),
        (UNKNOWN, LIMIT_M - 0.1, "not-judged"),
        (UNKNOWN, LIMIT_M + 0.1, "clean"),
        (MAST, 48.0, "findings"),
        (MAST, 54.0, "clean"),
    ],
)
def test_what_lies_between_the_two_heights_is_not_judged_and_all_above_is(
    tmp_path, box, height_m, state, by_outlines
):
    scene = street()
    (tmp_path / "m.plan").write_text(across(scene, box, height_m))
    sources = scene.city if by_outlines else None
    result = ju.check(scene.maps, tmp_path / "m.plan", sources=sources)
    assert result.state == state, result
    if box == MAST and by_outlines and state == "findings":
        assert result.findings["what"].tolist() == [
            "flies through a mast, up to 2.0 m below its top"
        ]


def test_what_is_not_judged_says_its_kind_and_up_to_where(tmp_path):
    for box, kind in ((HOUSE, "building"), (UNKNOWN, "unknown")):
        said = (
            f"({kind}) may reach 35 m (fly higher, give its height, or set [buildings] highest_m)."
        )
        (sentence,) = checked(street(), tmp_path, across(street(), box, 14.0)).not_judged
        assert f"{said} It begins " in sentence
        # 40 m across, in steps of about a metre.
        assert int(sentence.split()[0]) == pytest.approx(40, abs=2)
    endless = street(np.inf)
    (sentence,) = checked(endless, tmp_path, across(endless, HOUSE, 190.0)).not_judged
    said = "(building) may reach any height (give its height, or set [buildings] highest_m)."
    assert f"{said} It begins " in sentence


LIMITS = ju.Constraints(clearance_m=10.0)


def test_beside_a_guessed_house_the_clearance_counts_up_to_its_bound(tmp_path):
    scene = street()
    for beside_m, height_m, state in (
        (10.5, 20.0, "clean"),
        (9.5, 20.0, "not-judged"),
        (9.5, 9.0, "findings"),
        (9.5, LIMIT_M + 0.1, "clean"),
    ):
        y_m = HOUSE[3] + beside_m
        items = [(WAYPOINT, 3, (x_m, y_m), height_m, ()) for x_m in (100.0, 350.0)]
        result = checked(scene, tmp_path, scene.plan(*items), constraints=LIMITS)
        assert result.state == state, (beside_m, height_m, result)


@pytest.mark.slow
@pytest.mark.parametrize("limits", [NOTHING, {}, {"clearance_m": 12.0}])
@pytest.mark.parametrize("altitude_m", [20.0, 40.0])
def test_planned_routes_never_enter_between_the_heights_and_pass_their_own_check(
    tmp_path, limits, altitude_m
):
    rng = np.random.default_rng(3)
    corner_m = np.stack(np.meshgrid(np.arange(40, 560, 65), np.arange(40, 560, 65)), -1)
    corner_m = corner_m.reshape(-1, 2) + rng.uniform(0, 20, (64, 2))
    boxes = np.hstack([corner_m, corner_m + rng.uniform(8, 30, (64, 2))])
    boxes = np.vstack([boxes, [240.0, 260.0, 330.0, 340.0]])  # the last is a guessed one in the way
    heights_m, is_guessed = rng.uniform(6, 50, 65), np.append(rng.random(64) < 0.5, True)
    heights_m[-1] = 5.0
    limits_m = np.append(rng.choice([12.0, 25.0, 38.0, np.inf], 64), np.inf)
    scene = town(boxes, heights_m, is_guessed, limits_m)
    constraints = ju.Constraints(**limits)
    cells = np.argwhere(constraints.is_free_to_ground(scene.maps, altitude_m))
    far = [cells[np.argmin(np.abs(cells - place).sum(axis=1))] for place in ([9, 9], [110, 105])]
    path = ju.plan(
        scene.maps,
        altitude_m=altitude_m,
        constraints=constraints,
        objective="distance",
        **ends_at(scene.maps, *far),
    )
    assert path.status.has_path, path.message

    # The witness: the distance of the line to every outline that may reach it.
    standing = scene.city.standing
    may_reach = standing.upper_m >= altitude_m  # over a bound no more is kept
    may_reach |= standing.height_m >= altitude_m - constraints.vertical_m
    line = shapely.LineString(path.xy_m)
    away_m = shapely.distance(standing.polygons[may_reach], line).min()
    assert away_m >= constraints.horizontal_m
    assert away_m > 0
    # Without the bounds the route would be shorter, over what may reach it.
    known = replace(scene.maps, ds=scene.maps.ds.drop_vars(["roof_guessed", "roof_limit"]))
    bold = ju.plan(
        known,
        altitude_m=altitude_m,
        constraints=constraints,
        objective="distance",
        **ends_at(scene.maps, *far),
    )
    assert bold.length_m < path.length_m

    path.save(tmp_path / "m.plan")
    for sources in (scene.city, None):
        result = ju.check(scene.maps, tmp_path / "m.plan", sources=sources, constraints=constraints)
        assert result.state == "clean", result


def test_maps_of_earlier_versions_have_no_bound_for_what_they_mark_as_guessed(tmp_path):
    scene = street()
    earlier = replace(scene.maps, ds=scene.maps.ds.drop_vars("roof_limit"))
    cell = (60, 60)  # in the middle of the house
    for altitude_m in (20.0, 60.0, 200.0):
        assert not ju.Constraints(**NOTHING).is_free(earlier, altitude_m)[cell]
        assert ju.Constraints().is_free(scene.maps, altitude_m)[cell] == (altitude_m > LIMIT_M)
    (tmp_path / "m.plan").write_text(across(scene, HOUSE, 190.0))
    assert ju.check(earlier, tmp_path / "m.plan").state == "not-judged"
    assert ju.check(scene.maps, tmp_path / "m.plan").state == "clean"


def test_why_a_cell_is_closed_names_the_bound_and_the_remedies():
    scene = street()
    beside = (60, 65)  # 7.5 m east of the house
    assert ju.Constraints(**NOTHING).reasons(scene.maps, 20.0, beside) == []
    for limits, cell in (({"clearance_m": 12.0}, beside), (NOTHING, (60, 60))):
        (reason,) = ju.Constraints(**limits).reasons(scene.maps, 20.0, cell)
        remedies = "(fly higher, give its height, or set [buildings] highest_m)"
        assert reason == f"a roof of guessed height that may reach 35 m {remedies}"
    endless = ju.Constraints().reasons(street(np.inf).maps, 60.0, (60, 60))
    assert endless == [
        "a roof of guessed height that may reach any height (give its height, or set [buildings] highest_m)"
    ]
    mast = ju.Constraints(clearance_m=12.0).reasons(scene.maps, 40.0, (60, 82))
    assert mast == [
        "the clearance of 12 m and the vertical clearance of 3 m that is kept from obstacles and the border"
    ]


def test_over_falling_ground_the_bound_is_measured_from_where_a_path_may_pass_it():
    scene = street()
    ground_m = np.zeros(scene.maps.grid.shape, np.float32)
    ground_m[:, 56:64] = 12.0  # under the house, which stands on a terrace
    hilly = replace(scene.maps, ds=scene.maps.ds.assign(terrain=(("y", "x"), ground_m)))
    limits = ju.Constraints(clearance_m=10.0, vertical_clearance_m=0.0)
    beside = (60, 65)
    for altitude_m, is_free in ((LIMIT_M + 11.0, False), (LIMIT_M + 13.0, True)):
        assert limits.is_free(hilly, altitude_m)[beside] == is_free
    assert limits.is_free(scene.maps, LIMIT_M + 11.0)[beside]


@pytest.mark.slow
@pytest.mark.parametrize("origin", [HeightOrigin.HEIGHT, HeightOrigin.DEFAULT])
@pytest.mark.parametrize("kind", ["wire", "cableway", "mast"])
def test_a_finding_about_a_wire_says_the_height_that_was_taken(tmp_path, kind, origin):
    along = Footprints(
        np.array([shapely.box(395, 100, 405, 500)]),
        np.array([50.0]),
        np.zeros(1),
        np.array([origin], np.uint8),
        np.zeros(1, bool),
        np.array([kind], object),
        np.array([60.0]),
    )
    scene = town([HOUSE], [10.0], [False], LIMIT_M, along)
    guess = "" if origin == HeightOrigin.HEIGHT else " of guessed height"
    for height_m, wire, other in (
        (
            40.0,
            f"flies below or beside a {kind}, up to 10.0 m below its top",
            "flies through a mast, up to 10.0 m below its top",
        ),
        (52.0, f"passes 2.0 m over or under a {kind}", "passes 2.0 m over or under a mast"),
    ):
        result = checked(scene, tmp_path, across(scene, MAST, height_m))
        said = f"{wire}{guess}, whose height is taken as 50.0 m"
        assert result.findings["what"].tolist() == [
            f"{other}{guess}" if kind == "mast" else said,
        ]


def with_likely(scene: World, likely_m: float) -> World:
    """Return a scene in which what is of guessed height likely ends at a height, and its maps."""
    buildings = replace(scene.city.buildings, likely_m=np.array([likely_m]))
    others = scene.city.structures
    others = replace(others, likely_m=np.full(len(others), likely_m))
    city = replace(scene.city, buildings=buildings, structures=others)
    grid = scene.maps.grid
    surface = build_surface(city, grid, grid, has_guessed=True)
    likely = ("y", "x"), surface.roof_likely_m
    return World(replace(scene.maps, ds=scene.maps.ds.assign(roof_likely=likely)), city)


@pytest.mark.parametrize(
    ("rule", "lowest_m"), [("guess", 13.0), ("likely", 20.0), ("highest", LIMIT_M), (None, 20.0)]
)
def test_rule_says_from_which_height_on_a_cell_of_guessed_height_is_open(rule, lowest_m):
    maps = with_likely(street(), 20.0).maps
    limits = ju.Constraints(unknown_heights=rule)
    for above_m in (-0.1, 0.0, 0.1):
        assert limits.is_free(maps, lowest_m + above_m)[60, 60] == (above_m > 0)
    assert limits.to_dict()["unknown_heights"] == (rule or "likely")
    closed = ju.Constraints(unknown_heights=rule).reasons(maps, 12.0, (60, 60))
    assert len(closed) == 1


def test_paper_takes_guesses_alone_and_the_scenario_may_say_another_rule():
    maps = with_likely(street(), 20.0).maps
    assert ju.cost_map(maps, 12.0, preset="paper").is_free[60, 60]
    assert not ju.cost_map(maps, 18.0).is_free[60, 60]
    bold = maps.with_recorded({"planning": {"unknown_heights": "guess"}})
    assert ju.cost_map(bold, 18.0).is_free[60, 60]
    assert bold.planning.rules.unknown_heights == "guess"
    limits = ju.Constraints()
    assert limits.for_flight(bold.planning, "") is limits
    assert limits.for_flight(maps.planning, "").unknown_heights == "highest"


def test_between_likely_and_highest_nothing_is_clean_and_the_route_says_so(tmp_path):
    scene = with_likely(street(), 20.0)
    result = checked(scene, tmp_path, across(scene, HOUSE, 25.0))
    (sentence,) = result.not_judged
    assert "above what 99 % of their kind keep below" in sentence
    (sentence,) = checked(scene, tmp_path, across(scene, HOUSE, 19.0)).not_judged
    assert "99 %" not in sentence

    ends = ends_at(scene.maps, (60, 50), (60, 70))  # over the house, 40 m wide
    path = ju.plan(scene.maps, altitude_m=25.0, objective="distance", **ends)
    first = ju.cautions(path, scene.maps)[0]
    assert (first.kind, first.level) == ("unknown heights", "limit")
    assert first.startswith("Unknown heights: on 40 of 100 m of the route")
    with pytest.warns(ju.GuessWarning, match="Unknown heights: on 40 of 100 m"):
        path.save(tmp_path / "over.kml")
    high = ju.Constraints(unknown_heights="highest")
    around = ju.plan(scene.maps, altitude_m=25.0, objective="distance", constraints=high, **ends)
    assert around.length_m > path.length_m
    assert ju.cautions(around, scene.maps)[0].kind != "unknown heights"
