"""Soft forms of the metrics: they tend to the exact ones as their softness goes to 0, and have gradients."""

from jaxurban.soft.gps import GpsView as GpsView
from jaxurban.soft.gps import soft_gps as soft_gps
from jaxurban.soft.gps import soft_gps_maps as soft_gps_maps
from jaxurban.soft.lidar import soft_lidar as soft_lidar
from jaxurban.soft.obstacle import soft_obstacle as soft_obstacle
from jaxurban.soft.population import People as People
from jaxurban.soft.population import soft_population as soft_population
from jaxurban.soft.risk import soft_risk as soft_risk
