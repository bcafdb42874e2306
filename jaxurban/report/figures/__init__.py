"""Pictures of metric maps and paths, as matplotlib Figures (in a notebook: ``%matplotlib inline`` shows them)."""

from jaxurban.report.figures.home import plot_return as plot_return
from jaxurban.report.figures.metrics import plot_epochs as plot_epochs
from jaxurban.report.figures.metrics import plot_gps_rating as plot_gps_rating
from jaxurban.report.figures.metrics import plot_heights as plot_heights
from jaxurban.report.figures.metrics import plot_metric as plot_metric
from jaxurban.report.figures.metrics import plot_obstacles as plot_obstacles
from jaxurban.report.figures.metrics import plot_population as plot_population
from jaxurban.report.figures.metrics import plot_sensor_choice as plot_sensor_choice
from jaxurban.report.figures.paths import plot_overview as plot_overview
from jaxurban.report.figures.paths import plot_paths as plot_paths
from jaxurban.report.figures.paths import save_figures as save_figures
from jaxurban.report.figures.profile import plot_profile as plot_profile
from jaxurban.report.figures.profile import save_profile as save_profile
from jaxurban.report.figures.style import bare as bare
from jaxurban.report.figures.when import plot_when as plot_when
