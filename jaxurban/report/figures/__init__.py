"""Pictures of metric maps and paths, as matplotlib Figures (in a notebook: ``%matplotlib inline`` shows them)."""

from jaxurban.report.figures.metrics import (
    plot_epochs,
    plot_gps_rating,
    plot_heights,
    plot_metric,
    plot_obstacles,
    plot_population,
    plot_sensor_choice,
)
from jaxurban.report.figures.paths import plot_overview, plot_paths, save_figures
from jaxurban.report.figures.profile import plot_profile, save_profile
from jaxurban.report.figures.when import plot_when

__all__ = [
    "plot_epochs",
    "plot_gps_rating",
    "plot_heights",
    "plot_metric",
    "plot_obstacles",
    "plot_overview",
    "plot_paths",
    "plot_population",
    "plot_profile",
    "plot_sensor_choice",
    "plot_when",
    "save_figures",
    "save_profile",
]
