"""One rule decides on each feature, the strongest, of equals that of the highest bound, and its name stays with it."""

import numpy as np
import pytest
import shapely
from shapely.geometry import LineString, Point, box

from jaxurban.cities.columns import tags_of
from jaxurban.cities.outlines import Outlines
from jaxurban.cities.rules import ALONE, BUILDINGS, NAMES, OURS, RULES, THINGS, decide
from jaxurban.cities.signs import signs_of
from jaxurban.world.kinds import ALL_KINDS
from tests.cities.test_stands import AREA, PLACE, WAY, stand

OF_BUILDINGS = {"building", "structure", "canopy", "bridge"}  # words that sort buildings as well


def deciding(shape, **tags):
    """Return the name of the rule that decides on a feature of a file that names buildings."""
    columns = {
        name: np.array([value], object) for name, value in ({"building": None} | tags).items()
    }
    outlines = Outlines(np.array([shape], object), tags_of(columns), "EPSG:32618", (), {})
    signs = signs_of(outlines, False) | {"below": np.zeros(1, bool)}
    decided, _, _ = decide(outlines, signs)
    return NAMES[decided[0]]


@pytest.mark.parametrize(
    ("shape", "tags", "rule"),
    [
        (PLACE, {"craft": "tailor"}, "nothing of the table"),
        (PLACE, {"amenity": "bench", "height": "1"}, "height below 6 m"),
        (PLACE, {"natural": "tree", "height": "18"}, "natural: tree tree_row"),
        (AREA, {"man_made": "windmill", "building": "yes"}, "building"),
        (PLACE, {"man_made": "windmill", "building": "no"}, "man_made: windmill telescope radar"),
        (AREA, {"natural": "water", "building": "yes"}, "building"),
        (AREA, {"natural": "water", "historic": "yes"}, "form of the land, or a waterfall"),
        (AREA, {"natural": "water", "historic": "ship"}, "historic: *"),
        (PLACE, {"highway": "bus_stop", "layer": "1"}, "traffic above the ground"),
        (WAY, {"highway": "primary", "layer": "1"}, "way of traffic above the ground"),
        (WAY, {"highway": "primary", "layer": "1", "bridge": "yes"}, "bridge: *"),
        (PLACE, {"location": "overhead"}, "location of points: overhead overground"),
        (WAY, {"location": "overhead"}, "location of ways: overhead"),
        (PLACE, {"location": "overhead", "man_made": "thing"}, "man_made: *"),
        (PLACE, {"man_made": "pier", "height": "12"}, "height of 6 m or more"),
        (PLACE, {"man_made": "pier", "demolished:man_made": "mast", "height": "12"},
         "man_made: pier breakwater groyne dyke embankment cutline cutting quay courtyard excavation "
         "reservoir_covered clearcut compass_rose"),
        (AREA, {"demolished:building": "yes", "height": "12"}, "razed"),
        (WAY, {"building": "yes"}, "building without an area"),
    ],
)  # fmt: skip
def test_a_feature_has_the_rule_that_says_most_of_it(shape, tags, rule):
    assert deciding(shape, **tags) == rule


def test_the_rule_that_decided_stays_with_what_stands():
    yard, mast = box(20, 0, 30, 10), {"man_made": "mast", "tower:construction": "guyed"}
    tree, line = {"natural": "tree"}, LineString([(50, 0), (50, 30), (90, 30)])
    buildings, structures, _ = stand(
        (AREA, {"building": "yes"}),
        (yard, {"building:part": "yes"}),
        (Point(60, 60), tree),
        (Point(70, 70), mast),
        (line, {"power": "line"}),
        (PLACE, {"amenity": "bench"}),
    )
    assert buildings.rules.tolist() == ["building"] * 2
    spans = ["power: line"] * 2
    trees = ["natural: tree tree_row", "man_made: mast antenna beacon"]
    assert structures.rules.tolist() == [*trees, *spans, "guys of a mast"]
    everything = buildings.joined(structures)
    assert everything.rules.tolist() == [*buildings.rules, *structures.rules]
    assert (
        everything.take(shapely.area(everything.polygons) == 100).rules.tolist() == ["building"] * 2
    )


def test_every_rule_without_values_has_its_sign_and_no_two_rules_have_one_name():
    assert len(RULES) == len(ALONE) + len(THINGS) + len(BUILDINGS)
    nothing = Outlines(np.empty(0, object), {}, "EPSG:32618", (), {})
    without_values = {name for name in RULES if ": " not in name}
    shapes = {"points", "ways", "areas", "lone things", "lone areas", "lone points"}
    beside = shapes | {"names", "low", "pond", "part"}
    assert signs_of(nothing, False).keys() - beside == without_values - {"nothing of the table"}


def test_our_words_for_kinds_are_the_names_of_all_of_them_but_of_sorts_of_buildings():
    assert {kind.name for kind in OURS} == {*ALL_KINDS} - OF_BUILDINGS
