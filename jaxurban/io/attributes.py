"""Attributes by which variables of maps tell what their files hold."""

from collections.abc import Mapping
from typing import Any

CAVEAT = "comment"  # what whoever reads the values must know; the name is that of the CF conventions
IN_OBSTACLES = "in_obstacles"  # what the engine holds inside obstacles, where files hold no value


def names_in(attributes: Mapping[str, Any], name: str) -> list[str]:
    """Return the names in an attribute, which holds them as one text: NetCDF 3 takes no lists of texts."""
    return [part for part in attributes.get(name, "").split(", ") if part]
