"""CityJSON 1.0 to 2.0, one document or a feature a line (CityJSONSeq)."""

import json
from collections.abc import Iterator
from itertools import chain, zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from jaxurban.cities.bodies import NO_LEVEL, PIECE, UNREAD, CityObject, Face, bodies_of
from jaxurban.cities.estimates import METHODS
from jaxurban.errors import InputError

# How deep the faces or lines of a geometry lie; points, and what a template draws, have no extent of their own.
SHELLS = {
    "MultiPoint": None,
    "GeometryInstance": None,
    "MultiLineString": 0,
    "MultiSurface": 0,
    "CompositeSurface": 0,
    "Solid": 1,
    "MultiSolid": 2,
    "CompositeSolid": 2,
}


def read_cityjson(path: Path, crs_names: set[str]) -> Iterator[dict[str, Any]]:
    """Yield the bodies of a file of CityJSON (see `bodies_of`).

    Args:
      path, crs_names: as of `read_citygml`.

    Raises:
      InputError: features come before the header; the message lacks the file's name.
      ValueError, LookupError, TypeError, AttributeError: a file that cannot be read.
    """
    transform: Any = None
    for document in _documents(path):
        if document.get("type") != "CityJSONFeature":
            transform = {}
        transform = document.get("transform", transform)
        if transform is None:
            raise InputError(
                "has features before the line of CityJSON that says where they lie: begin with that line"
            )
        metadata = document.get("metadata") or {}
        crs_names.add(str(metadata.get("referenceSystem") or ""))
        corners = document["vertices"]
        vertices = np.array(corners, float).reshape(len(corners), 3)
        vertices = vertices * transform.get("scale", 1.0) + transform.get("translate", 0.0)
        things = document["CityObjects"]
        objects = {name: _object(thing, vertices) for name, thing in things.items()}
        yield from bodies_of(_wholes_first(things, objects))


def _wholes_first(
    things: dict[str, dict[str, Any]], objects: dict[str, CityObject]
) -> list[CityObject]:
    """Return objects, which get their pieces; last come pieces, as those whose parents are each other's stand alone.

    Args:
      things: the objects by name, as the file has them.
      objects: the same, without their pieces.
    """
    wholes, pieces = [], []
    for name, thing in things.items():
        is_piece = PIECE.fullmatch(thing["type"])
        parents = [each for each in thing.get("parents") or () if is_piece and each in things]
        if parents:
            objects[parents[0]].pieces.append(objects[name])
            pieces.append(objects[name])
        else:
            wholes.append(objects[name])
    return wholes + pieces


def _documents(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the documents of a file: the file, or one a line."""
    with path.open(encoding="utf-8-sig") as file:
        try:
            yield json.load(file)
        except json.JSONDecodeError:
            file.seek(0)
            yield from map(json.loads, filter(str.strip, file))


def _object(thing: dict[str, Any], vertices: np.ndarray) -> CityObject:
    """Return an object with its faces; what a template draws has none.

    Args:
      thing: as the file has it.
      vertices: ``[V, 3]`` x, y and z.
    """
    facts = thing.get("attributes") or {}
    one = CityObject(thing["type"], facts.get("measuredHeight"), facts.get("storeysAboveGround"))
    for name in facts:
        if name.lower() in METHODS:
            one.origin = facts[name]
    for geometry in thing.get("geometry") or ():
        _draw(one, geometry, vertices)
    return one


def _draw(one: CityObject, geometry: dict[str, Any], vertices: np.ndarray) -> None:
    """Add the faces of a geometry to an object.

    Args:
      one: the object.
      geometry: as the file has it; points and what a template draws add nothing.
      vertices: ``[V, 3]`` x, y and z.

    Raises:
      ValueError: a level of detail that is no number, and as of `_corners`.
    """
    lod = float(geometry.get("lod", NO_LEVEL))
    if not np.isfinite(lod):
        raise ValueError(lod)
    depth = SHELLS[geometry["type"]]
    if depth is None:
        return
    meanings = geometry.get("semantics") or {}
    labels = {None: None} | dict(enumerate(each["type"] for each in meanings.get("surfaces", ())))
    numbers = _of_faces(meanings.get("values"), depth)
    for face, number in zip_longest(_of_faces(geometry["boundaries"], depth), numbers):
        if geometry["type"] == "MultiLineString":
            one.faces.append(Face(lod, UNREAD, [_corners(face, vertices)]))
        else:
            one.draw(lod, labels[number], [_corners(ring, vertices) for ring in face if ring])


def _corners(indices: list[Any], vertices: np.ndarray) -> np.ndarray:
    """Return the vertices of indices, ``[V, 3]``; one below 0 is from the end to numpy, and true is 1.

    Raises:
      ValueError, IndexError: an index of no vertex.
    """
    if {*map(type, indices)} != {int} or min(indices) < 0:
        raise ValueError("a face has a corner that is no vertex")
    return vertices[indices]


def _of_faces(nested: Any, depth: int) -> list[Any]:
    """Return what a list of lists, so deep, holds of each face; nothing of None."""
    for _ in range(depth):
        nested = chain.from_iterable(each or () for each in nested or ())
    return list(nested or ())
