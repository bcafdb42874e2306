"""Kinds of what stands beside buildings, with their guesses, bounds and sizes; `rules.py` says what is of which.

A bound holds for what has no height of its own; `Kind.source` says from what it follows. Nothing bounds masts, towers,
chimneys, cranes and cable cars. A power line that crosses a river or a strait in a span of more than `LONG_SPAN_M`
hangs from higher towers than others (the Elbe: 227 m, 1,200 m). Half widths of wires are those of the widest arms (a
Danube tower of 380 kV), choices as those of cableways are. Bridges: `jaxurban.cities.bridges`.

Of the 1,219 trees of Lower Manhattan, Boston and a cadastre of trees that have a height, 95 % end below 15 m and all
below 35 m; of the 266 with a crown it is at most 0.8 times as wide as they are high in 95 %. Scrub, hedges and orchards
stay below `LOW_M`.
"""

import math
from dataclasses import dataclass

from jaxurban.io.issues import ReadIssue
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
      source: of the limit.
    """

    name: str
    height_m: float
    limit_m: float = math.inf
    radius_m: float = 1.0
    source: str = "chosen"


def unknown(limit_m: float = math.inf, radius_m: float = 1.0, source: str = "chosen") -> Kind:
    """Return a kind of what is of unknown kind; arguments are attributes of `Kind`."""
    return Kind(UNKNOWN, 0.0, limit_m, radius_m, source)


@dataclass(frozen=True)
class Nothing:
    """Why nothing stands, and as what it is counted; of most a height makes it stand all the same."""

    reason: str
    counted_as: ReadIssue = ReadIssue.NOT_STANDING


LOW_M = 6.0  # fences, doors, statues: what no table names stands from this height on
FENCE = Kind("structure", 0.0)  # which encloses what it does not fill
HULL = unknown(radius_m=2.0)  # an outline that is not whole
UNLISTED = unknown(50.0)
WALL = unknown(10.0, source="chosen; noise barriers seldom exceed 6 m")
CITY_WALL = unknown(30.0, 2.0)
WALLS = WALL, CITY_WALL
HISTORIC = unknown(50.0)
MONUMENT = unknown(60.0, 5.0, "chosen; few statues are higher")
RIDE = unknown(200.0, 30.0, "chosen; one wheel, Ain Dubai (250 m), is higher")
TURBINE = Kind("turbine", 100.0, radius_m=50.0)
BRIDGE = Kind("bridge", 5.5, 100.0, source="chosen; see below")  # for each layer
CANOPIES = (
    "of all land 5 % has a canopy above 30 m (Lang et al. 2023, doi:10.1038/s41559-023-02206-6)"
)
WOOD = Kind("wood", 20.0, MOST_WOOD_M, 10.0, CANOPIES)
CROWN_SHARE = 0.4  # of a tree's height: the radius of a crown of unknown width
RIDE_SHARE = 0.5  # of a ride's height: half of it is a wheel's radius
GUYS_SHARE = 0.8  # of a mast's height: how far from it its guys are anchored
LONG_SPAN_M = 600.0
IN_SPANS = f"chosen; none where a span exceeds {LONG_SPAN_M:g} m"
# A building whose height nothing says. Of those of Lower Manhattan, Boston and Helsinki that have a height, houses and
# their like end below 20 m, and all others but some 1 % below 100 m; of those with levels too 99 % end below 6 m for
# each level and 10 m.
LOW_BUILDINGS = (
    "house detached semidetached_house terrace bungalow cabin hut shed garage garages carport farm farm_auxiliary barn "
    "stable greenhouse kiosk static_caravan houseboat allotment_house boathouse toilets"
)
LOW_LIMIT_M, LIMIT_M = 25.0, 100.0
LEVEL_LIMIT_M, ABOVE_LEVELS_M = 6.0, 10.0
ROUGH_LIMIT = 1.5  # times a rough figure
# What comes before keys, or is a value of `building`.
NOT_IN_USE = ("abandoned", "disused")
STANDING = (*NOT_IN_USE, "ruins", "construction")
OF_LIFE = ("building", "man_made", "power", "aerialway")  # the keys that have all of it
GONE = {  # by why nothing stands
    ReadIssue.RAZED: ("demolished", "razed", "removed", "destroyed", "was"),
    ReadIssue.PLANNED: ("proposed", "planned"),
}
NOT_BUILT = GONE[ReadIssue.RAZED] + GONE[ReadIssue.PLANNED]
GARAGES = ("parking", "garage", "garages")  # buildings that `parking=underground` buries
FALLS = ("waterfall", "rapids")
LANDFORMS = (  # of nature: heights of the ground or of water, and none of what stands there
    "peak hill ridge arete saddle volcano mountain_range massif plateau valley gorge gully crater sinkhole "
    "cave_entrance dune cape peninsula isthmus island beach shoal reef wetland water coastline bay strait spring "
    "geyser glacier crevasse bare_rock scree shingle sand mud grassland heath moor fell tundra waterfall rapids"
)
WIND = ("wind", "wind_turbine", "horizontal_axis", "vertical_axis")  # of generators
WATERS = {  # what a bridge crosses: a bank, a shore or a stream
    "natural": ("water", "coastline", "bay", "strait"),
    "waterway": ("river", "riverbank", "stream", "canal", "dock", "tidal_channel"),
}
