"""Trials: a random city and its flights by their number, what a check says of them, and the law over that."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyproj
import shapely

from tests.cities.generator.extracts import FROM_EXTRACTS
from tests.cities.generator.judge import Truth, confirmed, invented, seen_by_ogr, truth_of
from tests.cities.generator.plant import (
    EDITS,
    SIDE_M,
    SLOT_M,
    Draw,
    Prism,
    Record,
    Thing,
    plant,
)
from tests.cities.generator.verdicts import Verdict, verdicts_of
from tests.cities.generator.write import BOUNDS, CORNER_M, CRS, STYLES, TO_LONLAT, write

# Through a thing, from one place in it to another, beside it, over it, and away from all: some as often again.
AIMS = (*("through",) * 4, *("free",) * 3, "inside", "beside", "over")
# Of twenty cities so many are of a style.
TURNS = (
    *("osm", "tags", "osm", "faces", "osm", "overture", "tags, ten letters", "nested tags"),
    *("osm", "other_tags", "heightroof", "osm", "polyhedral", "HEIGHT in feet", "osm"),
    *("TopHeight", "out geom", "b3_h_dak_max", "faces alone", "HAUTEUR"),
)
INSET_M = 12.0  # of flights from the border
CLEARANCES_M = (0.0, 5.0)
VERTICAL_M = 3.0
NUM_PLAIN, MOST_EDITED, NUM_EXTRACTS = 6, 4, 2
TRIES = 80
CORNERS_M = ((2, 2), (2, SIDE_M - 12), (SIDE_M - 12, 2), (SIDE_M - 12, SIDE_M - 12))
NO_FREE = "no free flight"


class Flight(NamedTuple):
    """A straight flight: what it was aimed at, its ends ``[2, 3]``, and how far it asks to stay beside things."""

    aim: str
    edit: str
    ends_m: np.ndarray
    clearance_m: float


@dataclass(frozen=True, eq=False)
class City:
    """A city: what stands, the style and the format of its file, and flights."""

    number: int
    style: str
    suffix: str
    things: tuple[Thing, ...]
    flights: tuple[Flight, ...]


class Trial(NamedTuple):
    """A flight over a city, what is true of it, and what a check said of it."""

    city: City
    flight: Flight
    truth: Truth
    verdict: Verdict
    num_invented: int

    @property
    def edit(self) -> str:
        """What counts: the thing that the flight meets, else what it was aimed at."""
        names = [self.city.things[number].edit for number in self.truth.hits]
        return self.flight.edit if self.flight.edit in names or not names else names[0]

    @property
    def is_false_clean(self) -> bool:
        return bool(self.truth.hits) and self.verdict.state == "clean"


def offered(style: str) -> list[str]:
    """Return the edits that a style can hold."""
    about = STYLES[style]
    return [name for name, (_, needs) in EDITS.items() if needs and needs <= about.offers]


def city_of(number: int, seed: int = 1, num_flights: int = 1) -> City:
    """Return a city by its number, which with the seed alone decides on all of it."""
    rng = np.random.default_rng([seed, number])
    draw = Draw(rng)
    style = TURNS[number % len(TURNS)]
    about = STYLES[style]

    # Things in slots, and small ones in the corners: of tables they say how far the city is known.
    centres = np.arange(SLOT_M / 2, SIDE_M, SLOT_M)
    slots = list(product(centres, centres))
    rng.shuffle(slots)
    names = [draw.one_of(*offered(style)) for _ in range(rng.integers(1, MOST_EDITED + 1))]
    from_extracts = [name for name in offered(style) if name in FROM_EXTRACTS]
    if from_extracts:
        names += [draw.one_of(*from_extracts) for _ in range(NUM_EXTRACTS)]
    things = []
    for name, place in zip(names + [about.plain] * NUM_PLAIN, slots, strict=False):
        draw.centre_m = tuple(place)
        things.append(plant(draw, name))
    things += [_corner(about.plain, *place) for place in CORNERS_M]
    if style == "faces alone":
        things = [_with_guessed_heights(thing) for thing in things]

    flights = [_flight(draw, things, len(names), draw.one_of(*AIMS)) for _ in range(num_flights)]
    return City(
        number,
        style,
        about.formats[number // len(TURNS) % len(about.formats)],
        tuple(things),
        tuple(flights),
    )


def _corner(name: str, x_m: float, y_m: float) -> Thing:
    """Return a low building in a corner of a city, drawn as plain ones are."""
    outline = shapely.box(x_m, y_m, x_m + 10, y_m + 10)
    made = plant(Draw(np.random.default_rng(0)), name)
    tags = made.records[0].tags
    tags |= {key: type(tags[key])(6) for key in tags if "eight" in key}
    shape = outline
    if "faces" in EDITS[name][1]:
        shape = shapely.MultiPolygon([shapely.force_3d(outline, 0), shapely.force_3d(outline, 6)])
    prisms = (Prism(outline, 6.0),)
    return Thing(name, (Record(shape, tags),), prisms, prisms, is_known=True)


def _with_guessed_heights(thing: Thing) -> Thing:
    """Return a solid whose height stands in no column."""
    hull = tuple(Prism(prism.outline, np.inf) for prism in thing.hull)
    return thing._replace(hull=hull, is_known=False)


def _flight(draw: Draw, things: Sequence[Thing], num_edited: int, aim: str) -> Flight:
    """Return a flight of an aim."""
    clearance_m = draw.one_of(*CLEARANCES_M)
    if aim == "free":
        for _ in range(TRIES):
            ends_m = draw.rng.uniform(INSET_M, SIDE_M - INSET_M, (2, 2))
            ends_m = np.column_stack([ends_m, np.full(2, draw.uniform(10, 150))])
            if truth_of(things, ends_m, clearance_m, VERTICAL_M).is_free:
                return Flight(aim, "free", ends_m, clearance_m)
        return Flight(aim, NO_FREE, ends_m, clearance_m)

    is_edited = draw.rng.random() < 0.85
    thing = things[draw.rng.integers(num_edited if is_edited else num_edited + NUM_PLAIN)]
    prisms = thing.core or tuple(Prism(record.shape.buffer(0.1), 12.0) for record in thing.records)
    prism = prisms[draw.rng.integers(len(prisms))]
    angle = draw.rng.uniform(0, 2 * np.pi)
    along = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-along[1], along[0]])
    through_m = _place_in(draw, prism.outline)
    low_m = max(2.0, prism.floor_m + 0.6)
    z_m = draw.uniform(low_m, max(low_m, min(prism.top_m, 150.0) - 0.6))
    if aim == "beside":
        if across @ (SIDE_M / 2 - through_m) < 0:  # on the side of the city's middle
            across = -across
        reach_m = (shapely.get_coordinates(prism.outline) @ across).max()
        gap_m = draw.one_of(clearance_m / 2, clearance_m + draw.uniform(1.5, 8.0))
        through_m = through_m + across * (reach_m + gap_m - through_m @ across)
    elif aim == "over":
        over_m = draw.one_of(1.0, VERTICAL_M + draw.uniform(1.5, 8.0))
        z_m = (prism.top_m if prism.top_m < 150 else 140.0) + over_m
    elif aim == "inside":
        places_m = (through_m, _place_in(draw, prism.outline))
        ends_m = np.array([[*place_m, z_m] for place_m in places_m])
        return Flight(aim, thing.edit, ends_m, clearance_m)

    # Both ends within the city, so far beyond the thing that the flight passes it whole, and sometimes sloping.
    ends_m = []
    inside = shapely.box(INSET_M, INSET_M, SIDE_M - INSET_M, SIDE_M - INSET_M)
    for sign in (-1, 1):
        away_m = draw.uniform(45, 90)
        line = shapely.LineString([through_m, through_m + sign * away_m * along])
        end_m = np.array(shapely.get_coordinates(line & inside))
        end_m = end_m[-1] if len(end_m) else through_m
        slope_m = draw.one_of(0.0, 0.0, 1.0) * sign * min(z_m - 1.5, 10.0)
        ends_m.append([*end_m, z_m + slope_m])
    return Flight(aim, thing.edit, np.array(ends_m), clearance_m)


def _place_in(draw: Draw, shape: shapely.Geometry) -> np.ndarray:
    """Return a place in a shape."""
    x_min, y_min, x_max, y_max = shape.bounds
    for _ in range(TRIES):
        place = shapely.Point(draw.rng.uniform((x_min, y_min), (x_max, y_max)))
        if shape.contains(place):
            return shapely.get_coordinates(place)[0]
    return shapely.get_coordinates(shape.representative_point())[0]


def write_city(city: City, folder: Path, seed: int = 1) -> tuple[Any, ...]:
    """Write the files of a city and its flights in a folder, and return the arguments of `verdicts_of`."""
    records = [record for thing in city.things for record in thing.records]
    file = folder / f"city_{city.number}{city.suffix}"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # names that a Shapefile cuts
        write(records, file, city.style, np.random.default_rng([seed, city.number, 1]))
    flights = []
    for turn, flight in enumerate(city.flights):
        name = folder / f"flight_{city.number}_{turn}.csv"
        lon, lat = TO_LONLAT.transform(*(flight.ends_m[:, :2] + CORNER_M).T)
        rows = zip(lon, lat, flight.ends_m[:, 2], strict=True)
        lines = [f"{x:.9f},{y:.9f},{z:.2f}" for x, y, z in rows]
        name.write_text("\n".join(["longitude,latitude,altitude_m", *lines]) + "\n")
        options = {"clearance_m": flight.clearance_m, "vertical_clearance_m": VERTICAL_M}
        flights.append((str(name), options | {"home": (lon[0], lat[0])}))
    return str(file), BOUNDS, CRS, flights


def trials_of(city: City, verdicts: Sequence[Verdict]) -> list[Trial]:
    """Return the trials of a city's flights."""
    to_m = pyproj.Transformer.from_crs("EPSG:4326", CRS, always_xy=True)
    trials = []
    for flight, verdict in zip(city.flights, verdicts, strict=True):
        truth = truth_of(city.things, flight.ends_m, flight.clearance_m, VERTICAL_M)
        places = np.array(verdict.places, float).reshape(-1, 2)
        places_m = np.column_stack(to_m.transform(*places.T)) - CORNER_M
        trials.append(Trial(city, flight, truth, verdict, invented(truth, places_m)))
    return trials


def trial(number: int, folder: Path, seed: int = 1, num_flights: int = 1) -> list[Trial]:
    """Return the trials of a city by its number."""
    city = city_of(number, seed, num_flights)
    return trials_of(city, verdicts_of(*write_city(city, folder, seed)))


def unseen(city: City, folder: Path) -> tuple[bool, set[str]]:
    """Return whether OGR reads anything of a city's written file, and the edits of things that it does not read."""
    shapes = seen_by_ogr(folder / f"city_{city.number}{city.suffix}")
    is_seen = confirmed(city.things, shapes)
    gone = {thing.edit for thing, seen in zip(city.things, is_seen, strict=True) if not seen}
    return len(shapes) > 0, gone
