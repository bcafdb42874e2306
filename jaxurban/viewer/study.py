"""The weights of one route, studied by ``jaxurban sensitivity``: the triangle for the page and what it was asked."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from jaxurban.errors import InputError
from jaxurban.io.files import read_json
from jaxurban.io.tables import read_table
from jaxurban.io.workspace import RECORD_FILE
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.base import ALTITUDE, TIME, TIME_OF_DAY
from jaxurban.report.figures.metrics import percent
from jaxurban.report.figures.sensitivity import CLUSTER_COLOURS
from jaxurban.report.markdown import listed
from jaxurban.viewer.markup import rows, triangle

ROUTES_TABLE, CELLS_TABLE = "tables/triangle.parquet", "tables/triangle_cells.parquet"


@dataclass(frozen=True, eq=False)
class WeightStudy:
    """A triangle of three weights and the cheapest route in each of its cells.

    Attributes:
      query: the route's ``start``, ``goal``, ``altitude_m``, ``time``, ``time_of_day`` and settings.
      names: the three weights.
      weights: all weights as they were given.
      routes: a row for each route: the share of the triangle, its cluster (``kind``), weights at the middle of its
        cell, outcomes.
      cells: a row for each corner of each cell: ``route``, and the share of each weight's corner.
    """

    query: dict[str, Any]
    names: tuple[str, ...]
    weights: dict[str, float]
    routes: pd.DataFrame
    cells: pd.DataFrame

    @classmethod
    def read(cls, folder: Path) -> "WeightStudy":
        """Return the study in a folder.

        Raises:
          InputError: it holds none of one route, or none with a triangle.
        """
        try:
            asked = read_json(folder / RECORD_FILE)["sensitivity"]["asked"]
            query = {name: asked[name] for name in ("start", "goal", "altitude_m", "weights", "cost_model", "limits")}
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise InputError(
                f"{str(folder)!r} holds no study of one route's weights: make it with `jaxurban sensitivity DIR "
                f"--start ... --goal ... --altitude ... -o {folder}`"
            ) from error
        if not (folder / CELLS_TABLE).is_file():
            raise InputError(f"the study in {str(folder)!r} has no triangle: three weights must vary, none of them 0")
        query |= {name: asked.get(name) for name in ("time", "time_of_day", "snap", "obstacles")}
        cells = read_table(folder / CELLS_TABLE, "cells of the triangle")
        routes = read_table(folder / ROUTES_TABLE, "routes of the triangle")
        return cls(query, tuple(str(name) for name in cells if name != "route"), query["weights"], routes, cells)

    def to_dict(self, maps: MetricMaps) -> dict[str, Any]:
        """Return the triangle as JSON holds it; ``fields`` are those of the page, altitude and times by their numbers.

        Raises:
          InputError: the route was studied over other maps.
        """
        query = self.query
        if query["altitude_m"] not in maps.altitudes_m:
            raise InputError(f"the study is of {query['altitude_m']:g} m, which these maps do not hold")
        days, times = maps.times_of_day, maps.times
        at = [
            maps.altitudes_m.index(query["altitude_m"]),
            times.index(query["time"]) if query["time"] in times else 0,
            days.index(query["time_of_day"]) if query["time_of_day"] in days else 0,
        ]
        all_weights = {name: self.weights[name] for name in ("distance", *maps.metrics)}
        cells, drawn = [], []
        for number, corners in self.cells.groupby("route", sort=True):
            row = self.routes[self.routes.route == number].iloc[0]
            weights = {name: float(row[f"{name}_at_middle"]) for name in self.names}
            told = [
                ("Share of the triangle", percent(float(row["share"]))),
                ("Length", f"{row['length_m'] / 1000:.2f} km"),
                *((f"Weight of {name}", f"{weight:.3g}") for name, weight in weights.items()),
            ]
            cells.append({"weights": all_weights | weights, "html": rows(told)})
            drawn.append((corners[list(self.names)].to_numpy(), CLUSTER_COLOURS[int(row["kind"]) - 1]))
        given = np.array([self.weights[name] for name in self.names])
        return {
            "cells": cells,
            "svg": triangle(self.names, drawn, given / given.sum()),
            "hint": f"{len(cells)} routes are cheapest somewhere among all shares of {listed(self.names)}. Point at a "
            "cell to see its route; the circle is the weights as given.",
            "ends": {"start": query["start"], "goal": query["goal"]},
            "fields": {
                **dict(zip((ALTITUDE, TIME, TIME_OF_DAY), at, strict=True)),
                "cost_model": query["cost_model"],
                "obstacles": query["obstacles"] or maps.obstacles,
                "clearance_m": float(query["limits"].get("clearance_m", 0.0)),
                "snap": bool(query["snap"]),
            },
        }
