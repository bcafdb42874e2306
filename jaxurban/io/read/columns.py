"""Columns of outlines: which of them holds the heights, the ground and the levels, and in which unit."""

import json
import re
from collections.abc import Collection, Mapping
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pyproj

from jaxurban import settings
from jaxurban.errors import InputError
from jaxurban.io.read.heights import FOOT_M, is_given, parse_length_m, read_column
from jaxurban.io.read.issues import ReadIssue
from jaxurban.settings import MAX_HEIGHT_M

Columns = Mapping[str, np.ndarray]

# Tags and columns by what they hold: in any case, with ":", "." and "_" the same; names of ten letters are cut, as
# Shapefiles cut them. Where several are there, the first that is filled counts, row by row. Column names in feet or of
# roof shapes ("roof:height" is the height of the roof alone) are left out on purpose. Levels also as France (BD TOPO),
# INSPIRE (bu-base), Germany (ALKIS, simplified), Korea (road name addresses) and Chicago publish them.
COLUMNS = {
    "building": (
        "building",
        *("abandoned_building", "disused_building", "ruins_building", "construction_building"),
    ),
    "part": ("building_part", "building_p"),
    "razed": (
        *("demolished_building", "razed_building", "removed_building", "destroyed_building"),
        "was_building",
    ),
    "planned": ("proposed_building", "planned_building"),
    "height": (
        "height",
        "height_m",
        "building_height",
        "measuredheight",
        "measured_height",
        "measuredhe",
    ),
    "levels": (
        *("building_levels", "building_l", "levels", "num_floors", "storeysaboveground"),
        *("nb_etages", "nombre_d_etages", "numberoffloorsaboveground", "numberoffl"),
        *("anzahlgs", "gro_flo_co", "stories"),
    ),
    "roof_levels": ("roof_levels", "roof_level"),
    "min_height": ("min_height", "building_min_height"),
    "min_level": ("building_min_level", "min_level", "min_floor"),
    "location": ("location",),
    "layer": ("layer",),
    "level": ("level",),
    "levels_below": ("building_levels_underground", "levels_underground", "num_floors_underground"),
    "parking": ("parking",),
    "man_made": ("man_made",),
    "power": ("power",),
    "aerialway": ("aerialway",),
    "barrier": ("barrier",),
    "natural": ("natural",),
    "diameter": ("diameter", "width"),
    "rotor": ("rotor_diameter",),
    "hub": ("height_hub",),
}
UNDERGROUND_COLUMN = "is_underground"  # of Overture Maps: true or false
OF_OVERTURE = "building_id"  # beside it: a part names its building
NESTED = ("tags", "other_tags", "all_tags")  # of query-overpass and GDAL: all tags in one text
UNITS_M = {"m": 1.0, "ft": FOOT_M, "cm": 0.01}


class Schema(NamedTuple):
    """How a publisher's table names what it holds; all but the unit are names of columns, plain as in `COLUMNS`.

    Attributes:
      unit: of its heights, one of `UNITS_M`.
      height: of roofs above the ground, or, if there is a ``ground``, above where that counts from.
      ground: of the elevation of the ground.
      beside: of other columns by which the table is known, with blanks between.
    """

    unit: str
    height: str
    ground: str = ""
    beside: str = ""


SCHEMAS = (
    # New York, above the ground: github.com/CityOfNewYork/nyc-geo-metadata, Metadata_BuildingFootprints.md.
    Schema("ft", "height_roof"),
    Schema("ft", "height_roo"),
    Schema("ft", "heightroof"),
    # Los Angeles County, LARIAC: its data dictionary as in github.com/osmlab/labuildings, convert.py.
    Schema("ft", "height", beside="bld_id elev"),
    # Philadelphia, above the lowest ground: pasda.psu.edu, PhiladelphiaBuildings2017.xml, and metadata.phila.gov.
    Schema("ft", "max_hgt", beside="approx_hgt"),
    Schema("ft", "approx_hgt"),
    Schema("ft", "max_hgt", beside="base_hgt avg_hgt"),
    # San Francisco, above the ground: data.sfgov.org/d/ynuv-fyni.
    Schema("cm", "hgt_maxcm"),
    # Vancouver: opendata.vancouver.ca/explore/dataset/building-footprints-2009.
    Schema("m", "hgt_agl"),
    # Toronto, 3D Massing: open.toronto.ca/dataset/3d-massing.
    Schema("m", "max_height", beside="avg_height height_msl surf_elev"),
    # Melbourne: data.melbourne.vic.gov.au/explore/dataset/2020-building-footprints.
    Schema("m", "structure_extrusion"),
    # BD TOPO, up to the gutter: geoservices.ign.fr/documentation/donnees/vecteur/bdtopo.
    Schema("m", "hauteur"),
    # 3DBAG, above NAP: docs.3dbag.nl/en/schema/attributes.
    Schema("m", "b3_h_dak_max", ground="b3_h_maaiveld"),
    # Hong Kong, Lands Department, above Principal Datum: portal.csdi.gov.hk, "Building".
    Schema("m", "topheight", ground="baseheight"),
    # Ordnance Survey: docs.os.uk, Building Height Attribute, and NGD Buildings.
    Schema("m", "relhmax"),
    Schema("m", "height_relativemax_m"),
    # swissBUILDINGS3D: swisstopo.admin.ch, its object catalogue.
    Schema("m", "gesamthoehe", beside="dach_max"),
    Schema("ft", "height_ft"),  # by its own name
)
NONE = Schema("m", "")
# Overture Maps, Microsoft, GlobalBuildingAtlas and USA Structures call theirs ``height``, in metres; Google's outlines
# have none.
KNOWN = {UNDERGROUND_COLUMN, OF_OVERTURE, *NESTED}.union(
    *COLUMNS.values(),
    *(" ".join(schema[1:]).split() for schema in SCHEMAS),
)
# Words for height in names of columns, and those by which it is not that of the roof.
HEIGHT = re.compile(
    "heigh|hgt|hght|hoehe|höhe|hauteur|altura|altezza|hoogte|höjd|hojd|høyde|hoyde|korkeus|korgus|kõrgus|wysoko|vysk|"
    "výšk|高"
)
NO_ROOF = re.compile(
    "^(roof_height|maxheight|has|is)|min|base|ground|below|eave|std|acc|err|conf|source|src|date|class|type|unit|id$"
)
LEAST_CHANGE = 0.1  # of a height: what changes it by less need not be asked


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


def tags_of(columns: Mapping[Any, np.ndarray]) -> dict[str, np.ndarray]:
    """Return columns, or OpenStreetMap's tags, of outlines under the names that `Outlines` knows.

    Of several columns that hold one tag the first that is filled counts, row by row.

    Args:
      columns: ``[N]`` values by name; columns of other names are left out.
    """
    values = {_plain(name): column for name, column in columns.items()}
    tags: dict[str, np.ndarray] = {}
    for tag, names in COLUMNS.items():
        for name in names:
            if tag in tags and name in values:
                tags[tag] = np.where(is_given(tags[tag]), tags[tag], values[name])
            elif name in values:
                tags[tag] = values[name]
    if "max_height" in values:
        tags.pop("min_height", None)  # it is that of the lowest roof

    # A column of true and false becomes a tag as OpenStreetMap writes it.
    if UNDERGROUND_COLUMN in values:
        texts = [str(value).lower() for value in values[UNDERGROUND_COLUMN]]
        others = tags.get("location", np.array(None)).astype(object)
        is_below = np.isin(texts, ("true", "1"))
        tags["location"] = np.where(is_below, ReadIssue.UNDERGROUND, others)
        tags.pop("level", None)  # Overture's orders, as a layer does
        if OF_OVERTURE in values:
            tags["part"] = values[OF_OVERTURE]
    return tags


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
    tags = tags_of(values)
    if file.levels_column is not None:
        tags["levels"] = columns[file.levels_column]

    # Lengths: as the settings say, as a publisher does, or in metres.
    if file.height_column is not None:
        schema = Schema(
            str(file.unit), _plain(file.height_column), _plain(file.ground_column or "")
        )
    else:
        schemas = (schema for schema in SCHEMAS if {*" ".join(schema[1:]).split()} <= {*values})
        schema = next(schemas, NONE)
    if schema is NONE:
        _check_metric(columns, tags, file, crs)
    else:
        tags["height"] = values[schema.height]
    if schema.ground:
        roof, ground = (
            pd.to_numeric(pd.Series(values[name]), errors="coerce")
            for name in (schema.height, schema.ground)
        )
        tags["height"] = (roof - ground).to_numpy()
    for tag in {"height", "min_height"}.intersection(tags):
        tags[tag] = _in_metres(tags[tag], UNITS_M[schema.unit])
    return tags


def _opened(values: Columns) -> Columns:
    """Return columns by plain name, and beside them those tags of `NESTED` that have no column of their own."""
    for name in set(NESTED).intersection(values):
        inner = pd.DataFrame([_inner_tags(str(text)) for text in values[name]], dtype=object)
        values = {str(tag): inner[tag].to_numpy() for tag in inner} | dict(values)
    return values


def _inner_tags(text: str) -> dict[str, Any]:
    """Return what a text of tags, JSON or hstore, says of buildings, by plain name; nothing of another text."""
    if not text.startswith(("{", "[")):
        text = "{" + text.replace('"=>"', '":"') + "}"
    try:
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


def _check_metric(
    columns: Columns, tags: Columns, file: settings.Buildings, crs: pyproj.CRS
) -> None:
    """Check that heights may be taken for metres, and that no column of another name holds heights that are lacking.

    Raises:
      InputError: heights beside coordinates in feet; or other columns, most of whose values may be heights, would
        change a default height by more than `LEAST_CHANGE`.
    """
    is_in_feet = crs.is_projected and crs.axis_info[0].unit_conversion_factor != 1
    known_m = read_column(tags.get("height", np.zeros(1)), parse_length_m)
    unclear = []
    for name, column in columns.items():
        plain = _plain(name)
        if not HEIGHT.search(plain) or NO_ROOF.search(plain):
            continue
        height = read_column(column, parse_length_m)
        is_height = (height >= 1) & (height <= MAX_HEIGHT_M)
        changes = ~(known_m > 0) & (abs(height / file.default_height_m - 1) > LEAST_CHANGE)
        holds_numbers = 2 * np.isfinite(height).sum() > is_given(column).sum()
        if holds_numbers and ((height > 0) & is_in_feet | is_height & changes).any():
            unclear.append(name)
    if unclear:
        raise InputError(
            f"{str(file.source)!r} holds heights in {', '.join(map(repr, unclear))}, and neither the file nor a known "
            f"publisher says their unit: set [buildings] height_column = {json.dumps(unclear[0])} and unit = "
            '"ft" or "m", and ground_column if they count from the sea'
        )
