"""Pictures of metric maps and paths, as matplotlib Figures (in a notebook: ``%matplotlib inline`` shows them)."""

from jaxurban.plotting.files import save_figures as save_figures
from jaxurban.plotting.files import save_profile as save_profile
from jaxurban.plotting.metrics import plot_gps_rating as plot_gps_rating
from jaxurban.plotting.metrics import plot_heights as plot_heights
from jaxurban.plotting.metrics import plot_metric as plot_metric
from jaxurban.plotting.metrics import plot_obstacles as plot_obstacles
from jaxurban.plotting.metrics import plot_population as plot_population
from jaxurban.plotting.metrics import plot_sensor_choice as plot_sensor_choice
from jaxurban.plotting.paths import plot_overview as plot_overview
from jaxurban.plotting.paths import plot_paths as plot_paths
from jaxurban.plotting.profile import plot_profile as plot_profile
from jaxurban.plotting.sliders import route_under as route_under
from jaxurban.plotting.sliders import weight_sliders as weight_sliders
