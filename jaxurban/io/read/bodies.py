"""Bodies of city models: of the faces of a building and its parts one MultiPolygon, above its own ground."""

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pyproj
import shapely
from pyproj.exceptions import CRSError

from jaxurban.errors import InputError
from jaxurban.io.read.outlines import Outlines
from jaxurban.world.grid import WGS84, check_on_earth, transformer

PIECE = re.compile(r"(Building|Bridge|Tunnel)[A-Z]\w+")  # of another object, whatever it is
ROOFS = (None, "RoofSurface", "OuterFloorSurface")  # labels of faces above which is air, or may be
# Kinds that are no obstacles, and groups of what stands elsewhere in the file.
GROUND = re.compile(
    "Road|Railway|Track|Square|TransportSquare|TransportationComplex|Waterway|WaterBody|LandUse|"
    "ReliefFeature|TINRelief|CityObjectGroup"
)
TAGS = {  # of OpenStreetMap, by kind
    "Building": {"building": "yes"},
    "Bridge": {"man_made": "bridge"},
    "Tunnel": {"man_made": "tunnel"},
    "SolitaryVegetationObject": {"natural": "tree"},
}
MARGIN_DEG = 1.0  # around the area of use of a CRS
LOST_M = 1e9  # in place of what is no number: no reader takes it for a height
CRS_NAMES = {  # of German and Swiss surveys, and those with a code of EPSG
    r".*ETRS89_UTM(3[1-3]).*": r"EPSG:258\1",
    r".*DE_DHDN_3GK2.*": "EPSG:31466",
    r".*DE_DHDN_3GK3.*": "EPSG:31467",
    r".*DE_DHDN_3GK4.*": "EPSG:31468",
    r".*DE_DHDN_3GK5.*": "EPSG:31469",
    r"^CH1903(_LV03)?$": "EPSG:21781",
    r"^CH1903\+(_LV95)?$": "EPSG:2056",
    r".*?EPSG\W+(?:[\d.]*[:/])?(\d{4,}).*": r"EPSG:\1",
}


class Face(NamedTuple):
    """A face of an object.

    Attributes:
      lod: level of detail.
      label: what the file says that it is, such as ``"RoofSurface"``; None where it says nothing.
      polygon: with heights.
    """

    lod: float
    label: str | None
    polygon: shapely.Polygon


@dataclass
class CityObject:
    """An object of a city model, or a piece of one.

    Attributes:
      kind: as both formats call it, such as ``"BuildingPart"``.
      height, levels: as the file has them: of the roof above the ground, and of storeys.
      faces: in all levels of detail.
      pieces: its parts, installations and what else belongs to it.
    """

    kind: str
    height: Any = None
    levels: Any = None
    faces: list[Face] = field(default_factory=list)
    pieces: list["CityObject"] = field(default_factory=list)

    def draw(self, lod: float, label: str | None, rings: Iterable[np.ndarray]) -> None:
        """Add a face.

        Args:
          lod, label: as of `Face`.
          rings: its border, then its holes, ``[V, 3]`` x, y and z; of fewer than three vertices there is no ring.
        """
        whole = [
            np.where(np.isnan(ring), LOST_M, ring)  # quicker than `np.nan_to_num`
            for ring in rings
            if len(ring) > 2
        ]
        if whole:
            self.faces.append(Face(lod, label, shapely.Polygon(whole[0], whole[1:])))

    def best_faces(self) -> list[Face]:
        """Return the faces of the highest level of detail that has roofs or no labels, and the same of its pieces.

        It gives way to parts of a higher level.
        """
        ranks = [(face.label in ROOFS, face.lod) for face in self.faces]
        _, lod = max(ranks, default=(True, 0))
        part_lods = [
            face.lod
            for piece in self.pieces
            if piece.kind.endswith("Part")
            for face in piece.best_faces()
        ]
        faces = [face for face in self.faces if face.lod == lod >= max(part_lods, default=0)]
        for piece in self.pieces:
            faces += piece.best_faces()
        return faces


def body_of(whole: CityObject) -> dict[str, Any]:
    """Return the body of an object and its pieces, whose ground is at the lowest vertex of all.

    Returns:
      ``polygon``, all faces, roofs first, as a MultiPolygon with heights, empty without a face; ``num_roofs``, how many
      are roofs by their labels or have none, 0 where all are; and tags as of `Outlines`. The height of kinds that
      `TAGS` lacks is how far they rise.
    """
    faces = whole.best_faces()
    faces.sort(key=lambda face: face.label not in ROOFS)
    num_roofs = sum(face.label in ROOFS for face in faces)
    polygon = shapely.MultiPolygon([face.polygon for face in faces])
    kind = PIECE.sub(r"\1", whole.kind)
    height = whole.height
    if GROUND.fullmatch(kind):
        height = 0.0
    elif kind not in TAGS:
        z = shapely.get_coordinates(polygon, include_z=True)[:, 2]
        height = np.ptp(z) if len(z) else 0.0
    body = {
        "polygon": polygon,
        "num_roofs": num_roofs if num_roofs < len(faces) else 0,
        "building": None,
        "height": height,
        "levels": whole.levels,
    }
    return body | TAGS.get(kind, {})


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
        crs = pyproj.CRS(code)
    except (ValueError, CRSError) as error:
        names = ", ".join(crs_names) or "none"
        raise InputError(
            f"{str(path)!r} does not say where it lies, as it declares the CRS {names}: set [buildings] crs = "
            '"EPSG:..." to that of its coordinates'
        ) from error
    table = pd.DataFrame(bodies, dtype=object)
    polygons = table.pop("polygon").to_numpy()
    tags = {str(name): table[name].to_numpy() for name in table}

    if not _is_x_first(crs, shapely.total_bounds(polygons), codes == crs_names):
        polygons = shapely.transform(polygons, lambda xyz: xyz[:, [1, 0, 2]], include_z=True)
    check_on_earth(repr(str(path)), crs, shapely.total_bounds(polygons))
    return Outlines(polygons, tags, crs.to_wkt(), (), {})


def _is_x_first(crs: pyproj.CRS, box: np.ndarray, is_code: bool) -> bool:
    """Return whether x comes before y, as which of the two orders lies at latitudes of the CRS's area of use.

    Where both or neither do, degrees are in the order of the CRS, and so is a projection that is named by a URN or a
    URL, as in GDAL; else its east comes first.

    Args:
      crs: of the coordinates.
      box: that bounds them, in the order of the file; its middle counts.
      is_code: whether the file names the CRS by a code alone, as ``EPSG:25832``.
    """
    area = crs.area_of_use
    south, north = (area.south, area.north) if area else (-90, 90)
    middle = box.reshape(2, 2).mean(axis=0)
    _, lat = transformer(crs.to_wkt(), WGS84).transform(middle, middle[::-1])
    fits = (south - MARGIN_DEG <= lat) & (lat <= north + MARGIN_DEG)
    if fits[0] != fits[1]:
        return bool(fits[0])
    return (crs.is_projected and is_code) or crs.axis_info[0].direction != "north"
