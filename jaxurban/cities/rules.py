"""What stands: one table of rules, which give a feature a kind, a reason why nothing stands, or unknown.

A rule holds for a feature by the values of a key (``KEY: VALUE VALUE ...``, in small letters; ``KEY of points: ...`` of
points alone), or by a sign of `signs.py` that has its name. Of all rules that hold **the strongest decides, of
equally strong ones the last of the table**; its name stays with what stands (`Footprints.rule`). From the weakest:

- `ALONE`: what decides only where no other rule holds.
- `REASON`: a reason why nothing stands.
- `GROUNDS`: something of no kind, which stands only with a height of its own, as the grounds of a plant do.
- `UNSURE`: something of unknown kind or extent. Values are no sign of it where something is low or stands indoors, nor
  is the word yes of a pond, which says that this is historic or made.
- `SURE`: a structure of a known kind.
- `BUILDINGS`: a building, which the bound of what else it is bounds too.

Values are those of https://wiki.openstreetmap.org/wiki/Map_features. "*" is any value that no other row of its key has:
it is unknown with a bound, never nothing. Of a list of values (``a;b``) the strongest counts, of equals the first.
"""

from collections.abc import Mapping
from functools import reduce
from itertools import product
from typing import Literal

import numpy as np
import pandas as pd

from jaxurban.cities.kinds import (
    BRIDGE,
    CITY_WALL,
    FENCE,
    HISTORIC,
    HULL,
    IN_SPANS,
    LOW_M,
    MONUMENT,
    RIDE,
    TURBINE,
    UNLISTED,
    WALL,
    WOOD,
    Kind,
    Nothing,
)
from jaxurban.cities.outlines import Outlines
from jaxurban.cities.signs import NO, ZERO, Signs
from jaxurban.io.issues import ReadIssue
from jaxurban.io.learned import PACKAGED
from jaxurban.world.footprints import BUILDING, UNKNOWN

REASON, GROUNDS, UNSURE, SURE = range(4)
LOW = Nothing(f"ends below {LOW_M:g} m")
GROUND = Nothing("is part of the ground, or level with it or with water")
FIXED = Nothing("is part of what stands, or fixed to it")
NO_THING = Nothing("names a place or a kind of building, and no thing")
BURIED = Nothing("lies below the ground", ReadIssue.UNDERGROUND)
SITE = Kind("structure", 0.0)  # the ground of a plant, or what only a height makes stand
LAMP = Kind(UNKNOWN, 0.0, 15.0, source="chosen; above all lamps in the extracts (10 m)")
CHIMNEY = Kind("chimney", 30.0, radius_m=3.0)
TOWER = Kind("tower", 30.0, radius_m=5.0)
MAST = Kind("mast", 20.0)
CRANE = Kind("crane", 30.0, radius_m=5.0)
SILO = Kind("tank", 20.0, radius_m=10.0)
POLE = Kind("pole", 10.0, 30.0, 0.5, "chosen; above all in the extracts (27 m)")
PYLON = Kind("pylon", 30.0, radius_m=3.0)
TREE = Kind(
    "tree", PACKAGED["tree"][0], 35.0, source="1,219 trees with heights: all end below 35 m"
)
POWER_LINE = Kind("wire", 30.0, 100.0, 15.0, IN_SPANS)
PHONE_LINE = Kind("wire", 10.0, 30.0, source=IN_SPANS)
CABLEWAY = Kind("cableway", 30.0, radius_m=5.0)
Gives = Kind | Nothing | Literal["building"]
# Columns that name kinds by our own words; some words say as well what sort a building is, and are none of these.
OWN_KEYS = ("kind", "class", "type")
OURS = (CHIMNEY, TOWER, MAST, CRANE, SILO, POLE, PYLON, TURBINE, TREE, WOOD, POWER_LINE, CABLEWAY)
ALONE: dict[str, Gives] = {
    "nothing of the table": Nothing("names nothing that stands", ReadIssue.NOT_BUILDINGS),
    "area in a file that names no buildings": BUILDING,
    "height in words": UNLISTED,
}
THINGS: dict[str, Kind | Nothing] = {
    "height below 6 m": LOW,
    "form of the land, or a waterfall": GROUND,
    "razed": Nothing("does not stand any more", ReadIssue.RAZED),
    "planned": Nothing("does not stand yet", ReadIssue.PLANNED),
    "traffic above the ground": FIXED,
    "height of 6 m or more": SITE,
    "height beyond 1,000 m, or that cannot be read": Kind(UNKNOWN, 0.0),
    "generator of unknown source and height": Kind(UNKNOWN, 0.0, radius_m=50.0),  # of wind, perhaps
    "barrier of 6 m or more": FENCE,
    "way of traffic above the ground": BRIDGE,
    "wind turbine": TURBINE,
    # Keys of which other values name no obstacles.
    "natural: tree tree_row": TREE,
    "natural: wood": WOOD,
    "natural: scrub shrub rock stone": LOW,
    "natural: cliff": Kind(UNKNOWN, 0.0, 50.0),
    "landuse: forest": WOOD,
    "highway: street_lamp": LAMP,
    "location: overhead": Kind(UNKNOWN, 0.0, 30.0, 2.0),
    "location: overground": Kind(UNKNOWN, 0.0, 50.0),
    "location of points: overhead overground": LAMP,
    **{f"{key}: {kind.name}": kind for key, kind in product(OWN_KEYS, OURS)},
    # Keys of which any value names what may stand.
    "tower:type: *": TOWER,
    "man_made: chimney stack flare": CHIMNEY,
    "man_made: tower communications_tower water_tower lighthouse obelisk bell_tower clock_tower watchtower "
    "minaret campanile headframe ski_jump offshore_platform cooling_tower": TOWER,
    "man_made: windmill telescope radar": Kind("tower", 20.0, radius_m=10.0),
    "man_made: mast antenna beacon": MAST,
    "man_made: crane": CRANE,
    "man_made: tank storage_tank": Kind(
        "tank", 10.0, 30.0, 8.0, "shells by API 650 seldom exceed 64 ft"
    ),
    "man_made: silo gasometer": SILO,
    "man_made: flagpole utility_pole pole": POLE,
    "man_made: canopy gantry goods_conveyor": Kind("canopy", 6.0, 20.0),
    "man_made: beam": Kind("canopy", 6.0, 15.0),  # of signs and signals over streets
    "man_made: bridge": BRIDGE,
    "man_made: works wastewater_plant water_works spoil_heap": SITE,
    "man_made: pier breakwater groyne dyke embankment cutline cutting quay courtyard excavation reservoir_covered "
    "clearcut compass_rose": GROUND,
    "man_made: survey_point water_tap drinking_fountain street_cabinet planter water_well bunker_silo "
    "carpet_hanger insect_hotel cairn": LOW,
    "man_made: surveillance": FIXED,
    "man_made: tunnel cable manhole adit": BURIED,
    "man_made: wire": PHONE_LINE,
    "man_made: *": UNLISTED,
    "power: tower": Kind(
        "pylon", 30.0, 100.0, 4.0, "chosen; higher ones carry wires across water (the Elbe: 227 m)"
    ),
    "power: pole portal catenary_mast": POLE,
    "power: generator plant substation sub_station station transformer": SITE,
    "power: cable": BURIED,
    "power: box cable_distribution_cabinet": LOW,
    "power: terminal insulator switch connection": FIXED,
    "power: line": POWER_LINE,
    "power: minor_line": Kind("wire", 10.0, 30.0, 2.0, IN_SPANS),
    "power: *": UNLISTED,
    "aerialway: pylon": PYLON,
    "aerialway: station": Kind("structure", 10.0, 30.0, 10.0),
    "aerialway: cable_car gondola chair_lift mixed_lift goods zip_line": CABLEWAY,
    "aerialway: drag_lift t-bar j-bar platter rope_tow": Kind(
        "cableway", 10.0, 30.0, 3.0, IN_SPANS
    ),
    "aerialway: magic_carpet": GROUND,
    "aerialway: *": UNLISTED,
    "bridge: *": BRIDGE,
    "bridge:support: *": Kind(UNKNOWN, 0.0, 350.0, 5.0, "chosen; Millau has one of 343 m"),
    "attraction: animal artwork bumper_car bumper_cars garden kiddie_ride maze petting_zoo playground train": LOW,
    "attraction: *": RIDE,
    "roller_coaster: *": RIDE,
    "historic: memorial plaque blue_plaque stone boundary_stone milestone cross wayside_cross wayside_shrine "
    "stolperstein grave": LOW,
    "historic: district neighbourhood archaeological_site battlefield": NO_THING,
    "historic: monument tower gate city_gate column obelisk lighthouse": MONUMENT,
    "historic: citywalls city_wall castle_wall": CITY_WALL,
    "historic: *": HISTORIC,
    "barrier: kerb fence hedge bollard gate block lift_gate chain guard_rail jersey_barrier wedge rope turnstile "
    "full-height_turnstile swing_gate sliding_gate kissing_gate wicket_gate hampshire_gate cycle_barrier "
    "motorcycle_barrier horse_stile stile step sally_port spikes handrail railing height_restrictor log debris "
    "cable_barrier planter rock bus_trap sump_buster tank_trap delineators bar yes_gate wire_fence": LOW,
    "barrier: ditch cattle_grid": GROUND,
    "barrier: entrance door": FIXED,
    "barrier: wall retaining_wall": WALL,
    "barrier: city_wall": CITY_WALL,
    "barrier: *": UNLISTED,
    "telecom: line": PHONE_LINE,
    "telecom: exchange data_center data_centre central_office": NO_THING,
    "telecom: service_device connection_point distribution_point remote_terminal street_cabinet": LOW,
    "telecom: *": UNLISTED,
    "communication: line": PHONE_LINE,
    "communication: *": UNLISTED,
    "pipeline: marker valve": LOW,
    "pipeline: *": UNLISTED,
}
BUILDINGS: dict[str, Gives] = {
    "deck of a bridge": BUILDING,
    "building": BUILDING,
    "building without an area": HULL,
}
# What else than by their value is called that is of unknown kind.
LABELS = {
    "height in words": "height",
    "generator of unknown source and height": "power=generator",
}


def _strength(name: str) -> int:
    """Return how much a rule of `THINGS` counts beside others."""
    gives = THINGS[name]
    if isinstance(gives, Nothing):
        return REASON
    if gives is SITE:
        return GROUNDS
    return UNSURE if gives.name == UNKNOWN else SURE


RULES = ALONE | {name: THINGS[name] for name in sorted(THINGS, key=_strength)} | BUILDINGS
RANKS = {name: np.int16(rank) for rank, name in enumerate(RULES)}
NAMES = np.array([*RULES], object)
GIVES = np.array([*RULES.values()], object)
IS_UNSURE = np.array([name in THINGS and _strength(name) == UNSURE for name in RULES])
VALUES: dict[str, dict[str, str]] = {}  # the rules by key, with the shape, and by value
for name in THINGS:
    key, _, values = name.partition(": ")
    for value in values.split():
        VALUES.setdefault(key, {})[value] = name
KINDS = {key: rules for key, rules in VALUES.items() if "*" in rules}
IN_WORDS = {key: VALUES[key] for key in OWN_KEYS}
BY_VALUE = {
    key: rules for key, rules in VALUES.items() if key not in KINDS | IN_WORDS and " of " not in key
}


def decide(outlines: Outlines, signs: Signs) -> tuple[np.ndarray, np.ndarray]:
    """Return the rule that decides on each of ``N`` features, and the one that decides what it is beside a building.

    Args:
      outlines: the features.
      signs: of these.

    Returns:
      Indices of `RULES`, ``[N]`` each.
    """
    held = [RANKS[name] * signs[name] for name in signs.keys() & (ALONE | THINGS)]
    for key, rules in VALUES.items():
        tag, _, shape = key.partition(" of ")
        if tag in outlines.tags:
            held.append(_by_value(outlines, signs, tag, rules) * signs.get(shape, True))
    beside = reduce(np.maximum, held)
    return reduce(np.maximum, [RANKS[name] * signs[name] for name in BUILDINGS], beside), beside


def _by_value(outlines: Outlines, signs: Signs, tag: str, rules: Mapping[str, str]) -> np.ndarray:
    """Return ``[N]`` which rule decides by the values of a tag, as an index of `RULES`, 0 where none does.

    Args:
      outlines, signs: as of `decide`.
      tag: with the values.
      rules: by value.
    """
    texts = outlines.texts(tag)
    numbers, different = pd.factorize(texts)
    has_numbers = "building" in outlines.tags  # and is no column of numbers
    deciding = [RANKS[_strongest(text, rules, has_numbers)] for text in different]
    ranks = np.array(deciding, np.int16)[numbers]
    is_no_sign = signs["low"] | (signs["pond"] & (texts == "yes"))
    ranks[is_no_sign & IS_UNSURE[ranks]] = 0
    return ranks


def _strongest(text: str, rules: Mapping[str, str], has_numbers: bool) -> str:
    """Return the strongest rule by a value, or by a list of them with semicolons; the first of all without one.

    Args:
      text: the value in small letters.
      rules: by value.
      has_numbers: whether a number but 0 names something as well.
    """
    words = [word.strip() for word in text.split(";")]
    words = [word for word in words if word not in (*NO, *ZERO)]
    other = rules.get("*")
    named = [rules.get(word, other) for word in words if has_numbers or word[0].isalpha()]
    return max(filter(None, named), key=_strength, default=NAMES[0])


def labels_of(outlines: Outlines, ranks: np.ndarray) -> np.ndarray:
    """Return ``[N]`` what the file calls what is unknown by the rules that decide, ``""`` of all else."""
    labels = np.full(len(ranks), "", object)
    is_unknown = np.array([getattr(gives, "name", "") == UNKNOWN for gives in GIVES])
    for index in np.flatnonzero(is_unknown[ranks]):
        name = NAMES[ranks[index]]
        tag = name.partition(": ")[0].partition(" of ")[0]
        labels[index] = LABELS.get(name, "")
        if tag in outlines.tags:
            labels[index] = f"{tag}={outlines.texts(tag)[index]}"
    return labels
