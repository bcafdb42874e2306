"""What stands beside buildings: for each value of a key its kind, a reason why nothing stands, or that it is unknown.

Values as https://wiki.openstreetmap.org/wiki/Map_features lists them. The keys of `KINDS` name what may stand: a value
that no row has is *unknown*, with the bound of its key ("*"), never nothing. A bound holds for what has no height of
its own: tanks by API 650, whose shells seldom exceed 64 ft; poles, canopies and gantries by what carries them over
streets; nothing bounds masts, towers, chimneys, cranes and cable cars. Towers of power lines end below 100 m but for
those that carry a wire across a river or a strait, in spans of more than `LONG_SPAN_M` (the Elbe: 227 m, 1,200 m). Half
widths of wires are those of the widest arms (a Danube tower of 380 kV), choices as those of cableways are.

Bounds of what is unknown are choices as well: walls 10 m (noise barriers seldom exceed 6 m), street lamps and what
hangs over streets 15 m (lamps of high masts have the tag of a mast), overhead lines 30 m, monuments, towers and gates
of old towns 60 m (few statues are higher), rides 200 m (one wheel, Ain Dubai, is higher), supports of bridges 350 m
(Millau: 343 m), and 50 m for any other value. Bridges: `jaxurban.cities.bridges`.

Of the 1,219 trees of Lower Manhattan, Boston and a cadastre of trees that have a height, 95 % end below 15 m and all
below 35 m; of the 266 with a crown it is at most 0.8 times as wide as they are high in 95 %. The canopy of 5 % of all
land is higher than 30 m (Lang et al. 2023, doi:10.1038/s41559-023-02206-6). Scrub, hedges and orchards stay below
`LOW_M`.
"""

import math
from dataclasses import dataclass
from operator import attrgetter

from jaxurban.io.issues import ReadIssue
from jaxurban.io.learned import PACKAGED
from jaxurban.world.footprints import UNKNOWN
from jaxurban.world.kinds import MOST_WOOD_M


@dataclass(frozen=True, eq=False)
class Kind:
    """A kind of structure; one of unknown height and no `height_m` is left out, unless it is of unknown kind too.

    Attributes:
      name: as `Footprints.kind` has it.
      height_m: with which one of unknown height stands in the maps; 0: it stands only with a height of its own.
      limit_m: height above ground that all but a few of unknown height keep below, inf where nothing says.
      radius_m: of one that is a point or a line, without a width or a diameter.
    """

    name: str
    height_m: float
    limit_m: float = math.inf
    radius_m: float = 1.0


@dataclass(frozen=True)
class Nothing:
    """Why a value names nothing that stands; a height makes it stand all the same."""

    reason: str


LOW_M = 6.0  # fences, doors, statues: what no table names stands from this height on
LOW = Nothing(f"ends below {LOW_M:g} m")
GROUND = Nothing("is part of the ground, or level with it or with water")
FIXED = Nothing("is part of what stands, or fixed to it")
NO_THING = Nothing("names a place or a kind of building, and no thing")
SITE = Kind("structure", 0.0)  # the ground of a plant, or what only a height makes stand
FENCE = Kind("structure", 0.0)  # which encloses what it does not fill
OTHER = Kind(UNKNOWN, 0.0)  # whose height is given and cannot be read
HULL = Kind(UNKNOWN, 0.0, radius_m=2.0)  # an outline that is not whole
UNLISTED = Kind(UNKNOWN, 0.0, 50.0)
WALLS = WALL, CITY_WALL = Kind(UNKNOWN, 0.0, 10.0), Kind(UNKNOWN, 0.0, 30.0, 2.0)
LAMP = Kind(UNKNOWN, 0.0, 15.0)
HISTORIC, MONUMENT = Kind(UNKNOWN, 0.0, 50.0), Kind(UNKNOWN, 0.0, 60.0, 5.0)
RIDE = Kind(UNKNOWN, 0.0, 200.0, 30.0)
SUPPORT = Kind(UNKNOWN, 0.0, 350.0, 5.0)
OVERHEAD, OVERGROUND = Kind(UNKNOWN, 0.0, 30.0, 2.0), Kind(UNKNOWN, 0.0, 50.0)
GENERATOR = Kind(UNKNOWN, 0.0, radius_m=50.0)  # of an unknown source: of wind, perhaps
TURBINE = Kind("turbine", 100.0, radius_m=50.0)
TOWER = Kind("tower", 30.0, radius_m=5.0)
BRIDGE = Kind("bridge", 5.5, 100.0)  # for each layer
TREE = Kind("tree", PACKAGED["tree"][0], 35.0)
WOOD = Kind("wood", 20.0, MOST_WOOD_M, 10.0)
PHONE_LINE = Kind("wire", 10.0, 30.0)
CROWN_SHARE = 0.4  # of a tree's height: the radius of a crown of unknown width
RIDE_SHARE = 0.5  # of a ride's height: half of it is a wheel's radius
GUYS_SHARE = 0.8  # of a mast's height: how far from it its guys are anchored
LONG_SPAN_M = 600.0
BURIED = ReadIssue.UNDERGROUND
Reason = Nothing | ReadIssue
_TABLE: dict[str, dict[Kind | Reason, str]] = {  # values by key and kind
    "tower:type": {TOWER: "*"},
    "man_made": {
        Kind("chimney", 30.0, radius_m=3.0): "chimney stack flare",
        TOWER: "tower communications_tower water_tower lighthouse obelisk bell_tower clock_tower watchtower minaret "
        "campanile headframe ski_jump offshore_platform cooling_tower",
        Kind("tower", 20.0, radius_m=10.0): "windmill telescope radar",
        Kind("mast", 20.0): "mast antenna beacon",
        Kind("crane", 30.0, radius_m=5.0): "crane",
        Kind("tank", 10.0, 30.0, 8.0): "tank storage_tank",
        Kind("tank", 20.0, radius_m=10.0): "silo gasometer",
        Kind("pole", 10.0, 30.0, 0.5): "flagpole utility_pole pole",
        Kind("canopy", 6.0, 20.0): "canopy gantry goods_conveyor",
        Kind("canopy", 6.0, 15.0): "beam",  # of signs and signals over streets
        BRIDGE: "bridge",
        SITE: "works wastewater_plant water_works spoil_heap",
        GROUND: "pier breakwater groyne dyke embankment cutline cutting quay courtyard excavation reservoir_covered "
        "clearcut compass_rose",
        LOW: "survey_point water_tap drinking_fountain street_cabinet planter water_well bunker_silo carpet_hanger "
        "insect_hotel cairn",
        FIXED: "surveillance",
        BURIED: "tunnel cable manhole adit",
        PHONE_LINE: "wire",
        UNLISTED: "*",
    },
    "power": {
        Kind("pylon", 30.0, 100.0, 4.0): "tower",
        Kind("pole", 10.0, 30.0, 0.5): "pole portal catenary_mast",
        SITE: "generator plant substation sub_station station transformer",
        BURIED: "cable",
        LOW: "box cable_distribution_cabinet",
        FIXED: "terminal insulator switch connection",
        Kind("wire", 30.0, 100.0, 15.0): "line",
        Kind("wire", 10.0, 30.0, 2.0): "minor_line",
        UNLISTED: "*",
    },
    "aerialway": {
        Kind("pylon", 30.0, radius_m=3.0): "pylon",
        Kind("structure", 10.0, 30.0, 10.0): "station",
        Kind(
            "cableway", 30.0, radius_m=5.0
        ): "cable_car gondola chair_lift mixed_lift goods zip_line",
        Kind("cableway", 10.0, 30.0, 3.0): "drag_lift t-bar j-bar platter rope_tow",
        GROUND: "magic_carpet",
        UNLISTED: "*",
    },
    "bridge": {BRIDGE: "*"},
    "bridge:support": {SUPPORT: "*"},
    "attraction": {
        LOW: "animal artwork bumper_car bumper_cars garden kiddie_ride maze petting_zoo playground train",
        RIDE: "*",
    },
    "roller_coaster": {RIDE: "*"},
    "historic": {
        LOW: "memorial plaque blue_plaque stone boundary_stone milestone cross wayside_cross wayside_shrine "
        "stolperstein grave",
        NO_THING: "district neighbourhood archaeological_site battlefield",
        MONUMENT: "monument tower gate city_gate column obelisk lighthouse",
        CITY_WALL: "citywalls city_wall castle_wall",
        HISTORIC: "*",
    },
    "barrier": {
        LOW: "kerb fence hedge bollard gate block lift_gate chain guard_rail jersey_barrier wedge rope turnstile "
        "full-height_turnstile swing_gate sliding_gate kissing_gate wicket_gate hampshire_gate cycle_barrier "
        "motorcycle_barrier horse_stile stile step sally_port spikes handrail railing height_restrictor log debris "
        "cable_barrier planter rock bus_trap sump_buster tank_trap delineators bar yes_gate wire_fence",
        GROUND: "ditch cattle_grid",
        FIXED: "entrance door",
        WALL: "wall retaining_wall",
        CITY_WALL: "city_wall",
        UNLISTED: "*",
    },
    "telecom": {
        PHONE_LINE: "line",
        NO_THING: "exchange data_center data_centre central_office",
        LOW: "service_device connection_point distribution_point remote_terminal street_cabinet",
        UNLISTED: "*",
    },
    "communication": {PHONE_LINE: "line", UNLISTED: "*"},
    "pipeline": {LOW: "marker valve", UNLISTED: "*"},
}
_BY_VALUE: dict[str, dict[Kind | Reason, str]] = {  # of keys whose other values are no obstacles
    "natural": {
        TREE: "tree tree_row",
        WOOD: "wood",
        LOW: "scrub shrub rock stone",
        Kind(UNKNOWN, 0.0, 50.0): "cliff",
    },
    "landuse": {WOOD: "forest"},
    "highway": {LAMP: "street_lamp"},
    "location": {OVERHEAD: "overhead", OVERGROUND: "overground"},
}
WATERS = {  # what a bridge crosses: a bank, a shore or a stream
    "natural": ("water", "coastline", "bay", "strait"),
    "waterway": ("river", "riverbank", "stream", "canal", "dock", "tidal_channel"),
}


def _by_value(table: dict[str, dict[Kind | Reason, str]]) -> dict[str, dict[str, Kind | Reason]]:
    """Return a table by key and value."""
    return {
        key: {value: kind for kind, values in kinds.items() for value in values.split()}
        for key, kinds in table.items()
    }


KINDS, BY_VALUE = _by_value(_TABLE), _by_value(_BY_VALUE)
# Columns that name kinds by our own words; some words say as well what sort a building is. Of several kinds of a name
# the one that may be highest counts.
_ALL = {kind for by_value in (BY_VALUE | KINDS).values() for kind in by_value.values()} | {TURBINE}
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
# What comes before keys, or is a value of `building`.
NOT_IN_USE = ("abandoned", "disused")
STANDING = (*NOT_IN_USE, "ruins", "construction")
OF_LIFE = ("building", "man_made", "power", "aerialway")  # the keys that have all of it
NOT_BUILT: dict[str, ReadIssue] = {  # and why nothing stands
    **dict.fromkeys(("demolished", "razed", "removed", "destroyed", "was"), ReadIssue.RAZED),
    **dict.fromkeys(("proposed", "planned"), ReadIssue.PLANNED),
}
GARAGES = ("parking", "garage", "garages")  # buildings that `parking=underground` buries
FALLS = ("waterfall", "rapids")
LANDFORMS = (  # of nature: heights of the ground or of water, and none of what stands there
    *("peak", "hill", "ridge", "arete", "saddle", "volcano", "mountain_range", "massif", "plateau"),
    *("valley", "gorge", "gully", "crater", "sinkhole", "cave_entrance", "dune", "cape"),
    *("peninsula", "isthmus", "island", "beach", "shoal", "reef", "wetland", "water", "coastline"),
    *("bay", "strait", "spring", "geyser", "glacier", "crevasse", "bare_rock", "scree", "shingle"),
    *("sand", "mud", "grassland", "heath", "moor", "fell", "tundra", *FALLS),
)
WIND = (
    "wind",
    "wind_turbine",
    "horizontal_axis",
    "vertical_axis",
)  # sources or types of generators
