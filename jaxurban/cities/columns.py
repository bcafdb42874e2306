"""Columns of outlines: which of them holds the heights, the ground and the levels, and in which unit."""

import json
import re
from collections.abc import Collection, Mapping
from functools import reduce
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyproj

from jaxurban import settings
from jaxurban.cities.estimates import FIGURES, METHODS, SOURCES, with_estimates
from jaxurban.cities.heights import FOOT_M, is_given, parse_length_m, read_column
from jaxurban.cities.kinds import GONE, OF_LIFE
from jaxurban.cities.rules import BY_VALUE, IN_WORDS, KINDS, LIVES
from jaxurban.errors import InputError
from jaxurban.io.issues import ReadIssue
from jaxurban.settings import MAX_HEIGHT_M, Unit

Columns = Mapping[str, np.ndarray]
# Tags of rough figures. A light ends above its focal plane, whose height is that over high water.
ROUGH = (
    "est_height",
    "seamark:light:height",
    "seamark:light:1:height",
    "seamark:landmark:height",
)
CUT_LETTERS = 10  # of a column's name in a Shapefile

# Tags and columns by what they hold: in any case, with ":", "." and "_" the same; names of ten letters are cut, as
# Shapefiles cut them. Where several are there, the first that is filled counts, row by row. Column names in feet or of
# roof shapes ("roof:height" is the height of the roof alone) are left out on purpose. Levels also as France (BD TOPO),
# INSPIRE (bu-base), Germany (ALKIS, simplified), Korea (road name addresses) and Chicago publish them.
COLUMNS = {
    "part": "building_part building_p building_id building_i",
    "height": "height height_m building_height building_h measuredheight measured_height "
    "measuredhe measured_h est_height seamark_light_height seamark_light_1_height seamark_landmark_height",
    "levels": "building_levels building_l levels num_floors storeysaboveground nb_etages nombre_d_etages "
    "numberoffloorsaboveground numberoffl anzahlgs gro_flo_co stories "
    "floors numfloors storeys storeysabo nombre_d_e parking_levels",
    "roof_levels": "roof_levels roof_level",
    "min_height": "min_height building_min_height",
    "min_level": "building_min_level min_level min_floor",
    "levels_below": "building_levels_underground levels_underground num_floors_underground",
    "location": "is_underground location",
    "diameter": "diameter width",
    "rotor": "rotor_diameter rotor_diam",
    "hub": "height_hub",
    "wind": "generator_source generator_method generator_type power_source generator_",
    "crown": "diameter_crown diameter_c crown_diameter",
    "construction": "tower_construction tower_cons",
}
# Columns that are named as what they hold.
OF_OTHERS = (
    "layer",
    "level",
    "lanes",
    "tunnel",
    "indoor",
    "bridge_structure",
    "bridge_movable",
    *IN_WORDS,
    *(key for key in BY_VALUE if key not in COLUMNS),
)
for key in ("building", *OF_OTHERS, *KINDS):
    name = key.replace(":", "_")
    names = name, name[:CUT_LETTERS], *(f"{life}_{name}" for life in LIVES.get(key, ()))
    COLUMNS[key] = " ".join(dict.fromkeys(names))
for reason, lives in GONE.items():
    COLUMNS[reason] = " ".join(f"{life}_{key}" for key, life in product(OF_LIFE, lives))
UNDERGROUND_COLUMN = "is_underground"  # of Overture Maps: true or false
BELOW = dict.fromkeys(("true", "1"), ReadIssue.UNDERGROUND.value)  # as OpenStreetMap writes it
NESTED = ("tags", "other_tags", "all_tags")  # of query-overpass and GDAL: all tags in one text
UNITS_M: dict[Unit, float] = {"m": 1.0, "ft": FOOT_M, "cm": 0.01, "mm": 0.001}
HSTORE = re.compile(r'("(?:[^"\\]|\\.)*")\s*=>\s*("(?:[^"\\]|\\.)*")')  # of what is not NULL


# How publishers name what they hold, plain as in `COLUMNS`: the column of roofs and others by which the table is known,
# and the unit of its heights, which are above the ground but for those of `GROUNDS`.
SCHEMAS: dict[str, Unit] = {
    # New York: github.com/CityOfNewYork/nyc-geo-metadata, Metadata_BuildingFootprints.md.
    "height_roof": "ft",
    "height_roo": "ft",
    "heightroof": "ft",
    # Los Angeles County, LARIAC: its data dictionary as in github.com/osmlab/labuildings, convert.py.
    "height bld_id elev": "ft",
    # Philadelphia, above the lowest ground: pasda.psu.edu, PhiladelphiaBuildings2017.xml, and metadata.phila.gov.
    "max_hgt approx_hgt": "ft",
    "approx_hgt": "ft",
    "max_hgt base_hgt avg_hgt": "ft",
    # San Francisco: data.sfgov.org/d/ynuv-fyni.
    "hgt_maxcm": "cm",
    # Vancouver: opendata.vancouver.ca/explore/dataset/building-footprints-2009.
    "hgt_agl": "m",
    # Toronto, 3D Massing: open.toronto.ca/dataset/3d-massing.
    "max_height avg_height height_msl surf_elev": "m",
    # Melbourne: data.melbourne.vic.gov.au/explore/dataset/2020-building-footprints.
    "structure_extrusion": "m",
    # BD TOPO, up to the gutter: geoservices.ign.fr/documentation/donnees/vecteur/bdtopo.
    "hauteur": "m",
    # 3DBAG, above NAP: docs.3dbag.nl/en/schema/attributes.
    "b3_h_dak_max b3_h_maaiveld": "m",
    # Hong Kong, Lands Department, above Principal Datum: portal.csdi.gov.hk, "Building".
    "topheight baseheight": "m",
    # Ordnance Survey: docs.os.uk, Building Height Attribute, and NGD Buildings.
    "relhmax": "m",
    "height_relativemax_m": "m",
    # swissBUILDINGS3D: swisstopo.admin.ch, its object catalogue.
    "gesamthoehe dach_max": "m",
}
# By their own names, which are no publisher's.
BY_UNIT: dict[str, Unit] = {f"height{mark}{unit}": unit for mark in ("", "_") for unit in UNITS_M}
SCHEMAS |= BY_UNIT
GROUNDS = {"b3_h_dak_max": "b3_h_maaiveld", "topheight": "baseheight"}
# Overture Maps, Microsoft, GlobalBuildingAtlas and USA Structures call theirs ``height``, in metres; Google's outlines
# have none.
KNOWN = set(" ".join([*NESTED, *COLUMNS.values(), *SCHEMAS, *METHODS, SOURCES, *FIGURES]).split())
# Words for height in names of columns, and those by which it is not that of the roof.
HEIGHT = re.compile(
    "^h$|^ht$|_ht$|^roof_?z$|^z_?max$|h_dak|heigh|hgt|hght|hoeh|höhe|hauteur|altura|altezza|hoogte|"
    "höjd|hojd|høyde|hoyde|korkeus|korgus|kõrgus|wysoko|vysk|"
    "výšk|高"
)
NO_ROOF = re.compile(
    "^(roof_height|maxheight|has|is)|min|base|ground|below|eave|std|acc|err|conf|source|src|date|class|type|unit|id$"
)


def _plain(column: object) -> str:
    """Return a column's name as `COLUMNS` has it."""
    return str(column).lower().replace(":", "_").replace(".", "_")


def named_columns(file: settings.Buildings) -> list[str]:
    """Return the columns that the settings name."""
    return list(filter(None, (file.height_column, file.ground_column, file.levels_column)))


def is_of_buildings(column: object, named: Collection[str] = ()) -> bool:
    """Return whether a column or a tag says something of buildings by its name, or is one of those named."""
    name = _plain(column)
    return name in KNOWN or column in named or HEIGHT.search(name) is not None


def tags_of(
    columns: Mapping[Any, np.ndarray], file_name: str = "", height_column: str = ""
) -> dict[str, np.ndarray]:
    """Return columns, or OpenStreetMap's tags, of outlines under the names that `Outlines` knows.

    Of several columns that hold one tag the first that is filled counts, row by row.

    Args:
      columns: ``[N]`` values by name; columns of other names are left out.
      file_name, height_column: of a table: these may say that a model estimated its heights.
    """
    values = {_plain(name): column for name, column in columns.items()}
    if UNDERGROUND_COLUMN in values:
        is_below = pd.Series(values[UNDERGROUND_COLUMN]).astype(str).str.lower()
        values[UNDERGROUND_COLUMN] = is_below.map(BELOW).to_numpy(object)
        values.pop("level", None)  # Overture's orders, as a layer does

    for name in "building_id", "building_i":  # Overture's is that of the building of a part
        ids = pd.Series(values.get(name, ()), dtype=object)
        if UNDERGROUND_COLUMN not in values and ids.notna().all() and ids.is_unique:
            values.pop(name, None)

    for name in values.keys() & map(_plain, ROUGH):
        rough = np.array([f"~{value}" for value in values[name]], object)
        rough[~is_given(values[name])] = None
        values[name] = rough

    tags: dict[str, np.ndarray] = {}
    for tag, names in COLUMNS.items():
        of_tag = [values[name] for name in names.split() if name in values]
        if of_tag:
            tags[tag] = reduce(_filled, of_tag)
    if "max_height" in values:
        tags.pop("min_height", None)  # it is that of the lowest roof
    return with_estimates(tags, values, file_name, height_column)


def tags_of_table(
    columns: Columns, file: settings.Buildings, crs: pyproj.CRS
) -> dict[str, np.ndarray]:
    """Return the columns of a table of outlines under the names that `Outlines` knows, lengths in metres.

    Which columns these are say the settings, else one of `SCHEMAS`, else `COLUMNS`. Columns of tags (`NESTED`) are
    opened.

    Args:
      columns: ``[N]`` values by name.
      file: its path, and what the settings say of its columns.
      crs: of the outlines: numbers beside coordinates in feet are not taken for metres.

    Raises:
      InputError: a column that is named is missing, the unit of heights is not known, or columns that no schema knows
        hold heights where the table has none.
    """
    missing = set(named_columns(file)).difference(columns)
    if missing:
        raise InputError(
            f"{str(file.source)!r} has no column {', '.join(missing)}: its columns are {', '.join(columns) or 'none'}"
        )
    values = _opened({_plain(name): column for name, column in columns.items()})
    schema = next((names for names in SCHEMAS if set(names.split()) <= values.keys()), "")
    if schema and schema not in BY_UNIT:  # whose figures of confidence are those of a survey
        values = {name: column for name, column in values.items() if name not in FIGURES}
    tags = tags_of(values, Path(file.source).name, file.height_column or "")
    if file.levels_column is not None:
        tags["levels"] = columns[file.levels_column]
    roof, ground, unit_m = _columns_of_heights(file, schema)
    if not roof:
        _refuse_unclear_heights(columns, tags, file, crs)
        return tags
    if ground:
        tops, bottoms = (pd.to_numeric(values[name], errors="coerce") for name in (roof, ground))
        tags["height"] = np.asarray(tops - bottoms) * unit_m
    else:
        height = _in_metres(values[roof], unit_m)
        others = height if file.height_column else tags.get("height", height)
        tags["height"] = _filled(height, others)
    if "min_height" in tags:
        tags["min_height"] = _in_metres(tags["min_height"], unit_m)
    return tags


def _columns_of_heights(file: settings.Buildings, schema: str) -> tuple[str, str, float]:
    """Return the plain names of the columns of roofs and of the ground, empty without one, and metres in their unit.

    Args:
      file: whose settings come first.
      schema: of `SCHEMAS`, empty without one.
    """
    if file.height_column or not schema:
        roof, ground = file.height_column or "", file.ground_column or ""
        return _plain(roof), _plain(ground), UNITS_M[file.unit or "m"]
    roof = schema.split()[0]
    return roof, GROUNDS.get(roof, ""), UNITS_M[SCHEMAS[schema]]


def _filled(column: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return a column ``[N]`` that has the values of another where it holds nothing."""
    return np.where(is_given(column), column, other)


def _opened(values: Columns) -> Columns:
    """Return columns by plain name, with the tags of `NESTED` where no column of their own says them."""
    opened = dict(values)
    for name in set(NESTED).intersection(values):
        inner = pd.DataFrame([_inner_tags(str(text)) for text in opened[name]], dtype=object)
        for tag in map(str, inner):
            nested = inner[tag].to_numpy()
            opened[tag] = _filled(opened.get(tag, nested), nested)
    return opened


def _inner_tags(text: str) -> dict[str, Any]:
    """Return what a text of tags, JSON or hstore, says of buildings, by plain name; nothing of another text."""
    try:
        if not text.startswith(("{", "[")):
            text = "{" + ",".join(map(":".join, HSTORE.findall(text))) + "}"
        tags = dict(json.loads(text, strict=False))
    except (ValueError, TypeError, RecursionError):
        return {}
    return {_plain(tag): value for tag, value in tags.items() if is_of_buildings(tag)}


def _in_metres(column: np.ndarray, unit_m: float) -> np.ndarray:
    """Return a column of lengths in metres, ``[N]``; what cannot be read stays as it is.

    Args:
      column: ``[N]`` numbers, or objects.
      unit_m: length of the unit of numbers that name none.
    """
    if unit_m == 1.0:
        return column
    metres = np.array([parse_length_m(str(value), unit_m) for value in column])
    return np.where(np.isnan(metres), column, metres)


def _refuse_unclear_heights(
    columns: Columns, tags: Columns, file: settings.Buildings, crs: pyproj.CRS
) -> None:
    """Refuse a table in which columns of other names hold heights whose unit nobody says.

    Args:
      columns: ``[N]`` values by name.
      tags: of these, as of `tags_of`.
      file: its path, for messages.
      crs: of the outlines.

    Raises:
      InputError: most of such a column are numbers, and one may be a height where the tags have none, or is above 0
        where coordinates are in feet.
    """
    is_in_feet = crs.is_projected and crs.axis_info[0].unit_conversion_factor != 1
    no_heights = np.zeros(1)  # stands for any number of rows
    has_no_height = ~(read_column(tags.get("height", no_heights), parse_length_m) > 0)
    unclear = []
    for name, column in columns.items():
        plain = _plain(name)
        if not HEIGHT.search(plain) or NO_ROOF.search(plain):
            continue
        height = read_column(column, parse_length_m)
        holds_numbers = 2 * np.isfinite(height).sum() > is_given(column).sum()
        is_plausible = (height >= 1) & (height <= MAX_HEIGHT_M)
        is_needed = (height > 0) if is_in_feet else is_plausible & has_no_height
        if holds_numbers and is_needed.any():
            unclear.append(name)
    if unclear:
        first = json.dumps(unclear[0], ensure_ascii=False)
        raise InputError(
            f"{str(file.source)!r} holds heights in {', '.join(map(repr, unclear))}, and neither the file nor a known "
            f"publisher says their unit: set [buildings] height_column = {first} and unit = "
            '"ft" or "m" (or "cm", "mm"), and ground_column if they count from the sea'
        )
