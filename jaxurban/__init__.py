"""jaxurban: urban metric maps for small drones, as differentiable JAX, and planning on them."""

from jaxurban.build import build_maps as build_maps
from jaxurban.city import City as City
from jaxurban.cost import Weights as Weights
from jaxurban.demo import demo_city as demo_city
from jaxurban.errors import InputError as InputError
from jaxurban.errors import JaxurbanError as JaxurbanError
from jaxurban.grid import Grid as Grid
from jaxurban.maps import MetricMaps as MetricMaps
from jaxurban.maps import open_maps as open_maps
from jaxurban.planning import PlannedPath as PlannedPath
from jaxurban.planning import plan as plan
from jaxurban.scenario import Scenario as Scenario
