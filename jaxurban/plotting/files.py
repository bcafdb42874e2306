"""All pictures of a region, written as PNG."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image
from scipy.spatial import cKDTree

from jaxurban.errors import InputError
from jaxurban.io.store import whole_file
from jaxurban.maps import MetricMaps
from jaxurban.planned import PlannedPath
from jaxurban.plotting.metrics import (
    plot_gps_rating,
    plot_heights,
    plot_metric,
    plot_obstacles,
    plot_population,
    plot_sensor_choice,
)
from jaxurban.plotting.paths import plot_overview, plot_paths
from jaxurban.plotting.profile import plot_profile
from jaxurban.route_report import RouteReport

DPI, NUM_COLOURS, NUM_ROUNDS = 110, 256, 10


def save_figures(maps: MetricMaps, paths: Mapping[float, Sequence[PlannedPath]], folder: str | Path) -> list[Path]:
    """Write every picture of these maps and paths as PNG and return the files; each appears whole or not at all.

    Args:
      maps: from `build_maps` or `open_maps`.
      paths: paths by altitude, empty for maps alone.
      folder: where to; made if it is not there.

    Raises:
      InputError: the folder cannot be written to.
    """
    figures: dict[str, Callable[[], Figure]] = {
        "overview": lambda: plot_overview(maps, paths),
        "heights": lambda: plot_heights(maps),
        "obstacle": lambda: plot_obstacles(maps),
        "gps": lambda: plot_metric(maps, "gps"),
        "lidar": lambda: plot_metric(maps, "lidar"),
        "sensor_choice": lambda: plot_sensor_choice(maps),
        "risk": lambda: plot_metric(maps, "risk"),
        "paths": lambda: plot_paths(maps, paths),
    }
    if "gdop" in maps.ds:  # statistics over a long series hold none
        figures["gps_rating"] = lambda: plot_gps_rating(maps)
    if "density" in maps.ds:
        figures["population"] = lambda: plot_population(maps)
    files = []
    for name, draw in figures.items():
        file = Path(folder) / f"{name}.png"
        with whole_file(file) as scratch:
            write_png(draw(), scratch)
        files.append(file)
    return files


def check_picture(file: str | Path) -> None:
    """Raise InputError unless `save_profile` can write this file: call it before a long search."""
    file = Path(file)
    if file.suffix.lower() != ".png":
        raise InputError(f"cannot draw {str(file)!r}: end its name in .png")
    if not file.parent.is_dir() or file.is_dir():
        raise InputError(f"cannot write {str(file)!r}: name a file in a folder that is there")


def save_profile(planned: PlannedPath, maps: MetricMaps, file: str | Path, report: RouteReport | None = None) -> None:
    """Write the profile of a route (`plot_profile`) as PNG; the file appears whole or not at all.

    Raises:
      InputError: there is no path, the maps are others, or the file cannot be written.
    """
    check_picture(file)
    figure = plot_profile(planned, maps, report)
    with whole_file(Path(file)) as scratch:
        write_png(figure, scratch)


def write_png(figure: Figure, file: Path) -> None:
    """Write a figure as PNG of 256 colours, about a quarter of the size of full colour."""
    figure.set_dpi(DPI)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    with_palette(np.asarray(canvas.buffer_rgba())[..., :3]).save(file, format="png", optimize=True)


def with_palette(pixels: np.ndarray) -> Image.Image:
    """Return an image of at most 256 colours, chosen by k-means from an octree's.

    Colours weigh less than their pixels (power 0.75), so that lines and legends keep theirs. Tried and dropped:
    the octree alone, which tints greys; median cut, which loses rare colours; dithering, which dots flat areas.

    Args:
      pixels: ``[Y, X, 3]`` uint8.
    """
    packed, index, num_pixels = np.unique(
        pixels.astype(np.uint32) @ np.array([1 << 16, 1 << 8, 1], np.uint32), return_inverse=True, return_counts=True
    )
    colours = np.stack([packed >> 16, packed >> 8 & 255, packed & 255], axis=1).astype(float)
    weights = num_pixels**0.75
    octree = Image.fromarray(np.ascontiguousarray(pixels)).quantize(NUM_COLOURS, method=Image.Quantize.FASTOCTREE)
    palette = np.array(octree.getpalette(), float).reshape(-1, 3)
    for _ in range(NUM_ROUNDS):
        nearest = cKDTree(palette).query(colours)[1]
        sums = np.stack([np.bincount(nearest, weights * channel, len(palette)) for channel in colours.T], axis=1)
        share = np.bincount(nearest, weights, len(palette))[:, None]
        palette = np.where(share > 0, sums / np.maximum(share, 1e-9), palette)
    palette = np.round(palette)
    numbers = cKDTree(palette).query(colours)[1].astype(np.uint8)[index]
    image = Image.fromarray(numbers.reshape(pixels.shape[:2]), "P")
    image.putpalette(palette.astype(np.uint8).tobytes())
    return image
