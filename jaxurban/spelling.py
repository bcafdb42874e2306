"""Which name a wrong one means."""

import difflib
from collections.abc import Iterable

LEAST_ALIKE = 0.66  # as two letters of three are
MEANT = {  # by names of other libraries
    "coords": "lonlat",
    "coordinates": "lonlat",
    "points": "xy_m",
    "distance": "length_m",
    "geometry": "lonlat",
    "save": "savefig",
    "to_geojson": "save",
    "to_kml": "save",
    "to_gpx": "save",
    "to_file": "save",
    "write": "save",
    "export": "save",
    "waypoints": "lonlat",
    "height": "altitude",
    "from": "start",
    "to": "goal",
    "output": "o",
    "load": "open_maps",
    "load_maps": "open_maps",
    "read_maps": "open_maps",
    "astar": "plan",
    "find_path": "plan",
    "plot_gps": "plot_metric",
    "plot_maps": "plot_metric",
    "when": "time",
}


def near(name: str, valid: Iterable[str]) -> list[str]:
    """Return in a list the valid name that a wrong one means: the only one that begins so, else the most like it.

    What other libraries call it is known (`MEANT`). The list is empty where none is like it (`alike`).
    """
    names = list(valid)
    if MEANT.get(name) in names:
        return [MEANT[name]]
    beginning = [each for each in names if each.startswith(name)]
    return beginning if len(beginning) == 1 else alike(name, names)


def alike(name: str, valid: Iterable[str], least: float = LEAST_ALIKE) -> list[str]:
    """Return in a list the valid name that is most like a wrong one; the list is empty where none is like it.

    Case does not count, and the first letters must agree: people seldom mistype the first letter of a name.

    Args:
      name: the wrong one.
      valid: names to choose from.
      least: share of letters, about, that must be the same in the same order (``difflib``).
    """
    wrong = name.lower().replace("*", "star")  # A* is astar
    names = {each.lower(): each for each in valid if each[:1].lower() == wrong[:1]}
    matches = difflib.get_close_matches(wrong, names, n=1, cutoff=least)
    return [names[match] for match in matches]
