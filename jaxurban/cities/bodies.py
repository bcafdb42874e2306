"""Bodies of city models: of the faces of a building and its parts one MultiPolygon, above its own ground."""

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pyproj
import shapely

from jaxurban.cities.estimates import with_estimates
from jaxurban.cities.heights import parse_height_m
from jaxurban.cities.outlines import Outlines
from jaxurban.cities.solids import DIFFER_M
from jaxurban.errors import InputError
from jaxurban.io.issues import ReadIssue, num_of
from jaxurban.world.grid import WGS84, area_of, check_on_earth, known_crs, transformer

PIECE = re.compile(r"(Building|Bridge|Tunnel)[A-Z]\w+")  # of another object, whatever it is
UNREAD = "unread"  # in place of the label of a shape that is no face
ROOFS = (None, UNREAD, "RoofSurface", "OuterFloorSurface")  # above which is air, or may be
GROUPS = ("CityModel", "CityObjectGroup")  # of what stands, without a shape as a rule
# Kinds that are no obstacles.
GROUND = (
    "Road Railway Track Square TransportSquare TransportationComplex Waterway WaterBody LandUse "
    "ReliefFeature TINRelief"
)
TAGS: dict[str, dict[str, Any]] = {  # of OpenStreetMap, by kind
    **{kind: {"height": 0.0, "building": None} for kind in GROUND.split()},
    "Building": {"building": "yes"},
    "Bridge": {"man_made": "bridge"},
    "Tunnel": {"man_made": "tunnel"},
    "SolitaryVegetationObject": {"natural": "tree"},
}
NO_LEVEL = -1.0  # of detail
MARGIN_DEG = 1.0  # around the area of use of a CRS
LOST_M = 1e9  # in place of what is no number: no reader takes it for a height
CRS_NAMES = {  # of German and Swiss surveys, and those with a code of EPSG
    r"^.*ETRS89_UTM(3[1-3]).*": r"EPSG:258\1",
    r"^.*DE_DHDN_3GK2.*": "EPSG:31466",
    r"^.*DE_DHDN_3GK3.*": "EPSG:31467",
    r"^.*DE_DHDN_3GK4.*": "EPSG:31468",
    r"^.*DE_DHDN_3GK5.*": "EPSG:31469",
    r"^CH1903(_LV03)?$": "EPSG:21781",
    r"^CH1903\+(_LV95)?$": "EPSG:2056",
    r"^.*?EPSG\W{1,9}(?:[\d.]*[:/])?(\d{4,}).*": r"EPSG:\1",
}


class Face(NamedTuple):
    """A face of an object.

    Attributes:
      lod: level of detail.
      label: what the file says that it is, such as ``"RoofSurface"``; None where it says nothing.
      rings: its border, then its holes, ``[V, 3]`` x, y and z each; of `UNREAD` its vertices; none of a link, whose
        label is the id of what it draws.
    """

    lod: float
    label: str | None
    rings: list[np.ndarray]


@dataclass(eq=False)
class CityObject:
    """An object of a city model, or a piece of one.

    Attributes:
      kind: as both formats call it, such as ``"BuildingPart"``.
      height, levels: as the file has them: of the roof above the ground, and of storeys.
      origin: what the file says of how the height is known, by an attribute of `METHODS`.
      faces: in all levels of detail; those of `NO_LEVEL` always count.
      pieces: its parts, installations and what else belongs to it or stands within it.
    """

    kind: str
    height: Any = None
    levels: Any = None
    origin: Any = None
    faces: list[Face] = field(default_factory=list)
    pieces: list["CityObject"] = field(default_factory=list)

    def draw(self, lod: float, label: str | None, rings: Iterable[np.ndarray]) -> None:
        """Add a face.

        Args:
          lod, label: as of `Face`.
          rings: as of `Face`; of fewer than three vertices there is no ring.
        """
        rings = [ring for ring in rings if len(ring) > 2]
        if rings:
            self.faces.append(Face(lod, label, rings))


def bodies_of(objects: Iterable[CityObject]) -> Iterator[dict[str, Any]]:
    """Yield the bodies of objects, each with its pieces (see `_bodies`).

    Args:
      objects: wholes before their pieces, as what came with a whole is not drawn again.
    """
    seen = set()
    for whole in objects:
        if whole in seen:
            continue
        members = [whole]
        for member in members:  # which grow by the pieces of each
            seen.add(member)
            members += [piece for piece in member.pieces if piece not in seen]
        yield from _bodies(members)


def _bodies(members: list[CityObject]) -> Iterator[dict[str, Any]]:
    """Yield the body of an object's faces, if it should have any, and that of what is not read of it.

    Args:
      members: the object, then its pieces, each after what it belongs to.

    Yields:
      Of each ``polygon``, all faces, roofs first, as a MultiPolygon with heights, empty without a face; ``num_roofs``,
      how many are roofs by their labels or have none, 0 where all are; and tags as of `Outlines`. The height of kinds
      that `TAGS` lacks is how far they rise. An object of which something is not read is a line through its vertices
      as well, which is a building of unknown extent.
    """
    kind = PIECE.sub(r"\1", members[0].kind)
    tags = TAGS.get(kind, {})
    best, is_coarse = _best_faces(members)
    faces = [face for face in best if face.label != UNREAD]
    faces.sort(key=lambda face: face.label not in ROOFS)
    num_roofs = sum(face.label in ROOFS for face in faces)
    body = {
        "polygon": _multipolygon(faces),
        "num_roofs": num_roofs if num_roofs < len(faces) else 0,
        "building": None,
        "height": max(
            (one.height for one in members if one.height),
            key=lambda height: parse_height_m(str(height)),
            default=None,
        ),
        "levels": members[0].levels,
        "height_source": next((one.origin for one in members if one.origin), None),
        "is_coarse": is_coarse,
    }
    if len(faces) < len(best):
        corners = _vertices(best)
        line = shapely.LineString([*corners, corners[0]])
        yield body | {"polygon": line, "building": "yes"} | tags
    if not tags:
        has_level = any(face.lod > 0 for face in faces)  # in plan alone nothing has a height
        body["height"] = np.ptp(_vertices(faces)[:, 2]) if has_level else LOST_M
    if faces or not (best or kind in GROUPS):
        yield body | tags


def _multipolygon(faces: list[Face]) -> shapely.MultiPolygon:
    """Return faces as one MultiPolygon, made at once; an empty one of no face."""
    if not faces:
        return shapely.MultiPolygon()
    rings = [ring for face in faces for ring in face.rings]
    borders = shapely.linearrings(_vertices(faces), indices=_numbered(map(len, rings)))  # closed
    numbers = _numbered(len(face.rings) for face in faces)
    return shapely.multipolygons(shapely.polygons(borders, indices=numbers))


def _vertices(faces: list[Face]) -> np.ndarray:
    """Return the vertices of faces ``[V, 3]``, `LOST_M` for what is no number: the place or the height is lost."""
    vertices = np.concatenate([ring for face in faces for ring in face.rings])
    return np.where(np.isfinite(vertices), vertices, LOST_M)


def _numbered(sizes: Iterable[int]) -> np.ndarray:
    """Return the number of the group for each member of groups, by their sizes."""
    counts = [*sizes]
    return np.repeat(np.arange(len(counts)), counts)


def _best_faces(members: list[CityObject]) -> tuple[list[Face], bool]:
    """Return the faces of an object and its pieces that count, each once, and whether coarser solids are among them.

    Of each member those of its highest level of detail that has roofs or no labels count; of a whole none do where a
    part has a higher level. A solid of a lower level counts in their place if it rises more than `DIFFER_M` higher, and
    one of a whole then counts beside its parts.

    Args:
      members: as of `_bodies`.
    """
    faces: dict[int, Face] = {}  # by what draws them
    part_lod = NO_LEVEL
    is_coarse = False
    for member in reversed(members):
        ranks = {(face.label in ROOFS, face.lod) for face in member.faces}
        _, lod = max(ranks, default=(True, NO_LEVEL))
        if member.kind.endswith("Part"):
            part_lod = max(part_lod, lod)
        if member is members[0] and lod < part_lod:
            lod = NO_LEVEL
        solids = {
            level: [face for face in member.faces if face.lod == level]
            for _, level in ranks
            if level >= 1
        }
        for coarse, solid in solids.items():
            if coarse == lod or (True, coarse) not in ranks:
                continue
            if _rise_m(solid) > _rise_m(solids.get(lod, faces.values())) + DIFFER_M:
                lod = coarse
                is_coarse = True
        for face in reversed(member.faces):
            if face.lod in (lod, NO_LEVEL):
                faces[id(face.rings)] = face
    return [*reversed(faces.values())], is_coarse


def _rise_m(faces: Iterable[Face]) -> float:
    """Return how far faces rise from the lowest vertex to the highest, in the unit of their heights."""
    corners = [np.concatenate(face.rings) for face in faces]
    return float(np.ptp(np.concatenate(corners)[:, 2]))


def outlines_of(path: Path, bodies: list[dict[str, Any]], crs_names: set[str]) -> Outlines:
    """Return bodies as outlines, x before y.

    Args:
      path: of the file, for messages.
      bodies: of the file, one at least.
      crs_names: of the CRS, one, as the file or the settings have it.

    Raises:
      InputError: no CRS, several, one that is not known, or one that is made for a place far off.
    """
    codes = set(crs_names)
    for pattern, code in CRS_NAMES.items():
        codes = {re.sub(pattern, code, name) for name in codes}
    if len(codes) > 1:
        raise InputError(
            f"{str(path)!r} declares several CRSs, {', '.join(sorted(crs_names))}: put what is in one CRS into a "
            "folder of its own, or convert it"
        )
    try:
        (code,) = codes
        crs = known_crs(code)
    except ValueError as error:
        names = ", ".join(crs_names) or "none"
        raise InputError(
            f"{str(path)!r} does not say where it lies, as it declares the CRS {names}: set [buildings] crs = "
            '"EPSG:..." to that of its coordinates'
        ) from error
    table = pd.DataFrame(bodies, dtype=object)
    polygons = table.pop("polygon").to_numpy()
    num_coarse = num_of(table.pop("is_coarse"))
    origins = table.pop("height_source").to_numpy()
    tags = {str(name): table[name].to_numpy() for name in table}
    tags = with_estimates(tags, {"height_source": origins})

    if not _is_x_first(crs, shapely.total_bounds(polygons), codes == crs_names):
        polygons = shapely.transform(polygons, lambda xyz: xyz[:, [1, 0, 2]], include_z=True)
    check_on_earth(repr(str(path)), crs, shapely.total_bounds(polygons))
    return Outlines(polygons, tags, crs.to_wkt(), (), {ReadIssue.SOLIDS_COARSE: num_coarse})


def _is_x_first(crs: pyproj.CRS, box: np.ndarray, is_code: bool) -> bool:
    """Return whether x comes before y: the order that puts the middle at latitudes of the CRS's area of use.

    Where both orders or neither do, degrees are in the order of the CRS, and so is a projection that
    is named by a URN or a URL, as in GDAL; of any other projection east comes first.

    Args:
      crs: of the coordinates.
      box: that bounds them, in the order of the file; its middle counts.
      is_code: whether the file names the CRS by a code alone, as ``EPSG:25832``.
    """
    area = area_of(crs)
    south, north = (area.south, area.north) if area else (-90, 90)
    middle = box.reshape(2, 2).mean(axis=0)
    _, lat = transformer(crs.to_wkt(), WGS84).transform(middle, middle[::-1])
    fits = (south - MARGIN_DEG <= lat) & (lat <= north + MARGIN_DEG)
    if fits[0] != fits[1]:
        return bool(fits[0])
    return (crs.is_projected and is_code) or crs.axis_info[0].direction != "north"
