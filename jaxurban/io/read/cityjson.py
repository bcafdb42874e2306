"""CityJSON 1.0 to 2.0, one document or a feature a line (CityJSONSeq)."""

import json
from collections.abc import Iterator
from itertools import chain, zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from jaxurban.io.read.bodies import PIECE, CityObject, body_of

# How deep the faces of a geometry lie.
SHELLS = {
    "MultiSurface": 0,
    "CompositeSurface": 0,
    "Solid": 1,
    "MultiSolid": 2,
    "CompositeSolid": 2,
}


def read_cityjson(path: Path, crs_names: set[str]) -> list[dict[str, Any]]:
    """Return the bodies of a file of CityJSON (see `body_of`).

    Args:
      path, crs_names: as of `read_citygml`.

    Raises:
      ValueError, LookupError, TypeError, AttributeError: a file that cannot be read.
    """
    bodies: list[dict[str, Any]] = []
    transform: dict[str, Any] = {}
    for document in _documents(path):
        transform = document.get("transform", transform)
        crs_names.add(document.get("metadata", {}).get("referenceSystem", ""))
        vertices = np.array(document["vertices"], float).reshape(-1, 3)
        vertices = vertices * transform.get("scale", 1.0) + transform.get("translate", 0.0)
        things = document["CityObjects"]
        objects = {name: _object(thing, vertices) for name, thing in things.items()}
        pieces = set()
        for name, thing in things.items():
            if PIECE.fullmatch(thing["type"]):
                for parent in thing.get("parents", ()):
                    objects[parent].pieces.append(objects[name])
                    pieces.add(name)
        bodies += [body_of(objects[name]) for name in objects if name not in pieces]
    return bodies


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
    for geometry in thing.get("geometry", ()):
        depth = SHELLS.get(geometry["type"])
        if depth is None:
            continue
        meanings = geometry.get("semantics") or {}
        labels = [each["type"] for each in meanings.get("surfaces", ())]
        values = _of_faces(meanings.get("values"), depth)
        for face, value in zip_longest(_of_faces(geometry["boundaries"], depth), values):
            label = None if value is None else labels[value]
            # An index below 0, from the end to numpy, is refused as damage.
            rings = [vertices[np.unravel_index(ring, len(vertices))] for ring in face if ring]
            one.draw(float(geometry.get("lod", 0)), label, rings)
    return one


def _of_faces(nested: Any, depth: int) -> list[Any]:
    """Return what a list of lists, so deep, holds of each face; nothing of None."""
    for _ in range(depth):
        nested = chain.from_iterable(each or () for each in nested or ())
    return list(nested or ())
