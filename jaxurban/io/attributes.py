"""Attributes by which variables of maps tell what their files hold."""

CAVEAT = "comment"  # what whoever reads the values must know; the name is that of the CF conventions
IN_OBSTACLES = "in_obstacles"  # what the engine holds inside obstacles, where files hold no value
