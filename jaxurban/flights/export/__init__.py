"""Planned paths as files for other programs."""
