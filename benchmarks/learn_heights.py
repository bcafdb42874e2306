"""What known heights of several cities say of unknown ones, and how well: ``python -m benchmarks.learn_heights``.

The first table is `jaxurban.io.learned.PACKAGED`, with the guesses where few buildings stand. The second leaves one
city out: by how much the guess of the others misses its known heights, those by the number of levels among them (the
share of true heights below it, the median of guess less true and the mean of its size, in metres), beside its own guess
and a constant. The third does so too: how many of its given heights keep below what the others say, with the interval
of Clopper and Pearson (95 %), and the median of likely less true. The next is of objects whose height OpenStreetMap
does not know and an official table does. The last is of the bound: how many given heights of classes that have one, as
they have where a file knows no height, are above it. Files are those of ``JAXURBAN_DATA`` (else ``../shared/data``) and
of ``formats/given`` beside it.
"""

import os
import warnings
from collections.abc import Mapping
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pandas as pd
import shapely
from scipy.stats import beta

import jaxurban as ju
from benchmarks.common import table
from jaxurban.cities import buildings, structures
from jaxurban.cities.city import lonlat_extent, read_buildings
from jaxurban.cities.kinds import LIMIT_M
from jaxurban.io.city import City
from jaxurban.io.learned import (
    CLASSES,
    IN_NONE,
    LIKELY_SHARE,
    OPEN_SHARE,
    PART_CLASSES,
    PARTS,
    built_shares,
    classes_of,
    learned_from,
    likely_of,
)
from jaxurban.world.footprints import Footprints, HeightOrigin
from jaxurban.world.grid import utm_of

DATA = Path(os.environ.get("JAXURBAN_DATA", "../shared/data"))
GIVEN = DATA.parent / "formats/given"
MURRAY_HILL = "Murray Hill, official"
FILES = {  # of cities of which each known outline is a whole building
    "Lower Manhattan": ju.Buildings(DATA / "osm/lower-manhattan.osm.pbf"),
    MURRAY_HILL: ju.Buildings(
        GIVEN / "footprints/nyc_murrayhill_building_footprints.geojson",
        height_column="height_roof",
        unit="ft",
    ),
    "Boston": ju.Buildings(DATA / "osm/boston-back-bay.osm.pbf"),
    "Helsinki": ju.Buildings(DATA / "osm/helsinki.osm.pbf"),
    "BD TOPO 12174": ju.Buildings(GIVEN / "footprints/BDTOPO_v3_12174_BATIMENT.shp"),
    "Delft": ju.Buildings(GIVEN / "cityjson/delft.json"),
    "Alexandria": ju.Buildings(
        GIVEN / "footprints/opengeos_buildings.geojson", height_column="HEIGHT", unit="m"
    ),
    "Zurich, solids of parts": ju.Buildings(GIVEN / "cityjson/zurich_subset_lod2.json"),
}
NOT_LEARNED = ("Zurich, solids of parts",)  # whose outlines are parts of roofs
OSM = ju.Buildings(DATA / "osm/murray-hill.osm.pbf")
LEAST_KNOWN = 20  # of a class of a city that counts
CONSTANT_M = 10.0  # of a guess that knows no classes
IN_OPEN = ", where few stand"
SAME_SHARE = 0.5  # of an outline that another one of the same building covers


def _read(file: ju.Buildings) -> City:
    """Return the buildings of a file, in the UTM zone of its middle."""
    return read_buildings(file, utm_of(lonlat_extent(file.source, file.crs)))


def known_of(file: ju.Buildings) -> pd.DataFrame:
    """Return the class of each whole outline of a file, its given height (NaN without), and that with its levels.

    The place is the class too, of whole buildings with whether few stand around.
    """
    seen: list[pd.DataFrame] = []
    shares: list[np.ndarray] = []

    def spy(classes: np.ndarray, given_m: np.ndarray, counted_m: np.ndarray) -> Mapping:
        """Note what is learned from."""
        seen.append(pd.DataFrame({"class": classes, "height_m": given_m, "counted_m": counted_m}))
        return learned_from(classes, given_m, counted_m)

    def share_spy(polygons: np.ndarray) -> np.ndarray:
        """Note how built-up the places are."""
        shares.append(built_shares(polygons))
        return shares[-1]

    with (
        patch.object(buildings, "learned_from", spy),
        patch.object(structures, "learned_from", spy),
        patch.object(buildings, "built_shares", share_spy),
    ):
        _read(file)
    (own, others), (share,) = seen, shares
    is_open = (share < OPEN_SHARE) & own["class"].isin(CLASSES)
    own["place"] = own["class"] + np.where(is_open, IN_OPEN, "")
    rows = pd.concat([own, others.assign(place=others["class"])])
    is_part = rows["class"].isin(PART_CLASSES)
    in_none = PARTS + IN_NONE
    parts = rows[is_part].assign(
        **{"class": in_none, "place": in_none}
    )  # which may be of any building
    rows = pd.concat([rows[rows["class"] != in_none], parts])
    return rows[rows["counted_m"] > 0].replace({"height_m": {0.0: np.nan}})


def likely_by_class(known: pd.DataFrame) -> pd.Series:
    """Return the highest of what the known heights of several cities say, by class, of parts also of their wholes."""
    by_city = known.dropna().groupby(["class", "city"])["height_m"]
    of_cities = by_city.agg(lambda values: likely_of(values.to_numpy()))
    likely = of_cities[by_city.size() >= LEAST_KNOWN].groupby("class").max()
    for part, whole in zip(PART_CLASSES, (*CLASSES, CLASSES[-1]), strict=True):
        likely[part] = max(likely.get(part, 0.0), likely.get(whole, 0.0))
    return likely


def guess_by_class(known: pd.DataFrame) -> pd.Series:
    """Return the median of the medians of several cities, by place; of parts of which no city knows any of wholes."""
    by_city = known.groupby(["place", "city"])["counted_m"]
    guesses = by_city.median()[by_city.size() >= LEAST_KNOWN].groupby("place").median()
    wholes = guesses.reindex(CLASSES).set_axis(PARTS + CLASSES)
    return guesses.combine_first(wholes.dropna())


def missed(true_m: np.ndarray, guess_m: float) -> dict[str, object]:
    """Return how a guess misses known heights: as of the others, as their own median, and as a constant."""
    row: dict[str, object] = {"n": len(true_m)}
    guesses = {"others": guess_m, "own": float(np.median(true_m)), "constant": CONSTANT_M}
    for name, of_m in guesses.items():
        row[f"{name}, m"] = f"{of_m:.1f}"
        row[f"{name}, true below"] = f"{np.mean(true_m < of_m):.0%}"
        row[f"{name} less true"] = f"{np.median(of_m - true_m):.1f}"
        row[f"{name}, mean miss"] = f"{abs(of_m - true_m).mean():.1f}"
    return row


def _by_city(known: pd.DataFrame, learned: pd.DataFrame) -> list[dict[str, object]]:
    """Return how the others' guesses miss each city's buildings: by class and place, and by class alone."""
    rows = []
    for city, own in known.groupby("city"):
        others = learned[learned["city"] != city]
        row: dict[str, object] = {"city left out": city, "n": len(own)}
        for column, guess in (
            ("place", guess_by_class(others)),
            ("class", guess_by_class(others.assign(place=others["class"]))),
        ):
            guess_m = own[column].map(guess)
            row[f"by {column}, mean miss"] = f"{(guess_m - own['counted_m']).abs().mean():.1f}"
            row[f"by {column}, true below"] = f"{(own['counted_m'] < guess_m).mean():.0%}"
        rows.append(row)
    return rows


def covered(true_m: np.ndarray, likely_m: float) -> dict[str, object]:
    """Return how many heights keep below, with the interval of Clopper and Pearson, and the median of the rest."""
    num, below = len(true_m), int((true_m <= likely_m).sum())
    low = beta.ppf(0.025, below, num - below + 1) if below else 0.0
    high = beta.ppf(0.975, below + 1, num - below) if below < num else 1.0
    return {
        "n": num,
        "likely_m": round(likely_m, 1),
        "covered": f"{below / num:.1%}",
        "interval": f"{low:.1%} to {high:.1%}",
        "passed": "yes" if high >= LIKELY_SHARE else "no",
        "median of likely less true": f"{np.median(likely_m - true_m):.1f}",
    }


def unknown_in_osm(packaged: Mapping[str, float]) -> list[dict[str, object]]:
    """Return how the likely heights of what OpenStreetMap does not know hold against the official table."""
    official, osm = _read(FILES[MURRAY_HILL]).buildings, _read(OSM).buildings
    assert official is not None
    assert osm is not None
    unknown = osm.take(osm.origin == HeightOrigin.DEFAULT)
    rows = []
    for which, likely_m in (
        ("learned of the extract", unknown.likely_upper_m),
        ("packaged", np.array([packaged[each] for each in _classes(unknown)])),
    ):
        true_m = _true_heights(unknown, official)
        is_known = true_m > 0
        spare_m = (likely_m - true_m)[is_known]
        rows.append({"likely": which, **covered(-spare_m, 0.0)} | {"likely_m": ""})
    return rows


def _classes(footprints: Footprints) -> np.ndarray:
    """Return the class of each outline."""
    return classes_of(shapely.area(footprints.polygons))


def _true_heights(unknown: Footprints, official: Footprints) -> np.ndarray:
    """Return the official height of each outline, 0 where no official one covers it."""
    true_m = np.zeros(len(unknown))
    own, other = shapely.STRtree(official.polygons).query(unknown.polygons, "intersects")
    shared = shapely.area(shapely.intersection(unknown.polygons[own], official.polygons[other]))
    is_same = shared >= SAME_SHARE * shapely.area(unknown.polygons[own])
    np.maximum.at(true_m, own[is_same], official.height_m[other[is_same]])
    return true_m


def _print(rows: list[dict[str, object]]) -> None:
    """Print rows of equal columns."""
    print(table(list(rows[0]), [[str(value) for value in row.values()] for row in rows]), "\n")


def main() -> None:
    """Print the tables."""
    warnings.simplefilter("ignore")
    known = pd.concat([known_of(file).assign(city=name) for name, file in FILES.items()])
    of_osm = known_of(OSM).assign(city="Murray Hill, OpenStreetMap")
    known = pd.concat([known, of_osm[of_osm["class"].isin(PART_CLASSES)]])
    learned = known[~known["city"].isin(NOT_LEARNED)]
    packaged = likely_by_class(learned)
    guesses = guess_by_class(learned)
    trees = learned[learned["class"] == "tree"]["height_m"].dropna()
    packaged["tree"], guesses["tree"] = likely_of(trees.to_numpy()), trees.median()
    _print(
        [
            {
                "class": name,
                "guess_m": round(guesses[name], 1),
                "where few stand": guesses.round(1).get(name + IN_OPEN, ""),
                "likely_m": round(m, 1),
            }
            for name, m in packaged.items()
        ]
    )
    rows = []
    for (city, name), own in known.groupby(["city", "place"]):
        others = guess_by_class(learned[learned["city"] != city])
        if len(own) >= LEAST_KNOWN and name in others:
            row = {"city left out": city, "place": name}
            rows.append(row | missed(own["counted_m"].to_numpy(), float(others[name])))
    _print(rows)
    _print(_by_city(known[known["class"].isin(CLASSES)], learned))
    rows = []
    for (city, name), own in known.dropna().groupby(["city", "class"]):
        others = likely_by_class(learned[learned["city"] != city])
        if name in (*CLASSES, *PART_CLASSES) and len(own) >= LEAST_KNOWN and name in others:
            row = {"city left out": city, "class": name}
            rows.append(row | covered(own["height_m"].to_numpy(), float(others[name])))
    _print(rows)
    _print(unknown_in_osm(packaged))
    bounded = learned.dropna()
    bounded = bounded[bounded["class"].isin(packaged.index[packaged <= LIMIT_M])]
    bounded = bounded[bounded["class"].isin((*CLASSES, *PART_CLASSES))]
    above = bounded["height_m"].gt(LIMIT_M).groupby([bounded["city"], bounded["class"]])
    _print(
        [
            {"city": city, "class": of, "n": len(each), "above the bound": each.sum()}
            for (city, of), each in above
        ]
    )


if __name__ == "__main__":
    main()
