"""Outlines of buildings for the page: read from the sources of the maps when somebody first looks closely."""

from collections.abc import Callable
from dataclasses import dataclass
from threading import Lock, Thread
from typing import Any

import numpy as np
import shapely

from jaxurban.errors import JaxurbanError
from jaxurban.world.city import City
from jaxurban.world.grid import Grid

MOST_OUTLINES = 3000  # of one answer: the largest


@dataclass
class Outlines:
    """The outlines of a city, in the background while they are read.

    Attributes:
      load: returns the city; None where nobody knows its sources.
    """

    load: Callable[[], City] | None = None

    def __post_init__(self) -> None:
        self._lock = Lock()
        self._thread: Thread | None = None
        self._tree: shapely.STRtree | None = None
        self._why_not = ""

    @property
    def are_there(self) -> bool:
        """Whether they can be read, as far as is known."""
        return self.load is not None and not self._why_not

    def within(self, grid: Grid, box_m: tuple[float, float, float, float]) -> dict[str, Any]:
        """Return rings of ``[N][2]`` metres from the grid's southwest corner that meet a box there.

        ``state`` is ``"ready"``, ``"reading"`` (ask again) or why there are none; ``left_out`` is how many there are
        beside the largest, which are the rings.
        """
        with self._lock:
            if self.load is not None and self._thread is None:
                self._thread = Thread(target=self._read, daemon=True)
                self._thread.start()
        if self._tree is None:
            return {"state": self._why_not or ("reading" if self.load else "none"), "rings": [], "left_out": 0}
        corner = np.array([grid.x_min_m, grid.y_min_m])
        west, south, east, north = np.array(box_m) + np.tile(corner, 2)
        chosen = self._tree.query(shapely.box(west, south, east, north))
        parts = shapely.get_parts(self._tree.geometries[chosen])
        left_out = max(len(parts) - MOST_OUTLINES, 0)
        parts = parts[np.argsort(-shapely.area(parts), kind="stable")[:MOST_OUTLINES]]
        rings = [np.round(shapely.get_coordinates(each.exterior) - corner, 2).tolist() for each in parts]
        return {"state": "ready", "rings": rings, "left_out": left_out}

    def _read(self) -> None:
        assert self.load is not None
        try:
            buildings = self.load().buildings
            self._tree = shapely.STRtree([] if buildings is None else buildings.polygons)
        except (JaxurbanError, OSError) as error:
            self._why_not = f"no outlines: {error}"
