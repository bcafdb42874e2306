"""Planned paths as files for other programs: GeoJSON, KML, GPX, QGroundControl plan."""

from jaxurban.paths.export.qgc_plan import height_note as height_note
from jaxurban.paths.export.waypoints import GROUND_TOLERANCE_M as GROUND_TOLERANCE_M
from jaxurban.paths.export.write import check_export as check_export
from jaxurban.paths.export.write import write_path as write_path
