from jaxurban.maps.at_once import all_maps as all_maps
from jaxurban.maps.build import map_inputs as map_inputs
from jaxurban.maps.differentiable import SoftParams as SoftParams
from jaxurban.maps.differentiable import soft_city as soft_city
from jaxurban.metrics.reception import ReceptionCurve as ReceptionCurve
from jaxurban.planners.envelope import planned_cost as planned_cost
