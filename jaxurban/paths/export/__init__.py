"""Planned paths as files for other programs: GeoJSON, KML, GPX, QGroundControl plan."""
