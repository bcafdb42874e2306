"""All pictures of a region, written as PNG."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

from matplotlib.figure import Figure

from jaxurban.errors import InputError
from jaxurban.io.workspace import Workspace
from jaxurban.maps.metric_maps import GivenMaps, MetricMaps, as_maps
from jaxurban.metrics.registry import ON_REQUEST
from jaxurban.paths.explain import RouteReport
from jaxurban.paths.path import PlannedPath
from jaxurban.report.figures.metrics import (
    AVAILABILITY,
    drawn_variables,
    plot_epochs,
    plot_gps_rating,
    plot_heights,
    plot_metric,
    plot_obstacles,
    plot_population,
    plot_sensor_choice,
)
from jaxurban.report.figures.paths import Paths, paths_in, plot_overview, plot_paths
from jaxurban.report.figures.profile import plot_profile
from jaxurban.report.write import save


def save_figures(maps: GivenMaps, paths: Paths, folder: str | Path) -> list[Path]:
    """Write every picture of these maps and paths as PNG and return the files; each appears whole or not at all.

    GPS at one time is drawn at the first; of several times there is also a panel each (``gps_epochs``) and the share of
    them at which it is good enough (``gps_availability``), of a long series the latter and what 5 % stay below.

    Args:
      maps: from `build_maps` or `open_maps`.
      paths: one, several or a batch; empty for maps alone.
      folder: where to; made if it is not there.

    Raises:
      InputError: the folder cannot be written to, or holds such files that were not written so, or changed since.
    """
    maps = as_maps(maps)
    outputs = {f"{name}.png": draw for name, draw in maps_figures(maps, paths).items()}
    with Workspace.shared(Path(folder), "maps --figures", outputs):
        return save(folder, outputs)


def maps_figures(maps: MetricMaps, paths: Paths) -> dict[str, Callable[[], Figure]]:
    """Return what draws each picture of these maps and paths, by file name."""
    figures: dict[str, Callable[[], Figure]] = {
        "overview": lambda: plot_overview(maps, paths),
        "heights": lambda: plot_heights(maps),
        "obstacle": lambda: plot_obstacles(maps),
        **{name: partial(plot_metric, maps, name) for name in maps.metrics if name != "population"},
        "sensor_choice": lambda: plot_sensor_choice(maps),
    }
    if paths_in(paths):
        figures["paths"] = lambda: plot_paths(maps, paths)
    else:
        for time_of_day in maps.times_of_day or (None,):
            name = "cost" if len(maps.times_of_day) < 2 else f"cost_{time_of_day}"
            figures[name] = partial(plot_paths, maps, (), time_of_day=time_of_day)
    for name, variable in drawn_variables(maps).items():
        is_of_series = name.endswith(("_availability", "_p05")) and maps.variable(variable.of) != variable.of
        if name == AVAILABILITY or is_of_series or variable.of in ON_REQUEST:
            figures[name] = partial(plot_metric, maps, name)
    if len(maps.times) > 1 and maps.default_time is not None:
        figures["gps_epochs"] = lambda: plot_epochs(maps)
    if "gdop" in maps.ds:  # statistics over a long series hold none
        figures["gps_rating"] = lambda: plot_gps_rating(maps)
    if "density" in maps.ds:
        figures["population"] = lambda: plot_population(maps)
    return figures


def check_picture(file: str | Path) -> None:
    """Raise InputError unless `save_profile` can write this file: call it before a long search."""
    file = Path(file)
    if file.suffix.lower() != ".png":
        raise InputError(f"cannot draw {str(file)!r}: end its name in .png")
    if not file.parent.is_dir() or file.is_dir():
        raise InputError(f"cannot write {str(file)!r}: name a file in a folder that is there")


def save_profile(planned: PlannedPath, maps: GivenMaps, file: str | Path, report: RouteReport | None = None) -> None:
    """Write the profile of a route (`plot_profile`) as PNG; the file appears whole or not at all.

    Raises:
      InputError: there is no path, the maps are others, or the file cannot be written.
    """
    check_picture(file)
    save(Path(file).parent, {Path(file).name: lambda: plot_profile(planned, maps, report)})
