"""Attributes by which variables of maps tell what their files hold."""

IN_OBSTACLES = "in_obstacles"  # what the engine holds inside obstacles, where files hold no value
