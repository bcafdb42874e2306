"""report.md of a study of weights, of one route or of many: its tables and figures."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from itertools import chain
from pathlib import Path

import pandas as pd

from jaxurban.draw.write import (
    Figures,
    Markdown,
    ResultReport,
    bullets,
    files_of,
    fill,
    framed,
    joined_with_and,
)
from jaxurban.io.stored import REPORT_FILE
from jaxurban.io.tables import INSTANCES_FILE
from jaxurban.knowledge import names_of
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.maps.shared import population_norms
from jaxurban.paths.places import XY
from jaxurban.paths.plan import cost_map
from jaxurban.paths.queries import IN_METRES
from jaxurban.paths.rows import HAS_PATH
from jaxurban.statistics.bootstrap import FEWEST_GROUPS, interval_columns
from jaxurban.statistics.conclusions import VERDICTS, Conclusion, Verdict, concluded
from jaxurban.studies.decided import FEWEST_RUNS, SIDES, ended_sides, wider_bounds
from jaxurban.studies.figures.sensitivity import plot_breakpoint_routes, plot_regret
from jaxurban.studies.queries import constraint_options, ends_option, weights_option
from jaxurban.studies.results import SHARES, StudyResult, with_units
from jaxurban.studies.weights import summary
from jaxurban.studies.weights.cities import shared_weights, study_key, with_held_weights
from jaxurban.studies.weights.one_route import MORE, OneRoute
from jaxurban.studies.weights.routes import WeightsJob
from jaxurban.studies.weights.settings import SensitivitySettings
from jaxurban.studies.weights.summary import ALL, CUTS
from jaxurban.studies.weights.verdicts import WeightVerdict, verdicts_of, weight_ranking

# What a study may write, so that a user's file in the way is refused before an older study is removed.
TABLES = [
    "routes",
    "weights",
    "summary",
    "together",
    "pairs",
    "changed",
    "changed_summary",
    "ways",
    "switches",
]
FILES = files_of(
    [
        *(f"tables/{name}" for name in TABLES),
        VERDICTS,
        "figures/regret.png",
        "figures/switch_routes.png",
        REPORT_FILE,
    ]
)
SAMPLED = (
    "Routes were drawn by stratum and range in about equal numbers, only where a path joins a pair at every altitude, "
    "not as anyone flies: means are over such routes, not over traffic."
)
GIVEN = (
    "The routes are those that were given: "
    "means are over them, each once, and say nothing about others."
)
BRACKETS = Markdown(
    "In brackets stands the interval (the last section says how it is made). That of regrets is the one of the first "
    "lines, and holds for all weights of a part of the routes at once; the others are each for itself. The rows stand "
    "by regret, which is no rank: the first lines name, of each weight that is behind another, the largest decided "
    "difference; `tables/pairs` compares each two, and may hold further ones that are decided."
)
HEIGHTS_SAID = Markdown("; *heights*, those of all buildings, drawn within their uncertainty")
MOST_REASONS = 3
MORE_ROUTES = 30  # to ask for after one, and at least


@dataclass(frozen=True, eq=False, repr=False)
class Sensitivity(StudyResult):
    """What the weights do to one route, or to many.

    Attributes:
      folder: where the study is kept; None: nowhere.
      maps: of each city by its name.
      instances: the routes asked for.
      rows: what was found for each, a row per route: its status, cost and outcomes, and of each weight its share of the
        cost, the nearest factors at which the route changes, and what a wrong weight costs.
      skipped: why some other maps were not made, a sentence each.
      settings: what was asked.
      rules: cost model and constraints of all routes.
      is_sampled: whether the routes were drawn, by stratum and range, or given.
      changed: how each route differs on other maps: of other times, and of perturbed heights where they were asked for.
      route: what only a study of one route has; None of several, and where no path joins its ends.

    Examples:
      >>> chosen = ju.studies.SensitivitySettings(vary=("gps",))
      >>> result = ju.studies.sensitivity(
      ...     {"demo": maps}, "weights", 2, altitudes_m=[60.0], settings=chosen, progress=False
      ... )
      >>> list(result.tables), result.is_sampled
      (['routes', 'weights', 'summary', 'together', 'changed', 'changed_summary'], True)
    """

    _command = "sensitivity"
    _report = "jaxurban.studies.reports.sensitivity:sensitivity_report"

    folder: Path | None
    maps: Mapping[str, MetricMaps]
    instances: pd.DataFrame
    rows: pd.DataFrame
    skipped: tuple[str, ...]
    settings: SensitivitySettings
    rules: WeightsJob
    is_sampled: bool = True
    changed: pd.DataFrame = field(default_factory=pd.DataFrame)
    route: OneRoute | None = None

    @property
    def facts(self) -> dict[str, str]:
        """What it decided, the cities, how many routes there are, and how many have a path."""
        num_paths = self.rows.status.isin(HAS_PATH).sum()
        routes = f"{len(self.rows)}, {num_paths} with a path"
        return {**self.decided.facts, "cities": ", ".join(self.maps), "routes": routes}

    @cached_property
    def tables(self) -> dict[str, pd.DataFrame]:
        """All tables by name: ``routes``, and those that can be made of them.

        Where any route was found ``weights``, ``summary``, ``together``, what each two weights cost that are wrong at
        once, and of several routes ``pairs``, each two compared; with routes on other maps ``changed`` and
        ``changed_summary``. Of one route ``ways``, where each weight sends it another way, and ``switches``, every
        route along the range of each weight.
        """
        routes = summary.routes_of(self.rows, self.instances)
        result = {"routes": self.rows}
        if routes.empty:
            return with_units(result)
        result["weights"] = summary.weights_table(routes, self.settings.factors)
        result["summary"] = summary.summarise(result["weights"], self.settings.wrong)
        result["together"] = summary.act_together(routes)
        ranking = None if self.route else weight_ranking(result["weights"])
        if ranking is not None:
            result["pairs"] = ranking.pairs
        if len(self.changed) and self.changed.status.isin(HAS_PATH).any():
            result["changed"] = self.changed
            result["changed_summary"] = summary.summarise_changed(self.changed)
        if self.route is not None:
            result["ways"] = self.route.ways
            switches = [self.route.breakpoints(name) for name in self.route.lines]
            result["switches"] = pd.concat(switches).reset_index()
        return with_units(result)

    @cached_property
    def decided(self) -> Conclusion:
        """What is decided, what is not, and what to run next."""
        notes = self.rows.note.dropna().value_counts().index  # the most frequent one first
        why = {"why": str(next(iter(notes), "the report says why")).rstrip(".")}
        verdicts = [Verdict(WeightVerdict.NO_PATH, n=len(self.rows), needed=math.nan, facts=why)]
        if "weights" in self.tables:
            ended = dict.fromkeys(chain(*map(ended_sides, self.maps.values())))
            verdicts = verdicts_of(self.tables, self.route, self.settings, ended)
        # The options of this study, of other routes.
        folders = " ".join(str(maps.folder or "DIR") for maps in self.maps.values())
        altitudes = ",".join(f"{z:g}" for z in sorted(self.instances.altitude_m.unique()))
        low, high = self.settings.factors
        first = next(iter(self.maps.values()))
        options = f"--resolution {first.grid.resolution_m:g} --range {low:g},{high:g} "
        options += f"--preset {self.rules.preset} " * bool(self.rules.preset)
        options += constraint_options(self.rules.constraints, first)
        if self.settings.vary:
            options += f"--vary {','.join(self.settings.vary)} "
        if self.rules.snap:
            options += "--snap " if self.rules.snap is True else f"--snap {self.rules.snap:g} "
        asked = self._study_option(self.settings.seed)
        # What a table of routes names itself. Cities of other altitudes were asked for all of theirs.
        under = f"--altitude {altitudes} "
        if self.instances.groupby("city").altitude_m.agg(set).map(sorted).map(tuple).nunique() > 1:
            under = ""
        weights = shared_weights(with_held_weights(self.instances, self.maps))
        if weights is not None:
            metrics = dict.fromkeys(chain(*(maps.metrics for maps in self.maps.values())))
            under += f"--weights {weights_option(weights, metrics)} "
        place = f"-o {self.folder or 'out/sensitivity'}"
        command = f"jaxurban sensitivity {folders} {options}{asked}{under}{place}-more --routes"
        # Other routes than these, in each city as many as it has here: fewer would decide less.
        num_pairs = int(self.instances.groupby("city").instance.nunique().max())
        others = f"{command} {max(MORE_ROUTES, num_pairs)}"
        if self.is_sampled:
            of_others = self._study_option(self.settings.seed + 1)
            others = others.replace(f"{options}{asked}", f"{options}{of_others}", 1)

        # The only route without a path, higher up.
        higher_m = self._joined_m()
        if higher_m is not None:
            ends_m = self.instances[[*IN_METRES]].to_numpy(float).reshape(2, 2)
            higher = under.replace(f"--altitude {altitudes} ", f"--altitude {higher_m:g} ")
            ends = ends_option(first.grid, ends_m)
            others = f"jaxurban sensitivity {folders} {options}{asked}{higher}{place}-higher {ends}"

        # The same routes over maps of wider bounds.
        again = f"{options}{asked}{under}{place}-wider --routes {self.instances.instance.nunique()}"
        if self.route:
            ends_m = self.instances[[*IN_METRES]].to_numpy(float).reshape(2, 2)
            again = f"{options}{asked}{under}{place}-wider {ends_option(first.grid, ends_m)}"
        elif self.folder:
            again = f"{options}{asked}{place}-wider --routes {self.folder / INSTANCES_FILE}"
        return concluded(
            verdicts,
            more=command + " {needed}",
            done=others,
            wider=self._on_wider_maps(again),
            factor=1 / len(self.maps),
        )

    def _study_option(self, seed: int) -> str:
        """Return the option of what this study asks of every route, with a space behind; empty where all is as usual.

        Args:
          seed: of the sampling of routes.
        """
        settings = self.settings
        asked = {"wrong": f"{settings.wrong:g}", "num_heights": f"{settings.num_heights}"}
        asked |= {"seed": f"{seed}", "height_seed": f"{settings.height_seed}"}
        usual = SensitivitySettings()
        own = [
            f"{name}={text}" for name, text in asked.items() if float(text) != getattr(usual, name)
        ]
        return f"--study {','.join(own)} " if own else ""

    def _joined_m(self) -> float | None:
        """Return the lowest altitude of the maps that joins the ends of the only route, above its own; else None."""
        if len(self.rows) != 1 or self.rows.status.isin(HAS_PATH).all():
            return None
        (maps,) = self.maps.values()
        start, goal = (XY(*end) for end in self.instances[[*IN_METRES]].to_numpy().reshape(2, 2))
        own_m = self.instances.altitude_m.iloc[0]
        for z_m in sorted(each for each in maps.altitudes_m if each > own_m):
            costs = cost_map(maps, z_m, constraints=self.rules.constraints)
            if costs.plan(start, goal, snap=self.rules.snap).status.has_path:
                return z_m
        return None

    def _on_wider_maps(self, options: str) -> str:
        """Return the commands that make wider maps of each city, called as it is, and study them; empty without any."""
        commands, folders = [], []
        sides = [*self.route.edge_sides, *self.route.other_edge_sides] if self.route else []
        for city, maps in self.maps.items():
            folder = f"{maps.folder or 'DIR'}"
            bounds = wider_bounds(maps, sides or SIDES)
            if bounds:
                # Beside maps that are wider ones already, not in their folder.
                parent = Path(folder).parent
                wider = f"{parent if parent.name.endswith('-wider') else folder}-wider/{city}"
                commands.append(f'jaxurban maps {folder} -o {wider} --set "region.bounds={bounds}"')
                folder = wider
            folders.append(folder)
        if not commands:
            return ""
        return " && ".join([*commands, f"jaxurban sensitivity {' '.join(folders)} {options}"])


def sensitivity_report(result: Sensitivity) -> ResultReport:
    """Return what a study of weights writes."""
    tables = result.tables
    figures: Figures = {}
    if result.route is not None:
        figures["switch_routes"] = partial(plot_breakpoint_routes, result.route)
    elif "weights" in tables:
        figures["regret"] = partial(plot_regret, tables["summary"], result.settings.wrong)

    # Why routes were not found: the most frequent statuses, with their notes and the number of routes.
    lost = result.rows[~result.rows.status.isin(HAS_PATH)].fillna({"note": ""})
    reasons = lost.value_counts(["status", "note"]).head(MOST_REASONS).reset_index(name="routes")
    small = summary.small_parts(tables["weights"]) if "weights" in tables else []
    skipped = (f"Not planned on other maps: {reason}" for reason in result.skipped)
    fields = {
        "tables": {"cities": _cities(result), **shown_tables(tables)},
        "credits": [maps.attribution for maps in result.maps.values()],
        "guessed": [names_of(maps.guesses) for maps in result.maps.values()],
        "lost": framed(reasons) if len(reasons) else "",
        "skipped": bullets(skipped),
        "route": _route_said(result.route),
        "result": result,
        "constraints": str(result.rules.constraints) or "none",
        "weights": weights_said(
            with_held_weights(result.instances, result.maps), result.maps.values()
        ),
        "origin": SAMPLED if result.is_sampled else GIVEN,
        "brackets": "",
        "intervals": "",
        "heights": HEIGHTS_SAID if result.settings.num_heights else "",
    }
    if len(result.instances) > 1:
        fields["brackets"] = BRACKETS
        lines = fill(
            "studies/templates/intervals",
            fewest=FEWEST_GROUPS,
            fewest_runs=FEWEST_RUNS,
            small=joined_with_and(small) if small else "none",
        )
        fields["intervals"] = Markdown(lines.strip())
    key = study_key(result.rules, result.maps, result.instances)
    return ResultReport(
        "studies/templates/sensitivity", fields, tables, figures, key=key, decided=result.decided
    )


def _route_said(route: OneRoute | None) -> str:
    """Return where a single route leads, what it costs and what its cautions are; nothing of several."""
    if route is None:
        return ""
    path = route.path
    ends = " to ".join("{:.5f},{:.5f}".format(*lonlat) for lonlat in path.lonlat[[0, -1]])
    facts = f"{path.length_m:,.0f} m, cost {path.cost:,.1f}, {path.altitude_m:g} m above ground"
    return f"The route from {ends} (longitude, latitude): {facts}. {' '.join(path.cautions)}"


def _cities(result: Sensitivity) -> pd.DataFrame:
    """Return a row per city: its maps, its altitudes, how many of its routes have a path, and norms of population."""
    rows = []
    for city, part in result.rows.groupby("city", sort=False):
        maps = result.maps[str(city)]
        norms = population_norms(maps).items()
        norms_by_day = ", ".join(f"{number:,.0f} ({day})" for day, number in norms)
        altitudes = ", ".join(f"{z:g} m" for z in sorted(part.altitude_m.unique()))
        rows.append(
            {
                "city": city,
                "maps": maps.facts["grid"],
                "altitudes": altitudes,
                "pairs of places": part.instance.nunique(),
                "routes": len(part),
                "found": part.status.isin(HAS_PATH).sum(),
                "population is divided by": norms_by_day,
            }
        )
    return pd.DataFrame(rows)


def in_percent(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table whose shares (`SHARES`), and their intervals, are in percent, which their names then say."""
    result = table.copy()
    for name in SHARES:
        columns = [column for column in interval_columns(name) if column in table]
        result[columns] *= 100
        names = zip(interval_columns(name), interval_columns(f"{name} %"), strict=True)
        result = result.rename(columns=dict(names))
    return result


def shown_tables(tables: Mapping[str, pd.DataFrame]) -> dict[str, pd.DataFrame]:
    """Return the tables of the report by name, made of those of the study; none where no route was found.

    ``by_all`` (all routes, and each city) and ``where`` (further parts of the routes): statistics of each weight, of
    each part the costliest wrong weight first. ``changed`` and ``ways`` where the study has them.
    """
    if "summary" not in tables:
        return {}

    # The statistics, in the order of the parts of the routes, and in each part by falling regret.
    parts, _ = pd.factorize(tables["summary"].value)
    by_regret = tables["summary"].assign(part=parts)
    by_regret = by_regret.sort_values(["part", "regret"], ascending=[True, False])
    by_regret = by_regret.rename(columns={"value": "of", "weight_name": "weight"})
    is_whole = by_regret.cut.isin([ALL, "city"])
    is_part = by_regret.cut.isin(CUTS) & ~is_whole & (by_regret.weight != "distance")
    statistics = interval_columns("regret", "changes", "nearest", "share")
    paid = interval_columns(*MORE)
    result = {
        "by_all": by_regret.loc[is_whole, ["of", "weight", "routes", *statistics]],
        "together": tables["together"].query("needed == 0").drop(columns="needed"),
        "paid": by_regret.loc[is_whole & by_regret.regret.notna(), ["of", "weight", *paid]],
        "where": by_regret.loc[is_part, ["of", "weight", "routes", *statistics]],
    }

    if "changed_summary" in tables:
        changed = tables["changed_summary"]
        statistics = interval_columns("is_other", "overlap", "nominal_regret", "nominal_is_closed")
        columns = ["change", "of", "routes", "draws", *statistics, "layers"]
        result["changed"] = changed.loc[changed.cut.isin([ALL, "city"]), columns]
    if "ways" in tables:
        ways = tables["ways"].rename(columns={"weight_name": "weight"})
        at_edge = ways.at_edge.map({0.0: "no", 1.0: "yes"}).fillna("")
        sides = ways.edge_sides.astype(object)  # numbers alone where no route goes another way
        at_edge = sides.where(sides.notna() & (sides != ""), at_edge)
        result["ways"] = ways.assign(at_edge=at_edge).drop(columns="edge_sides")
    return {name: in_percent(table) for name, table in result.items()}


def weights_said(instances: pd.DataFrame, maps: Iterable[MetricMaps]) -> str:
    """Return the weights that all instances share, by name, of layers that any of the maps holds.

    Where the instances differ, words say where their weights stand.
    """
    weights = shared_weights(instances)
    if weights is None:
        return Markdown("those of each route (`instances.parquet`)")
    names = dict.fromkeys(("distance", *chain.from_iterable(each.metrics for each in maps)))
    return ", ".join(f"{name} {weights[name]:g}" for name in names)
