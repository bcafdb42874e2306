"""What stands beside buildings: for each value of a tag its kind, or that nothing stands there.

Values as https://wiki.openstreetmap.org/wiki/Map_features lists them. A bound holds for what has no height of its own:
tanks by API 650, whose shells seldom exceed 64 ft; poles, canopies and gantries by what carries them over streets;
nothing bounds masts, towers, chimneys, cranes and cable cars. Towers of power lines end below 100 m but for those that
carry a wire across a river or a strait, in spans of more than `LONG_SPAN_M` (the Elbe: 227 m, 1,200 m). Half widths of
wires are those of the widest arms (a Danube tower of 380 kV), choices as those of cableways are.

Of the 1,219 trees of Lower Manhattan, Boston and a cadastre of trees that have a height, 95 % end below
15 m and all below 35 m; of the 266 with a crown it is at most 0.8 times as wide as they are high in 95 %. The canopy of
5 % of all land is higher than 30 m (Lang et al. 2023, doi:10.1038/s41559-023-02206-6). Scrub, hedges and orchards
stay below `LOW_M`.
"""

import math
from dataclasses import dataclass
from operator import attrgetter

from jaxurban.io.read.issues import ReadIssue
from jaxurban.world.footprints import UNKNOWN


@dataclass(frozen=True, eq=False)
class Kind:
    """A kind of structure; one of unknown height and no `height_m` is left out, unless it is of unknown kind too.

    Attributes:
      name: as `Footprints.kind` has it.
      height_m: with which one of unknown height stands in the maps; 0: it stands only with a height of its own.
      limit_m: height above ground that one of unknown height does not exceed, inf where nothing says.
      radius_m: of one that is a point or a line, without a width or a diameter.
    """

    name: str
    height_m: float
    limit_m: float = math.inf
    radius_m: float = 1.0


SITE = Kind("structure", 0.0)  # the ground of a plant, or what only a height makes stand
FENCE = Kind("structure", 0.0)  # which encloses what it does not fill
OTHER = Kind(UNKNOWN, 0.0)  # an area of a value that is in no table
HULL = Kind(UNKNOWN, 0.0, radius_m=2.0)  # an outline that is not whole
LOW_M = 6.0  # fences, doors, statues: what no table names stands from this height on
TURBINE = Kind("turbine", 100.0, radius_m=50.0)
TOWER = Kind("tower", 30.0, radius_m=5.0)
BRIDGE = Kind("bridge", 0.0, 100.0, 3.0)  # unknown without a height
TREE, CONIFER = Kind("tree", 12.0, 35.0), Kind("tree", 15.0, 35.0)
WOOD = Kind("wood", 20.0, 45.0, 10.0)
CROWN_SHARE = 0.4  # of a tree's height: the radius of a crown of unknown width
LONG_SPAN_M = 600.0
NOTHING = ReadIssue.NOT_STANDING  # a height makes it stand all the same
BURIED = ReadIssue.UNDERGROUND
_TABLE: dict[str, dict[Kind | ReadIssue, str]] = {  # values by key and kind
    "man_made": {
        Kind("chimney", 30.0, radius_m=3.0): "chimney stack flare",
        TOWER: "tower communications_tower water_tower lighthouse obelisk",
        Kind("tower", 20.0, radius_m=10.0): "windmill telescope radar",
        Kind("mast", 20.0): "mast antenna beacon",
        Kind("crane", 30.0, radius_m=5.0): "crane",
        Kind("tank", 10.0, 30.0, 8.0): "tank storage_tank",
        Kind("tank", 20.0, radius_m=10.0): "silo gasometer",
        Kind("pole", 10.0, 30.0, 0.5): "flagpole utility_pole pole",
        Kind("canopy", 6.0, 20.0): "canopy gantry goods_conveyor",
        BRIDGE: "bridge",
        SITE: "works wastewater_plant water_works pumping_station mineshaft spoil_heap",
        NOTHING: "pier breakwater groyne dyke embankment cutline cutting survey_point surveillance "
        "quay courtyard excavation water_tap drinking_fountain street_cabinet planter water_well "
        "compass_rose satellite_dish monitoring_station reservoir_covered petroleum_well "
        "bunker_silo clearcut carpet_hanger insect_hotel cross cairn advertising",
        BURIED: "tunnel pipeline cable manhole adit",
        Kind("wire", 10.0, 30.0): "wire",
    },
    "power": {
        Kind("pylon", 30.0, 100.0, 4.0): "tower",
        Kind("pole", 10.0, 30.0, 0.5): "pole portal catenary_mast",
        SITE: "generator plant substation transformer",
        BURIED: "cable",
        NOTHING: "terminal insulator switch connection box",
        Kind("wire", 30.0, 100.0, 15.0): "line",
        Kind("wire", 10.0, 30.0, 2.0): "minor_line",
    },
    "aerialway": {
        Kind("pylon", 30.0, radius_m=3.0): "pylon",
        Kind("structure", 10.0, 30.0, 10.0): "station",
        Kind(
            "cableway", 30.0, radius_m=5.0
        ): "cable_car gondola chair_lift mixed_lift goods zip_line",
        Kind("cableway", 10.0, 30.0, 3.0): "drag_lift t-bar j-bar platter rope_tow",
        NOTHING: "magic_carpet",
    },
}
_GROWN: dict[str, dict[Kind | ReadIssue, str]] = {  # of keys whose other values are no obstacles
    "natural": {TREE: "tree tree_row", WOOD: "wood", NOTHING: "scrub shrub rock stone"},
    "landuse": {WOOD: "forest"},
}


def _by_value(
    table: dict[str, dict[Kind | ReadIssue, str]],
) -> dict[str, dict[str, Kind | ReadIssue]]:
    """Return a table by key and value."""
    return {
        key: {value: kind for kind, values in kinds.items() for value in values.split()}
        for key, kinds in table.items()
    }


KINDS, GROWN = _by_value(_TABLE), _by_value(_GROWN)
# Columns that name kinds by our own words; some words say as well what sort a building is. Of several kinds of a name
# the one that may be highest counts.
_ALL = {kind for by_value in (GROWN | KINDS).values() for kind in by_value.values()} | {TURBINE}
_NAMED = sorted(
    (kind for kind in _ALL if isinstance(kind, Kind)), key=attrgetter("limit_m", "height_m")
)
_OF_BUILDINGS = (UNKNOWN, "structure", "canopy", "bridge")
_BY_NAME = {kind.name: kind for kind in _NAMED if kind.name not in _OF_BUILDINGS}
IN_WORDS = dict.fromkeys(("kind", "class", "type"), _BY_NAME)
# A building whose height nothing says. Of those of Lower Manhattan, Boston and Helsinki that have a height, houses and
# their like end below 20 m, and all others but some 1 % below 100 m; of those with levels too 99 % end below 6 m for
# each level and 10 m.
LOW_BUILDINGS = (
    *("house", "detached", "semidetached_house", "terrace", "bungalow", "cabin", "hut", "shed"),
    *("garage", "garages", "carport", "farm", "farm_auxiliary", "barn", "stable", "greenhouse"),
    *("kiosk", "static_caravan", "houseboat", "allotment_house", "boathouse", "toilets"),
)
LOW_LIMIT_M, LIMIT_M = 25.0, 100.0
LEVEL_LIMIT_M, ABOVE_LEVELS_M = 6.0, 10.0
ROUGH_LIMIT = 1.5  # times a rough figure
# What comes before a tag such as `man_made`, or is a value of `building`.
STANDING = ("abandoned", "disused", "ruins", "construction")
NOT_BUILT: dict[str, ReadIssue] = {  # and why nothing stands
    **dict.fromkeys(("demolished", "razed", "removed", "destroyed", "was"), ReadIssue.RAZED),
    **dict.fromkeys(("proposed", "planned"), ReadIssue.PLANNED),
}
GARAGES = ("parking", "garage", "garages")  # buildings that `parking=underground` buries
FALLS = ("waterfall", "rapids")
WIND = ("wind", "wind_turbine")  # sources or methods of generators
