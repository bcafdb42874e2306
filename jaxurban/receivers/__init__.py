"""Receivers: what they see of the sky, and whether the maps agree; README.md says how."""
