"""Where a receiver was, and the GPS quality of what it sees there.

Legend: ``N`` epochs of the track, ``S`` satellites of its sky.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from jaxurban.kernels.shadows.sweep import WORD_BITS
from jaxurban.maps.task import MapTask
from jaxurban.metrics.gps import DOPS, maps_of_choices, satellites_of
from jaxurban.paths.lines import along_of
from jaxurban.world.grid import Grid

NUM_VISIBLE = "num_visible"


@dataclass(frozen=True, eq=False)
class Track:
    """Where a receiver was, epoch by epoch. ``N`` epochs, ``T`` skies.

    Attributes:
      x_m, y_m: ``[N]`` places in the city's CRS.
      sky: ``[N]`` number of the sky of each epoch, not falling.
      sky_times: ``[T]`` UTC times of the skies, whole seconds, ISO 8601 with a trailing ``Z``.
    """

    x_m: np.ndarray
    y_m: np.ndarray
    sky: np.ndarray
    sky_times: tuple[str, ...]

    @cached_property
    def along_m(self) -> np.ndarray:
        """``[N]`` distance from the first epoch along the track."""
        return along_of(np.column_stack([self.x_m, self.y_m]))

    def legs(self, region: Grid, most_cells: int) -> Iterator[np.ndarray]:
        """Yield the epochs of legs: of successive skies whose places lie in one box of at most so many cells.

        A leg has one sky at least, even if the box around the places of that sky is larger.

        Args:
          region: grid of the cells, which holds all places.
          most_cells: of a box.
        """
        cells = np.stack(region.cell_of_xy(self.x_m, self.y_m))
        first = 0
        for number in range(1, len(self.sky_times)):
            is_joined = (first <= self.sky) & (self.sky <= number)
            if np.prod(np.ptp(cells[:, is_joined], axis=1) + 1) > most_cells:
                yield np.flatnonzero((first <= self.sky) & (self.sky < number))
                first = number
        yield np.flatnonzero(self.sky >= first)

    def box(self, region: Grid, epochs: np.ndarray) -> Grid:
        """Return the smallest part of a grid that holds the places of some epochs."""
        row, col = region.cell_of_xy(self.x_m[epochs], self.y_m[epochs])
        west, south = -int(col.min()), -int(row.min())
        east = int(col.max()) + 1 - region.num_cols
        north = int(row.max()) + 1 - region.num_rows
        return region.padded(west, south, east, north)


def quality_along(task: MapTask, sky: np.ndarray, is_seen: np.ndarray) -> dict[str, np.ndarray]:
    """Return the GPS quality of each epoch from the satellites that it sees, as maps would make it.

    Args:
      task: with the satellites, the clocks and the threshold.
      sky: ``[N]`` number of the sky of each epoch.
      is_seen: ``[N, S]`` bool; satellites below the mask count for nothing.

    Returns:
      ``[N]`` float64 by name: ``gps``, which is m; the DOPs, inf where undetermined; and ``num_visible``.
    """
    names = "gps", *DOPS, NUM_VISIBLE
    values = {name: np.full(len(sky), np.nan) for name in names}
    for number in np.unique(sky):
        # The satellites in view as bits, 32 of them to a word.
        epochs = np.flatnonzero(sky == number)
        in_view = task.in_view(number)
        bits = is_seen[np.ix_(epochs, in_view.numbers)].T
        words = np.zeros((max(1, -(-len(bits) // WORD_BITS)), len(epochs)), np.uint32)
        for k, bit in enumerate(bits):
            words[k // WORD_BITS] |= bit.astype(np.uint32) << np.uint32(k % WORD_BITS)

        is_obstacle = np.zeros(len(epochs), bool)
        threshold = task.params.gps.gdop_threshold
        maps, choice = maps_of_choices(words, is_obstacle, satellites_of(in_view), threshold)
        for name, by_choice in zip(names, maps, strict=True):
            values[name][epochs] = by_choice[choice]
    return values
