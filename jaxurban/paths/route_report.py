"""What is known of a route once it is explained, as values: its report, and the people beneath its corridor.

Columns of a profile have their names here.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import pandas as pd

from jaxurban.io.tables import numbers_or_none, records_of
from jaxurban.knowledge import Caution, caution_lines
from jaxurban.public import FactsRepr

TOUCHED, VISIBLE, GUESSED = "roof_touched", "num_visible", "roof_guessed"
CLEARANCE, OUTSIDE, OVER_ROOF = "nearest_wall_m", "walls_outside_m", "least_over_roofs_m"
TO_GUESSED = "guessed_roof_away_m"
REACH = "roof_limit_m"  # up to which a roof of guessed height may reach, 0 where there is none
DENSITY = "density_per_km2"
FLOOR = "gps_floor_m"
COST_OF = "cost_of_"  # before the name of a layer, of its part of the cost
GRIDS_M = (100.0, 200.0, 500.0)  # printed always: they disagree where towers stand
SEGMENT_HEADS = {  # what a terminal has room for beside the costs; `RouteReport.segments` has more
    "min_gps": "min gps",
    "people_overflown": "people",
    "no_fix_m": "no fix m",
    "below_gps_floor_m": "below floor m",
    CLEARANCE: "clear m",
    "time_s": "time s",
    "energy_wh": "Wh",
}


@dataclass(frozen=True, eq=False, repr=False)
class OverflownDensity(FactsRepr):
    """The largest mean density of people over the cells that a flight's corridor touches. No class is computed.

    Attributes:
      largest: a row a grid and time of day: ``cell_m``, ``time_of_day``, ``density_per_km2`` (people per km2, the
        largest mean over a cell), that cell's middle (``lon``, ``lat``), ``along_m`` (the place of the route nearest to
        it, metres from the start), ``known_share`` (of its area), all NaN where nothing is known; ``num_cells`` that
        the corridor touches, and of these ``num_partly_known`` and ``num_unknown``.
      segments: the same on the grid of ``cell_m`` for each of a few parts of equal length, ``from_m`` to ``to_m``.
      settings: ``half_width_m``, ``contingency_m``, ``buffer_m`` and ``cell_m``.
      source: whom to credit for the people, and all else in the maps.
      cautions: what to know of the numbers.

    Examples:
      >>> density = ju.overflown_density(maps, path, half_width_m=20.0, contingency_m=30.0)
      >>> density.facts["corridor"]
      '110 m to each side: half-width 20 m, contingency 30 m, ground risk buffer 60 m'
      >>> bool(density.segments["density_per_km2"].max() == density.density_per_km2)
      True
    """

    largest: pd.DataFrame
    segments: pd.DataFrame
    settings: Mapping[str, float]
    source: str
    cautions: list[Caution]

    @property
    def reach_m(self) -> float:
        """From the route to the edge of the corridor."""
        return sum(self.settings[name] for name in ("half_width_m", "contingency_m", "buffer_m"))

    @property
    def density_per_km2(self) -> float:
        """The largest mean over a cell of ``cell_m``, at the time of day when it is largest."""
        return float(self._worst(self.settings["cell_m"])[DENSITY])

    def _worst(self, cell_m: float) -> pd.Series:
        """Return the row of ``largest``, of all times of day, with the largest density on the grid of ``cell_m``."""
        rows = self.largest[self.largest["cell_m"] == cell_m]
        return rows.iloc[rows[DENSITY].fillna(-1.0).argmax()]

    @property
    def facts(self) -> dict[str, str]:
        """The density, where it is, that of the other grids, the corridor and the source."""
        settings = self.settings
        cell_m = settings["cell_m"]
        worst = self._worst(cell_m)
        density = f"{worst[DENSITY]:,.0f} people per km2 over a cell of {cell_m:g} m"
        if worst["time_of_day"]:
            density += f" ({worst['time_of_day']})"
        others = [self._worst(side_m) for side_m in GRIDS_M if side_m != cell_m]
        other_densities = [f"{row[DENSITY]:,.0f} over {row['cell_m']:g} m" for row in others]
        return {
            "largest density": density,
            "where": f"{worst['lon']:.5f}, {worst['lat']:.5f} (lon, lat), {worst['along_m']:.0f} m along the route",
            "other grids": ", ".join(other_densities),
            "corridor": f"{self.reach_m:g} m to each side: half-width {settings['half_width_m']:g} m, contingency "
            f"{settings['contingency_m']:g} m, ground risk buffer {settings['buffer_m']:g} m",
            "source": self.source,
        }

    def to_dict(self) -> dict[str, Any]:
        """Return all of it as plain, JSON-ready values.

        Returns:
          A dictionary of the settings, ``density_per_km2``, ``source``, ``cautions`` (texts), and the rows of
          ``largest`` and ``segments``.

        Examples:
          >>> record = ju.overflown_density(maps, path, half_width_m=20.0).to_dict()
          >>> record["buffer_m"], [row["cell_m"] for row in record["largest"][:3]]
          (60.0, [100.0, 200.0, 500.0])
        """
        return {
            **self.settings,
            DENSITY: self.density_per_km2,
            "source": self.source,
            "cautions": self.cautions,
            "largest": records_of(self.largest),
            "segments": records_of(self.segments.reset_index()),
        }

    def table(self) -> str:
        """Return the report for a terminal: facts, cautions, and the segments, a column for each time of day.

        Returns:
          Text of a line for each fact and caution, and after an empty line one for each segment.

        Examples:
          >>> print(ju.overflown_density(maps, path, half_width_m=20.0).table())
          largest density ... people per km2 over a cell of 200 m (day)
          ...
        """
        lines = [f"{name:<24}{fact}" for name, fact in self.facts.items() if fact]
        text = "\n".join([*lines, *self.cautions])
        times_of_day = self.segments["time_of_day"].unique()  # in their order
        density = self.segments.set_index(["to_m", "time_of_day"], append=True)[DENSITY].unstack()
        density = density[times_of_day].add_prefix("per km2, ")
        density = density.reset_index("to_m").rename_axis(columns=None)
        return f"{text}\n\n{density.to_string(float_format='{:,.0f}'.format)}"


@dataclass(frozen=True, eq=False, repr=False)
class RouteReport(FactsRepr):
    """A route in numbers. Lengths are in the air; all is in still air, above ground.

    Attributes:
      totals: of the whole route: ``length_m``, ``cost`` and ``cost_of_*`` (distance and each metric),
        ``mean_*`` of each metric m (over the length), ``people_overflown`` (see `explain`),
        ``no_fix_m`` (length without a position fix: HDOP is infinite), ``below_gps_floor_m`` (length below the maps'
        GPS floor), ``nearest_wall_m``, ``walls_outside_m`` (see `explain`), ``least_over_roofs_m`` (above the roofs
        beneath; NaN over none), ``time_s``, ``energy_wh``, ``return_altitude_m`` (in the reports of the command and the
        viewer; NaN where none is known).
        What the maps or the arguments do not say is left out.
      segments: a row for each of a few parts of nearly equal length: the same, ``from_m`` and ``to_m`` along
        the route, and ``min_*`` and ``max_*`` of each metric. The sums of costs, lengths and people are the totals.
      profile: a row for each cell that a step of the route crosses, in order: ``from_m`` and ``to_m``, the
        middle's ``lon``, ``lat`` and ``z_m``, and the value of every map; ``roof_kind`` where the maps know kinds.
      settings: ``swath_m``, ``speed_m_s`` and ``power_w`` as they were given.
      cautions: what a pilot should know of the route (`jaxurban.cautions`).

    Examples:
      >>> report = ju.explain(path, maps)
      >>> list(report.totals)[:4], len(report.segments)
      (['length_m', 'cost', 'cost_of_distance', 'cost_of_gps'], 10)
      >>> round(report.segments["cost"].sum()) == round(path.cost)
      True
    """

    totals: Mapping[str, float]
    segments: pd.DataFrame
    profile: pd.DataFrame
    settings: Mapping[str, float | None]
    cautions: list[Caution]

    @property
    def facts(self) -> dict[str, str]:
        """`why`, and the totals as texts, in the units that their names say."""
        strip = f" (strip of {self.settings['swath_m']:g} m)"
        facts = {"why": self.why}
        for name, value in self.totals.items():
            facts[name.replace("_", " ")] = short(value) + strip * (name == "people_overflown")
        return facts

    @property
    def why(self) -> str:
        """A sentence that names the segment with the highest cost and the layer with the largest part in that cost.

        The cost of length is no layer; where only length costs, the sentence says so. Empty where no segment costs
        anything.
        """
        costs = self.segments["cost"]
        if not costs.sum() > 0:
            return ""

        # The segment, and its shares of the whole route.
        index = costs.argmax()
        costliest = self.segments.iloc[index]
        share = costliest / self.segments.sum()
        sentence = (
            f"The most expensive stretch is segment {index + 1}, from {costliest['from_m']:.0f} to "
            f"{costliest['to_m']:.0f} m: {share['cost']:.0%} of the cost on {share['length_m']:.0%} of the length"
        )

        # What it pays, for its length and for each layer.
        layer_costs = costliest.filter(like=COST_OF).drop(f"{COST_OF}distance")
        if not layer_costs.max() > 0:
            return f"{sentence}, all of it for its length."
        layer = str(layer_costs.idxmax()).removeprefix(COST_OF)
        paid = f"{short(layer_costs.max())} of {short(costliest['cost'])}"
        return f"{sentence}; beside its length it pays most for {layer} ({paid})."

    def __repr__(self) -> str:
        return "\n".join(
            [f"{type(self).__name__}:", *caution_lines(self.cautions), "", self.table()]
        )

    def _repr_html_(self) -> str:
        return super()._repr_html_() + self._segments().to_html()

    def to_dict(self) -> dict[str, Any]:
        """Return totals, cautions and segments as plain, JSON-ready values.

        Returns:
          A dictionary of the settings and totals by name, ``why``, ``cautions`` (texts) and ``segments`` (a dictionary
          each); None stands for a number that is missing or not finite.

        Examples:
          >>> record = ju.explain(path, maps, num_segments=3).to_dict()
          >>> round(record["length_m"]), [each["segment"] for each in record["segments"]]
          (848, [1, 2, 3])
        """
        return {
            **numbers_or_none(self.settings),
            **numbers_or_none(self.totals),
            "why": self.why,
            "cautions": self.cautions,
            "segments": [
                {"segment": number, **numbers_or_none(row)}
                for number, row in self.segments.to_dict("index").items()
            ],
        }

    def table(self) -> str:
        """Return the report for a terminal: totals, `why`, and segments.

        Returns:
          Text of a line for each total, and after an empty line each `why`, and a line for each segment.

        Examples:
          >>> print(ju.explain(path, maps).table())
          length m                848
          cost                    283
          ...
          The most expensive stretch is segment ...% of the length; beside its length it pays most for lidar ...
          ...
        """
        # `why` has a paragraph to itself.
        totals = "\n".join(
            f"{name:<24}{fact}" for name, fact in self.facts.items() if name != "why"
        )
        segments = self._segments().to_string(col_space=8) if len(self.segments) else "segment"
        return "\n\n".join(filter(None, [totals, self.why, segments]))

    def _segments(self) -> pd.DataFrame:
        """Return the columns of the segments that a terminal has room for, as texts under short heads.

        The heads of the parts of the cost read as a sum: ``cost =distance +gps +lidar``.
        """
        heads = {"from_m": "from m", "length_m": "length m", "cost": "cost"}
        sign = "="
        for name in map(str, self.segments.filter(regex=f"^{COST_OF}")):
            heads[name] = sign + name.removeprefix(COST_OF)
            sign = "+"
        heads |= SEGMENT_HEADS
        texts = self.segments.filter(list(heads)).map(short)  # those of the columns that exist
        texts = texts.rename(columns=heads)
        return texts.rename_axis(None).rename_axis("segment", axis="columns")


def short(value: float) -> str:
    """Return a number in a few digits: whole from 100 up, else three significant digits, ``none`` if not finite."""
    if not math.isfinite(value):
        return "none"
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"
