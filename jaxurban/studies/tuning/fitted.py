"""What fits to routes and to targets share: their routes, who flew these, and how a fit shows itself."""

from functools import cached_property

import numpy as np
import pandas as pd

from jaxurban.metrics.weights import Weights
from jaxurban.statistics.conclusions import Verdict
from jaxurban.studies.decided import (
    border_verdict,
    edge_band,
    ended_sides,
    is_at_edge,
    wider_bounds,
)
from jaxurban.studies.demonstrations import Demonstration, optimal_demonstrations
from jaxurban.studies.queries import RouteQuery, command_to_plan, maps_of, weights_option
from jaxurban.studies.results import StudyResult, with_units
from jaxurban.studies.tuning.tested import FitCommands

GIVEN = "routes that were given in Python"


class FitResult(StudyResult):
    """Base of fits: a notebook shows their lines and weights, and `save` writes what ``jaxurban tune`` does.

    Attributes:
      names: ``[K]`` of the weights.
      weights: that were fitted.
      table: a row per weight, by its name, with its ``unit``.
      routes: the demonstrations that were fitted, or those without the wish.
      commands: what fits again.
      origin: of the routes, in words.
    """

    _command = "tune"
    _report = "jaxurban.studies.reports.tuning:fit_report"

    names: tuple[str, ...]
    weights: Weights
    table: pd.DataFrame
    routes: tuple[Demonstration, ...]
    commands: FitCommands
    origin: str

    @property
    def queries(self) -> tuple[RouteQuery, ...]:
        """The ends of the routes."""
        return tuple(each.query for each in self.routes)

    @cached_property
    def planned(self) -> list[Demonstration]:
        """The routes under the fitted weights between the same ends."""
        return optimal_demonstrations(self.queries, self.weights)

    @property
    def pilots(self) -> tuple[str, ...]:
        """The weights under which the routes were planned, as ``--pilot`` takes them; none of routes that were not.

        They are those of the layers that the maps hold.
        """
        pilots = (
            weights_option(each.pilot, each.query.cost_map.maps.metrics)
            for each in self.routes
            if each.pilot
        )
        return tuple(dict.fromkeys(pilots))

    @property
    def tables(self) -> dict[str, pd.DataFrame]:
        """The tables that are written, by name."""
        return with_units(self.report.others)

    @cached_property
    def border(self) -> list[Verdict]:
        """How many of the routes, or of those under the fitted weights, the border of the maps may have made."""
        bands = {id(each): edge_band(each.maps) for each in maps_of(self.queries)}
        pinned = [
            is_at_edge(each.points_m, each.query.cost_map.grid, bands[id(each.query.cost_map)])
            for each in (*self.routes, *self.planned)
        ]
        ended = ended_sides(self.queries[0].cost_map.maps)
        return border_verdict(np.logical_or(*np.reshape(pinned, (2, -1))), ended=ended)

    @property
    def last_command(self) -> str:
        """What to run where no other routes decide more: over wider maps, else to plan under the weights."""
        query = self.queries[0]
        bounds = wider_bounds(query.cost_map.maps)
        if self.border and bounds and self.commands.wider:
            return self.commands.wider.replace("{bounds}", bounds)
        return command_to_plan(query, self.weights)

    def __repr__(self) -> str:
        lines = [f"{name}: {text}" for name, text in self.facts.items()]
        table = f"{self.table.to_string(float_format='{:.3g}'.format)}"
        return "\n".join([*lines, *self.known_cautions, table])

    def _repr_html_(self) -> str:
        return f"{super()._repr_html_()}{self.table.to_html(float_format='{:.3g}'.format)}"
