"""What was found wrong: in the files of a city, counted by `ReadIssue`, and in settings, as one sentence."""

from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import StrEnum
from typing import Any, cast, get_args

from pydantic import BaseModel, ValidationError

from jaxurban.errors import check_range, nearest_name

UNKNOWN = ("extra_forbidden", "unexpected_keyword_argument")
NO_LIST = ("tuple_type", "list_type")
NO_TABLE = ("model_type", "dict_type", "dataclass_type")


class ReadIssue(StrEnum):
    """What the readers of a city met, mended or left out; ``run.json`` counts them under these names.

    Attributes:
      OPEN_WAYS: not closed.
      WAYS_WITH_MISSING_NODES: nodes that the file does not hold.
      DEGENERATE_WAYS: closed and complete, but without area: fewer than three corners.
      RELATIONS_INCOMPLETE: members or their nodes missing.
      NON_POLYGONS: points and lines, left out.
      POLYGONS_REPAIRED: invalid, or not assembled by libosmium.
      POLYGONS_DROPPED: empty, or beyond repair.
      OUTSIDE_CRS: where the city's CRS does not reach.
      NOT_BUILDINGS: building=no without building:part, left out.
      UNDERGROUND: location=underground or layer below 0, left out.
      OUTLINES_REPLACED_BY_PARTS: covered by their own parts to 90 % or more.
      PARTS_GIVEN_OUTLINE_HEIGHT: parts without a height of their own.
      PARTS_HANGING: underside above the ground.
      MIN_HEIGHTS_ABOVE_ROOF: underside at or above the roof, set to 0.
      HEIGHTS_UNUSABLE: unreadable, 0, negative or too high.
      LEVELS_UNUSABLE: the same of levels.
      MIN_HEIGHTS_UNUSABLE: the same of the heights of undersides.
      CELLS_BELOW_GROUND: taken for ground.
      CELLS_NEAR_GROUND: of a surface model: taken for ground.
      BLOCKS_WITHOUT_COUNT: kept with 0 people: no row, or a count that cannot be read.
      COUNTS_UNREADABLE: of these, those with a count that cannot be read.
      COUNTS_WITH_NOTE: such as 123 (r45678); the number counts.
      COUNTS_WITHOUT_BLOCK: rows of the table for blocks that the whole blocks file lacks.
      BLOCKS_WITHOUT_POLYGON: left out.
      BLOCKS_WITHOUT_DISTRICT: in district 13.
      INVALID_BLOCK_POLYGONS: repaired.
      INVALID_DISTRICT_POLYGONS: repaired.
      COMMERCIAL_NOT_FOUND: labels on the commercial list that no district has.
    """

    OPEN_WAYS = "open_ways"
    WAYS_WITH_MISSING_NODES = "ways_with_missing_nodes"
    DEGENERATE_WAYS = "degenerate_ways"
    RELATIONS_INCOMPLETE = "relations_incomplete"
    NON_POLYGONS = "non_polygons"
    POLYGONS_REPAIRED = "polygons_repaired"
    POLYGONS_DROPPED = "polygons_dropped"
    OUTSIDE_CRS = "outside_crs"
    NOT_BUILDINGS = "not_buildings"
    UNDERGROUND = "underground"
    OUTLINES_REPLACED_BY_PARTS = "outlines_replaced_by_parts"
    PARTS_GIVEN_OUTLINE_HEIGHT = "parts_given_outline_height"
    PARTS_HANGING = "parts_hanging"
    MIN_HEIGHTS_ABOVE_ROOF = "min_heights_above_roof"
    HEIGHTS_UNUSABLE = "heights_unusable"
    LEVELS_UNUSABLE = "levels_unusable"
    MIN_HEIGHTS_UNUSABLE = "min_heights_unusable"
    CELLS_BELOW_GROUND = "cells_below_ground"
    CELLS_NEAR_GROUND = "cells_near_ground"
    BLOCKS_WITHOUT_COUNT = "blocks_without_count"
    COUNTS_UNREADABLE = "counts_unreadable"
    COUNTS_WITH_NOTE = "counts_with_note"
    COUNTS_WITHOUT_BLOCK = "counts_without_block"
    BLOCKS_WITHOUT_POLYGON = "blocks_without_polygon"
    BLOCKS_WITHOUT_DISTRICT = "blocks_without_district"
    INVALID_BLOCK_POLYGONS = "invalid_block_polygons"
    INVALID_DISTRICT_POLYGONS = "invalid_district_polygons"
    COMMERCIAL_NOT_FOUND = "commercial_not_found"


ReadIssues = dict[ReadIssue, int]


def sentence_of(error: ValidationError, model: type, settings: Any) -> str:
    """Return the first error of a validation as one sentence that names the setting.

    Args:
      error: what pydantic found.
      model: class that was validated, a pydantic model whose fields may be models or dataclasses.
      settings: that were validated.
    """
    first = error.errors()[0]
    *parents, last = first["loc"] or ("",)
    names = []
    for part in parents:
        model = model_in(fields_of(model).get(str(part))) or model
        if _holds(settings, part):  # the rest are pydantic's names for the types of a union
            settings = settings[part]
            names.append(str(part))
    if first["type"] in UNKNOWN or first["type"] == "missing" or _holds(settings, last):
        names.append(str(last))
    where = ".".join(names)
    if first["type"] in UNKNOWN:
        valid = list(fields_of(model))
        hint = nearest_name(str(last), valid) or f"; the valid ones are {', '.join(valid)}"
        return f"unknown {'key' if parents else 'section'} {where!r}{hint}"
    if first["type"] == "missing":
        return f"{where!r} is required and missing"
    if first["type"] in NO_TABLE:
        return f"{where}: must be a table of settings, got {first['input']!r}"
    if first["type"] in NO_LIST:
        return f"{where}: must be a list in brackets, got {first['input']!r}"
    message = first["msg"].removeprefix("Value error, ")
    given = "" if first["type"] == "value_error" else f", got {first['input']!r}"
    prefix = f"{where}: " if where else ""
    return f"{prefix}{message[0].lower() + message[1:]}{given}"


def check_truths(settings: Any, model: type, where: str = "") -> None:
    """Raise ValueError for true or false where a setting is none, and for numbers beyond all measure."""
    known = fields_of(model)
    for name, value in settings.items() if isinstance(settings, Mapping) else ():
        if isinstance(value, bool) and name in known and known[name] is not bool:
            raise ValueError(f"{where}{name} cannot be {str(value).lower()}: give a number, a text or a list")
        check_range(f"{where}{name}", value)
        if inner := model_in(known.get(name)):
            check_truths(value, inner, f"{where}{name}: ")


def fields_of(model: type) -> dict[str, Any]:
    """Return the annotation of each field of a pydantic model or a dataclass, by name."""
    if issubclass(model, BaseModel):
        return {name: field.annotation for name, field in model.model_fields.items()}
    return {field.name: field.type for field in fields(cast(Any, model))}


def _holds(settings: Any, part: str | int) -> bool:
    """Return whether settings have such a key, or such a place in a list."""
    if isinstance(part, int):
        return isinstance(settings, Sequence) and not isinstance(settings, str) and part < len(settings)
    return isinstance(settings, Mapping) and part in settings


def model_in(annotation: Any) -> type | None:
    """Return the model or dataclass that an annotation names, on its own or in a list or union; None if none."""
    if isinstance(annotation, type) and (issubclass(annotation, BaseModel) or is_dataclass(annotation)):
        return annotation
    return next(filter(None, map(model_in, get_args(annotation))), None)
