"""What is known and what is not, as records: guesses, cautions, what stretches are not judged for, what was left out.

A record has a kind and, where there are any, a share, a number and a place. Code decides by these alone; the sentence
of a record is made where it is shown. Guesses are written down where they are made: on the `City` by what reads it, on
the `Sky` by what sets it up, and by `jaxurban.maps.guesses` what a region's maps add. The maps hold all
(`MetricMaps.guesses`), and each is warned of once.
"""

import json
import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from enum import Enum
from textwrap import shorten
from typing import Any, Literal

from jaxurban.errors import GuessWarning, in_words, warn

LEAST_SHARE = 0.01  # of buildings, cells or visibility results: a box in degrees and its projection differ by less
MOST_OF_RULE = 60  # letters that are shown of the name of a rule
MOST_KINDS = 5  # that a warning names; the record names all
HIGHEST_M = 828.0  # Burj Khalifa, the highest building of the world


class GuessKind(Enum):
    """What maps rest on that no file says: a short name for pictures, and a sentence.

    Name and sentence have places for the fields of a `Guess`, its ``facts`` among them.
    """

    # What stands, and the ground.
    FLAT_GROUND = (
        "flat ground",
        "no terrain is given, so the ground is taken as flat: heights and shadows are wrong where it is not; name an "
        "elevation raster in [terrain] source",
    )
    FILLED_TERRAIN = (
        "{share} of the terrain filled",
        "{share} of the region has no elevation in the terrain {file} and takes that of the ground around, up to "
        "{reach_m:g} m away: give a terrain without voids where that is too rough",
    )
    LOW_GROUND = (
        "{number:,} cells of the terrain without their low points",
        "the lowest ground points in {number:,} cells of the terrain {file} lie far below all around and are left out: "
        "classify them as noise, or give another terrain if they are a true pit",
    )
    RISING_TERRAIN = (
        "{share} of heights in the terrain",
        "{share} of the heights of buildings are in the terrain already, as in a surface model (SRTM, Copernicus "
        "GLO-30), so roofs stand at wrong elevations by as much: give a terrain model of the bare ground",
    )
    ESTIMATES = (
        "{share} of heights estimated by a model",
        "{number:,} of the {of:,} heights of buildings in the region are estimates of a model, which may be far too "
        "low, so nothing is judged between them and their bounds: give heights that were measured (outlines with them, "
        "or a surface model), or set [buildings] highest_m to what no building there exceeds",
    )
    HEIGHTS = (
        "{share} of heights",
        "{share} of the heights of the {number:,} buildings in the region are guessed ({kinds}{medians}): give a "
        "source with heights, or set [buildings] level_height_m and default_height_m",
    )
    HIGHEST_SAID = (
        "unknown heights up to highest_m = {highest_m}",
        "what has no known height is taken to end at [buildings] highest_m = {highest_m}, and routes and checks "
        "rest on that: leave it out where you are not sure",
    )
    HIGH_ROOFS = (
        f"{{number:,}} roofs above {HIGHEST_M:g} m",
        f"{{number:,}} buildings are above {HIGHEST_M:g} m, the highest of the world, such as that of {{height_m:g}} m "
        "at {place}: mend their heights",
    )
    STRUCTURES = (
        "{number:,} structures of unknown height",
        "the height or the extent of {number:,} structures in the region is not known ({kinds}): paths keep away from "
        "them and checks do not judge what flies near them, up to what their kind may reach; give them heights, or a "
        "file in which they are whole",
    )
    WITHOUT_SHAPE = (
        "{number:,} objects without a shape",
        "{number:,} objects in the file of buildings have no shape that is read, so it is not known where they stand, "
        "and nothing keeps away from them: give them shapes, or remove them",
    )
    COARSE_SOLIDS = (
        "{number:,} buildings as high as their coarser solids",
        "the finest solids of {number:,} buildings are more than 3 m lower than coarser ones, or than the heights that "
        "the file gives, so the higher ones stand: mend the wrong ones",
    )
    NODATA_ZERO = (
        "{share} of heights by the nodata value 0",
        "{share} of the cells of {file} hold its nodata value 0 and are taken as ground on which nothing stands: give "
        "those another nodata value where heights are not known",
    )
    WIDE_PIXELS = (
        "heights averaged over pixels",
        "the pixels of the raster of buildings are {side_m:.0f} m wide, wider than most buildings, so their heights "
        "are averages: streets are built over, and towers are higher than it says; give outlines, or a raster of 10 m "
        "or finer",
    )
    PIXELS_OF_MODEL = (
        "heights estimated by a model",
        "the heights of {file} are estimates of a model, which may be far too low, and a raster has no bounds, so that "
        "they count as measured: judge flights over outlines with heights, or a surface model that was measured",
    )
    UNIT_OF_HEIGHTS = (
        "the unit of heights",
        "half of the built pixels of the raster of buildings are above {height_m:.0f} m, as in no city, read in "
        "metres: if it holds decimetres, say so with `gdal_edit.py -scale 0.1`",
    )
    WITHOUT_PLANTS = (
        "{share} of the region without known plants",
        "{share} of the region lies beyond {file} or where it has no data: paths keep above {limit_m:g} m there, and "
        "checks do not judge what flies lower; give a raster that covers it, with 0 where nothing grows",
    )
    WITHOUT_DATA = (
        "{share} of the region without data",
        "{share} of the region lies beyond what the building source covers and is taken as free of buildings: give a "
        "source that covers it, or a smaller region",
    )
    HANGING = (
        "{number:,} hanging parts",
        "{number:,} parts and decks hang over the region, from their floor to their top: lidar meets those with their "
        "floor at or below the altitude as if they reached the ground, and none above it; paths keep away from all "
        'that is under them; set [buildings] hanging = "to_ground" for none',
    )

    # Satellites.
    NOMINAL_SKY = (
        "nominal satellites",
        "the {systems} satellites are nominal ones at {time}, not the real ones: name a file of elements in [gps] "
        "orbits",
    )
    ELEMENTS_TIME = (
        "time of the elements",
        "no times are given: satellites stand as at {time}, the middle of their elements' epochs; set [gps] times for "
        "another",
    )
    WITHOUT_PLACE = (
        "satellites without a place",
        "left out where the orbits say nothing of a time or call the satellite unhealthy: {satellites}",
    )
    BEYOND_DATA = (
        "{share} of lines of sight to satellites leave the data",
        "{share} of the visibility results at {altitude_m:g} m are of rays that leave the data below the highest roof "
        "and count as clear there, so GPS may look better than it is: give the buildings of a wider area",
    )
    HIDING_ROOFS = (
        "heights of the roofs that hide {number} of {of} satellites",
        "",
    )

    # People.
    NOBODY = (
        "nobody",
        "all census counts in and around the region are 0: check [population] table and its count",
    )
    UNCOUNTED_BLOCKS = (
        "{number:,} blocks without a count",
        "{number:,} of {of:,} census blocks in and around the region are read as 0 people (in {unreadable:,} the count "
        "cannot be read, {missing:,} have none): mend the counts, or write 0 where nobody lives",
    )
    NO_COMMERCIAL = (
        "no commercial district",
        "[population] commercial lists no district of {file} ({field}), so all count as residential and by day every "
        "block takes gamma_residential: list the labels, or give [] for none",
    )
    PEOPLE_BY_FACTORS = (
        "people by factors",
        "people by day are not counted: they are the census's times {commercial:g} in commercial districts and "
        "{residential:g} elsewhere; set [population] gamma_commercial and gamma_residential",
    )
    WITHOUT_CENSUS = (
        "{share} of the region without census",
        "{share} of the region lies in no census block and is taken as without people: give blocks that cover it, "
        "unless it is water",
    )
    ONE_BLOCK = (
        "one block sets the population scale",
        "census block {block} ({area_m2:,.0f} m2) with {people:,.0f} {unit} sets the population scale alone: the "
        'median inhabited block gets {median:.2f}; set [population] normalise to a percentile such as "p99" or to a '
        "number of {unit} such as {usual:.0f}",
    )

    # A user's layers.
    BEYOND_LAYER = (
        "{share} of the region beyond layer {layer}",
        "{share} of the region lies beyond the raster of layer {layer} and is closed to every path: give a raster that "
        "covers it, or a smaller region",
    )
    EMPTY_LAYER = (
        "{share} of layer {layer} without a value",
        "{share} of the pixels of layer {layer} hold no value and are closed to every path: fill them, unless they are "
        'meant to be closed, or set nan = "error"',
    )


OF_SKY = (
    GuessKind.NOMINAL_SKY,
    GuessKind.ELEMENTS_TIME,
    GuessKind.WITHOUT_PLACE,
    GuessKind.BEYOND_DATA,
)
OF_PEOPLE = (
    GuessKind.NOBODY,
    GuessKind.UNCOUNTED_BLOCKS,
    GuessKind.NO_COMMERCIAL,
    GuessKind.PEOPLE_BY_FACTORS,
    GuessKind.WITHOUT_CENSUS,
)


@dataclass(frozen=True)
class Guess:
    """Something that maps rest on and no file says.

    Attributes:
      kind: what is guessed.
      share: of what it is about, 0 to 1; of no meaning where the kind has none.
      number: how many it is about; of no meaning where the kind has none.
      place: longitude and latitude of the first, in degrees; None where it has none.
      facts: what else its name and its sentence say, by name.
    """

    kind: GuessKind
    share: float = 1.0
    number: int = 0
    place: tuple[float, float] | None = None
    facts: Mapping[str, Any] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """A few words, for pictures."""
        return re.sub(r"^1 (\w+)s\b", r"1 \1", self._with_facts(self.kind.value[0]))

    @property
    def sentence(self) -> str:
        """The guess with its remedy."""
        return in_words(self._with_facts(self.kind.value[1]))

    @property
    def warning(self) -> str:
        """The sentence with the commonest kinds alone, and without the medians."""
        kinds = str(self.facts.get("kinds", "")).split(", ")
        short = ", ".join(kinds[:MOST_KINDS])
        if len(kinds) > MOST_KINDS:
            short += " and so on"
        return replace(self, facts={**self.facts, "kinds": short, "medians": ""}).sentence

    def _with_facts(self, words: str) -> str:
        """Return words with the record's own facts in their places."""
        place = "{:.5f}, {:.5f} (lon, lat)".format(*self.place) if self.place else ""
        own = {"share": percent(self.share), "number": self.number, "place": place}
        return words.format_map({**self.facts, **own})

    def to_dict(self) -> dict[str, Any]:
        """Return the record as plain, JSON-ready values."""
        return asdict(self) | {"kind": self.kind.name.lower()}


Guesses = tuple[Guess, ...]


def guesses_from(text: str) -> Guesses:
    """Return the guesses that a text of JSON holds, a list of `Guess.to_dict`.

    Raises:
      KeyError, TypeError, ValueError: it is no such list, or holds a kind or facts that are not known.
    """
    guesses = []
    for record in json.loads(text):
        guess = Guess(**record | {"kind": GuessKind[record["kind"].upper()]})
        str(guess.name + guess.sentence)  # whose facts must be there, and of their types
        guesses.append(guess)
    return tuple(guesses)


def guesses_to(guesses: Guesses) -> str:
    """Return guesses as a text of JSON."""
    return json.dumps([guess.to_dict() for guess in guesses], default=float)


def guessed(
    kind: GuessKind,
    share: float = 1.0,
    number: int = 0,
    place: tuple[float, float] | None = None,
    least: float = LEAST_SHARE,
    **facts: Any,
) -> Guesses:
    """Return a guess; up to the share ``least`` there is none."""
    return (Guess(kind, share, number, place, facts),) if share > least else ()


def warn_of(guesses: Guesses, known: Collection[Guess] = ()) -> None:
    """Warn of each guess that is not known already."""
    for guess in guesses:
        if guess not in known:
            warn(guess.warning, GuessWarning)


def shown_rule(name: str) -> str:
    """Return as much of the name of a rule, which may hold many values, as there is room for."""
    return shorten(name, MOST_OF_RULE, placeholder=" ...")


def percent(share: float) -> str:
    """Return a share in whole percent, never 0 or 100 % where it is not."""
    if 0 < share < 0.01:
        return "< 1 %"
    return "> 99 %" if 0.99 < share < 1 else f"{100 * share:.0f} %"


Level = Literal["guess", "note", "limit"]
CautionKind = Literal[
    "guess",  # what no file says
    "fix",
    "clearance",
    "roof",
    "end",
    "manoeuvre",
    "search",  # what the planner says
    "unknown heights",
    "finding",  # of a check
    "not judged",
    "other",
]


Unjudged = Literal[  # what is not known on a stretch of a mission
    "height",  # of the mission
    "outside",  # the maps
    "altitude",  # of the maps
    "data",
    "city",
    "ground",  # well enough
    "roof",  # of guessed height
    "corner",  # whether it is cut
]


class Caution(str):
    """A sentence to a pilot, a `str` that is a record as well.

    Attributes:
      level: ``"guess"``: it rests on what no file says. ``"limit"``: something lies beyond limits: a stretch without a
        fix, cells that a building as high touches, a height over a roof below the vertical clearance (1 m where none
        was asked), a building nearer than the clearance and the vehicle's radius, or a manoeuvre beyond the vehicle.
        ``"note"``: all else.
      kind: what it is about.
    """

    level: Level
    kind: CautionKind

    def __new__(cls, text: str, level: Level = "note", kind: CautionKind = "other") -> "Caution":
        """Return a sentence with its level and kind."""
        caution = super().__new__(cls, in_words(text))
        caution.level = level
        caution.kind = kind
        return caution


def sentences_of(text: str) -> list[str]:
    """Return the sentences of a text; each ends with a full stop, before a capital letter."""
    return re.split(r"(?<=\.) (?=[A-Z])", text) if text else []


def caution_of_guesses(guesses: Iterable[Guess], *more: str) -> list[Caution]:
    """Return what no file says in one sentence: guesses by their short names, and more on them; nothing of none."""
    facts = [names_of(guesses), *more]
    if not any(facts):
        return []
    return [Caution(f"Guessed: {'; '.join(filter(None, facts))}.", "guess", "guess")]


def names_of(guesses: Iterable[Guess]) -> str:
    """Return the short names of guesses."""
    return ", ".join(guess.name for guess in guesses)


def caution_lines(cautions: Iterable[Caution]) -> list[str]:
    """Return a line of text for each caution, its level first."""
    return [f"  {each.level}: {each}" for each in cautions]
