"""What a mission meets: buildings, the ground, no-fly zones and closed cells; what clears it; what cannot be judged."""

from collections.abc import Iterator, Sequence
from itertools import pairwise, product
from typing import Any

import numpy as np
import pandas as pd
import shapely

from jaxurban.flights.contacts import TOUCH_M, Prisms, contacts, merged
from jaxurban.flights.corners_cut import corners_of
from jaxurban.flights.item_returns import least_clear
from jaxurban.flights.legs import Flight, spans
from jaxurban.io.zone import Zone
from jaxurban.kernels.tolerances import FILE_MARGIN_M, GROUND_TOLERANCE_M
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.paths.clearance import reach_said
from jaxurban.paths.constraints import Bound, Constraints, gps_floor_m
from jaxurban.paths.elevation import Elevation
from jaxurban.paths.profile import nearest_level_m
from jaxurban.paths.steps import Steps
from jaxurban.public import listed
from jaxurban.world.kinds import WIRES

# So near an altitude of the maps a step is at it: files round heights up to centimetres.
LEVEL_M = 0.02
CUT = (
    "lie at corners that autopilots cut (at item {}), with an obstacle or a zone there, or nearer than the clearance: "
    "move these corners away from what lies within them, or let the vehicle stop there"
)
NO_DATA = "lie over cells without data"
NO_CITY = "lie where the source of the buildings does not know what stands"
UNKNOWN_ROOFS = "lie over roofs of guessed height, or nearer to them than the clearance: what is there ({kind}) {reach}"
LIKELY_ROOFS = (
    "lie over roofs of guessed height, or nearer to them than the clearance, above what 99 % of their kind keep below, "
    "and not above the highest: what is there ({kind}) {reach}"
)
BELOW_FLOOR = "flies below the GPS floor, which reaches {:.1f} m above the ground there"
NO_FLOOR = "flies below the GPS floor, as GPS is good at no height there"
SPAN = ["from_m", "to_m"]
ASIDE_M = np.array(sorted(range(-100, 101), key=abs))  # to the right; to the left below 0
REMEDY = ["clear_m", "aside_m", "to_item"]
PLACE = ["lon", "lat", "along_m", "to_m", "height_m"]
UNJUDGED = ["kind", "reason", "item", "lon", "lat", "along_m", "to_m"]
COLUMNS = ["kind", "what", "item", *PLACE, "building_m", "by_m", "is_guessed", *REMEDY]


def judged(
    flight: Flight,
    buildings: Prisms,
    known: shapely.Geometry,
    limits: Constraints,
    times: Sequence[str | None],
    time_of_day: str | None,
    ceiling_m: int = 0,
) -> tuple[pd.DataFrame, pd.DataFrame, list[str]]:
    """Return two tables of a mission, what it meets and what of it cannot be judged, and what clears whole legs.

    The first has a row for each finding, with the columns `COLUMNS`, in the order of travel. The
    second has a row for each stretch, with the columns of ``flight.unknown``: ``kind``, ``reason``, and ``from_m`` and
    ``to_m`` along it. The sentences are on the legs with several findings (`_legs_of`).

    Args:
      flight: the mission over the maps.
      buildings: what stands there.
      known: the area in which all buildings are known, in the maps' CRS.
      limits: the zones in force, the bounds and the clearances, none of which is left out.
      times, time_of_day: of the maps that the bounds must hold on; None for a map that has no times.
      ceiling_m: above the ground; no height that clears a finding is higher, so that 0 names none.
    """
    ground = flight.ground
    maps = ground.maps
    tables, legs = [], []
    unknown = [flight.unknown, *_at_corners(flight, buildings, limits)]
    for way in (flight.steps, flight.variants):
        # What cannot be judged: steps without data, beyond what is known, near roofs of guessed height, or nearer to
        # what they clear than the ground is known.
        has_data = maps.ds["has_data"].values[tuple(way.cell.T)]
        is_known = has_data & np.isfinite(way.z_m).all(axis=1)
        steps = way.take(is_known)
        near = contacts(steps, buildings, ground, limits.horizontal_m)
        is_own = below_home(flight, buildings)[near["prism"]] & (near["gap_m"] > -FILE_MARGIN_M)
        is_own &= flight.is_on_site(steps)[near["step"]]  # on the way up from it or down to it
        near = near[~is_own].reset_index(drop=True)
        unknown.append(spans(way.along_m[~is_known], "data", NO_DATA))
        unknown += _unsure(flight, steps, near, limits)
        unknown += _beyond(flight, steps, known, limits.horizontal_m)
        unknown += _guessed(near, buildings)

        # What the other steps meet.
        floor_m = _floors_m(steps, maps, limits, times)
        findings = [
            *_buildings(near, buildings, limits),
            _buried(steps),
            _zones(steps, ground, limits.zones, ceiling_m),
            *_closed(steps, floor_m, maps, limits, times, time_of_day),
        ]
        found = placed(pd.concat(findings, ignore_index=True), flight, steps)
        rest = (flight, steps, floor_m, buildings, known, limits, ceiling_m)
        tables.append(_cleared(found, *rest))
        whole = _cleared(_legs_of(found, flight, steps), *rest)
        legs += [_leg_said(row, ceiling_m) for row in whole.itertuples()]
    return _with_variants(*tables), pd.concat(unknown, ignore_index=True), [*dict.fromkeys(legs)]


def _legs_of(found: pd.DataFrame, flight: Flight, steps: Steps) -> pd.DataFrame:
    """Return a row for each leg with several findings: its ``kind``, ``"leg"``, its item, ``along_m`` and ``to_m``.

    Legs with a closed cell of a bound are left out, as no height is known to open it, and so are take-off and landing.
    """
    ends = pd.DataFrame({"along_m": steps.along_m[:, 0], "to_m": steps.along_m[:, 1]})
    ends = ends.groupby(steps.leg).agg({"along_m": "min", "to_m": "max"})
    ends = ends.drop(np.unique(steps.leg[flight.is_on_site(steps)]))
    begins_m, ends_m = ends.to_numpy()[:, :, None].transpose(1, 0, 2)
    meets = (found["along_m"].to_numpy() < ends_m) & (found["to_m"].to_numpy() > begins_m)
    is_bound = _is_of_bound(found).to_numpy()
    ends = ends[(meets.sum(axis=1) > 1) & ~meets[:, is_bound].any(axis=1)]
    items = [flight.mission.legs[leg].item for leg in ends.index]
    return ends.assign(kind="leg", item=items, by_m=np.nan)


def _leg_said(leg: Any, ceiling_m: int) -> str:
    """Return what clears a leg, a row of `_legs_of` with what clears it (`_cleared`), in a sentence."""
    height = f"no height up to {ceiling_m} m above the ground is known to clear"
    if leg.clear_m <= ceiling_m:
        height = f"{leg.clear_m:.0f} m above the ground clears"
    return f"Leg to item {leg.item:.0f}: {height} all that is judged of it."


def _is_of_bound(found: pd.DataFrame) -> pd.Series:
    """Return whether each finding is a closed cell that no height is known to open: of a bound, or no GPS floor."""
    return (found["kind"] == "closed") & found["by_m"].isna()


def placed(table: pd.DataFrame, flight: Flight, steps: Steps) -> pd.DataFrame:
    """Return findings with the place and the item at which each begins, in the order of travel."""
    begins = steps.take(table["step"].to_numpy(int))
    lon, lat = flight.ground.maps.grid.lonlat_of_xy(*begins.ends_m[:, 0].T)
    items = [flight.mission.legs[leg].item for leg in begins.leg]
    table = table.assign(item=items, lon=lon, lat=lat, height_m=begins.z_m[:, 0])
    table = table.rename(columns={"from_m": "along_m"}).sort_values("along_m", ignore_index=True)
    return table.reindex(columns=COLUMNS)


def unjudged_stretches(unknown: pd.DataFrame, flight: Flight) -> pd.DataFrame:
    """Return a row for each stretch of a mission that is not judged for a reason, with the place at which it begins.

    Args:
      unknown: stretches, which may overlap, with ``kind``, ``reason``, ``from_m`` and ``to_m`` (`judged`).
      flight: the mission over the maps.

    Returns:
      The columns `UNJUDGED`, in the order of travel; ``item``, ``lon`` and ``lat`` are NaN where the mission has no
      place there, outside the maps or at no known height.
    """
    stretches = merged(unknown.assign(number=pd.factorize(unknown["reason"])[0]), "number")
    steps = flight.steps
    begin_m = stretches["from_m"].to_numpy() + TOUCH_M
    step = np.searchsorted(steps.along_m[:, 0], begin_m, side="right") - 1
    is_there = step >= 0
    is_there[is_there] = begin_m[is_there] <= steps.along_m[step[is_there], 1] + TOUCH_M
    begins = steps.take(step[is_there])
    places = np.full((len(stretches), 3), np.nan)
    places[is_there, 0] = [flight.mission.legs[leg].item for leg in begins.leg]
    places[is_there, 1:] = np.stack(
        flight.ground.maps.grid.lonlat_of_xy(*begins.ends_m[:, 0].T), axis=-1
    )
    placed = stretches.assign(**dict(zip(("item", "lon", "lat"), places.T, strict=True)))
    return placed.rename(columns={"from_m": "along_m"})[UNJUDGED]


def _cleared(
    findings: pd.DataFrame,
    flight: Flight,
    steps: Steps,
    floor_m: np.ndarray,
    buildings: Prisms,
    known: shapely.Geometry,
    limits: Constraints,
    ceiling_m: int,
) -> pd.DataFrame:
    """Return findings with what clears each of buildings, the ground and zones by the clearances (`least_clear`).

    Zones that end above the ceiling count at all heights. Cells that bounds close do not count. A height also reaches
    the GPS floor, where it is asked for.

    Args:
      findings: of some steps of the mission.
      flight: the mission over the maps.
      steps: the steps.
      floor_m: the GPS floor below each (`_floors_m`).
      buildings: what stands there.
      known: the area in which all buildings are known, in the maps' CRS.
      limits: the clearances, and the zones in force.
      ceiling_m: above the ground; no height is higher.

    Returns:
      The findings with ``clear_m``, the least height above the ground that clears the part of the flight that has the
      finding, in whole metres; and ``aside_m``, how far that part must go to the right, parallel and at the elevation
      that it has (to the left where it is negative). NaN where none is sure (beside, below the highest ground of the
      maps), on a take-off or landing, and of closed cells. ``to_item`` is the item that the end of that part is flown
      toward: where it is another one than ``item``, the part goes round corners, and legs that are moved aside end
      where they cross.
    """
    ground = flight.ground
    is_low = np.array([zone.ceiling_m <= ceiling_m for zone in limits.zones], bool)
    zones = _zones_of(ground, limits.zones)
    known = shapely.difference(known, shapely.union_all(zones.polygons[~is_low]))
    low = [values[is_low] for values in zones]
    buildings = Prisms(*map(np.concatenate, zip(buildings, low, strict=True)))
    remedies = []
    of_bounds = _is_of_bound(findings)
    for row, is_of_bound in zip(findings.to_dict("records"), of_bounds, strict=True):
        is_there = ((steps.along_m >= row["along_m"]) & (steps.along_m <= row["to_m"])).all(axis=1)
        part = steps.take(is_there)
        line = shapely.simplify(shapely.linestrings(part.ends_m.reshape(-1, 2)), TOUCH_M)
        if is_of_bound or flight.is_on_site(part).any():
            line = None
        asides_m = ASIDE_M[:1] if row["kind"] in ("closed", "leg") else ASIDE_M
        ways = shapely.offset_curve(line, -asides_m, join_style="mitre")
        least_m = least_clear(ways, buildings, ground, known, limits)
        fix_m = (part.ground_m.max(axis=1) + floor_m[is_there]).max()
        clear_m = np.ceil(max(least_m[0], fix_m) - part.ground_m.min())
        clear_m = max(clear_m, np.ceil(limits.vertical_m))
        own_m = (part.ground_m + part.z_m).min()
        aside_m = asides_m[np.maximum(least_m, ground.highest_m.max()) <= own_m]
        clear_m = clear_m if clear_m <= ceiling_m else np.nan
        aside = [*aside_m[:1], np.nan][0] or np.nan
        remedies.append([clear_m, aside, flight.mission.legs[part.leg[-1]].item])
    return findings.assign(**pd.DataFrame(remedies, findings.index, REMEDY))


def _with_variants(main: pd.DataFrame, beside: pd.DataFrame) -> pd.DataFrame:
    """Return the findings of a mission, with those of its variants that are no finding of the mission itself.

    A finding of a variant is one of the mission's if they are of a kind and of one building, and overlap.
    """
    same = main.merge(beside.reset_index(), on=["kind", "building_m"])
    overlaps = (same["along_m_x"] <= same["to_m_y"]) & (same["along_m_y"] <= same["to_m_x"])
    new = beside.drop(same.loc[overlaps, "index"])
    if main.empty or new.empty:
        return new if main.empty else main
    return pd.concat([main, new]).sort_values("along_m", ignore_index=True)


def _unsure(
    flight: Flight, steps: Steps, near: pd.DataFrame, limits: Constraints
) -> Iterator[pd.DataFrame]:
    """Yield a table of stretches that keep clear, but by less than the ground of the maps' cells may be off.

    Take-off, landing and steps straight up or down do not count as near the ground.

    Args:
      flight: whose ground it is.
      steps: some of its steps.
      near: the steps in and near buildings (`contacts`).
      limits: the clearances.
    """
    if flight.ground.is_exact:
        return
    off_m = flight.ground.off_m[tuple(steps.cell.T)]
    least_m = limits.vertical_m - FILE_MARGIN_M
    spare_m = np.minimum(near["gap_m"] - least_m, near["spare_m"])
    is_open = (spare_m >= 0) & (spare_m < off_m[near["step"]])
    is_low = (steps.z_m.min(axis=1) < off_m) & ~flight.is_on_site(steps)
    is_low[near.loc[is_open, "step"].to_numpy(int)] = True
    most_m = off_m[is_low].max(initial=0.0)
    reason = (
        f"lie nearer to roofs or the ground than the ground is known, by up to {most_m:.1f} m: "
        "name the files of the maps (sources, --sources)"
    )
    yield spans(steps.along_m[is_low], "ground", reason)


def _guessed(near: pd.DataFrame, buildings: Prisms) -> Iterator[pd.DataFrame]:
    """Yield, for each kind of what is of guessed height, tables of the stretches that may meet it, likely or not.

    Args:
      near: the steps in and near buildings (`contacts`).
      buildings: that they are near.
    """
    rows = near[near["spare_m"] <= 0]
    is_above_likely = (rows["likely_spare_m"] > 0).to_numpy()
    parts: Any = rows.groupby([buildings.kind[rows["prism"]], is_above_likely])
    for (kind, is_above), part in parts:
        reach = reach_said(buildings.limit_m[part["prism"]].max())
        words = LIKELY_ROOFS if is_above else UNKNOWN_ROOFS
        yield part[SPAN].assign(kind="roof", reason=words.format(kind=kind, reach=reach))


def below_home(flight: Flight, buildings: Prisms) -> np.ndarray:
    """Return ``[B]`` bool: the known and guessed roofs that a home above the ground is on, if it is."""
    mission = flight.mission
    if mission.home is None or not mission.home_above_ground_m:
        return np.zeros(len(buildings.polygons), bool)
    home = shapely.Point(flight.ground.maps.grid.xy_of_lonlat(*mission.home))
    return shapely.intersects(buildings.polygons, home) & np.isfinite(buildings.top_m)


def _at_corners(flight: Flight, buildings: Prisms, limits: Constraints) -> Iterator[pd.DataFrame]:
    """Yield tables of the corners whose inside, which autopilots may fly over, comes too near to a building or a zone.

    Args:
      flight: whose corners they are (`corners_of`).
      buildings: that stand there.
      limits: the clearances and zones.
    """
    corners = corners_of(flight)
    ground = flight.ground
    near = contacts(corners, buildings, ground, limits.horizontal_m)
    is_close = (near["gap_m"] < limits.vertical_m - FILE_MARGIN_M) | (near["spare_m"] <= 0)
    rows = pd.concat([near[is_close], _in_zones(corners, ground, limits.zones)])
    legs = [flight.mission.legs[leg] for leg in np.unique(corners.leg[rows["step"].to_numpy(int)])]
    reason = CUT.format(listed([str(leg.item) for leg in legs]))
    yield rows[SPAN].assign(kind="corner", reason=reason)


def _beyond(
    flight: Flight, steps: Steps, known: shapely.Geometry, horizontal_m: float
) -> Iterator[pd.DataFrame]:
    """Yield tables of stretches (`spans`) beyond what is known: in plan, below and above the maps' altitudes.

    Take-off, landing and steps straight up or down do not count as below the maps, as they lead between the ground and
    the height of flight.

    Args:
      flight: the mission over the maps.
      steps: those of its steps that have data.
      known: the area in which all buildings are known, in the maps' CRS.
      horizontal_m: the clearance.
    """
    judged_area = shapely.buffer(known, -horizontal_m) if horizontal_m else known
    shapely.prepare(judged_area)
    is_off = ~shapely.intersects_xy(judged_area, *steps.ends_m.mean(axis=1).T)
    yield spans(steps.along_m[is_off], "city", NO_CITY)

    is_on_site = flight.is_on_site(steps)
    z_m = steps.z_m.mean(axis=1)
    altitudes_m = flight.ground.maps.altitudes_m
    low_m = min(altitudes_m)
    high_m = max(altitudes_m)
    is_below = (z_m < low_m - GROUND_TOLERANCE_M) & ~is_on_site
    is_above = z_m > high_m + GROUND_TOLERANCE_M
    below = f"lie below the maps, which begin at {low_m:g} m"
    above = f"lie above the maps, which reach to {high_m:g} m"
    yield spans(steps.along_m[is_below], "altitude", below)
    yield spans(steps.along_m[is_above], "altitude", above)


def _buried(steps: Steps) -> pd.DataFrame:
    """Return a row for each stretch of a mission below the ground, with its greatest depth (``by_m``)."""
    z_m = steps.z_m.min(axis=1)
    deep = np.flatnonzero(z_m < -FILE_MARGIN_M)
    stretches = merged(steps.table(deep, gap_m=z_m[deep]))
    texts = [f"lies up to {-gap_m:.1f} m below the ground" for gap_m in stretches["gap_m"]]
    return stretches.assign(kind="terrain", what=texts, by_m=-stretches["gap_m"])


def _floors_m(
    steps: Steps, maps: MetricMaps, limits: Constraints, times: Sequence[str | None]
) -> np.ndarray:
    """Return ``[P]`` the GPS floor below each step, the highest of the times; 0 where it is not asked for."""
    if not limits.above_gps_floor:
        return np.zeros(len(steps.leg))
    floors_m = [gps_floor_m(maps, time)[tuple(steps.cell.T)] for time in times]
    return np.max(floors_m, axis=0)


def _closed(
    steps: Steps,
    floor_m: np.ndarray,
    maps: MetricMaps,
    limits: Constraints,
    times: Sequence[str | None],
    time_of_day: str | None,
) -> Iterator[pd.DataFrame]:
    """Yield, for each bound, each layer of the user and the GPS floor, a table of the stretches that it closes.

    A bound closes cells where it is not kept, a layer those where it has no value. A step at an altitude of the maps is
    judged there. One between two altitudes is judged at their middle, where a bound must hold at both. One beyond all
    altitudes is judged at the middle of the two that are nearest to it.

    Args:
      steps: of the mission.
      floor_m: the GPS floor below each (`_floors_m`).
      maps: on which the bounds are.
      limits: whose bounds count.
      times, time_of_day: of the maps; a bound must be kept at each of the times.
    """
    levels_m = sorted(maps.altitudes_m)
    middles_m = [sum(pair) / 2 for pair in pairwise(levels_m)] or levels_m
    step_m = steps.z_m.mean(axis=1)
    level_below = np.searchsorted(levels_m, step_m, side="right") - 1
    middle_m = np.array(middles_m)[np.clip(level_below, 0, len(middles_m) - 1)]
    nearest_m = nearest_level_m(step_m, levels_m)
    is_on_level = np.abs(steps.z_m - nearest_m[:, None]).max(axis=1) < LEVEL_M
    judged_at_m = np.where(is_on_level, nearest_m, middle_m)

    bounds = {f"do not keep {bound}": bound for bound in limits.bounds}
    for name in maps.metrics:
        if "layer" in maps.ds[maps.variable(name)].attrs:
            # Every value keeps this bound, so that only missing ones do not.
            bounds[f"have no value of {name}"] = Bound(name, ">=", 0.0)
    for fault, bound in bounds.items():
        is_closed = np.zeros(len(judged_at_m), bool)
        for z_m, time in product(np.unique(judged_at_m).tolist(), times):
            is_here = judged_at_m == z_m
            is_kept = bound.is_kept(maps, z_m, time, time_of_day)
            is_closed[is_here] |= ~is_kept[tuple(steps.cell[is_here].T)]
        stretches = merged(steps.table(np.flatnonzero(is_closed)))
        yield stretches.assign(kind="closed", what=f"enters cells that {fault}")

    # The GPS floor is exact in height, and so is the mission, but for what files round.
    if limits.above_gps_floor:
        lowest_m = np.where(is_on_level, nearest_m, steps.z_m.min(axis=1)) + FILE_MARGIN_M
        below = np.flatnonzero(~(floor_m <= lowest_m))
        stretches = steps.table(below, gap_m=-floor_m[below], apart_m=lowest_m[below])
        for is_there, rows in stretches.groupby(np.isfinite(stretches["gap_m"])):
            rows = merged(rows)
            words = BELOW_FLOOR if is_there else NO_FLOOR
            what = [words.format(-gap_m) for gap_m in rows["gap_m"]]
            by_m = -rows["gap_m"] - rows["apart_m"] if is_there else np.nan
            yield rows.assign(kind="closed", what=what, by_m=by_m)


def _buildings(near: pd.DataFrame, buildings: Prisms, limits: Constraints) -> list[pd.DataFrame]:
    """Return the stretches of a mission in buildings, over or under them, and beside them: a table of each.

    Over, under or beside a building only what is nearer than the clearances is returned, and not what belongs to a hit:
    coming to what it hits, and leaving it, a mission is near that and what stands around.

    Args:
      near: the mission's steps in and near buildings, as `contacts` returns them.
      buildings: that they are near.
      limits: the clearances. `FILE_MARGIN_M` less is still kept.
    """
    # Contacts that count, which are joined by kind. Beside a building the height over it means nothing, so that it is
    # NaN.
    near = near.assign(kind=pd.factorize(buildings.kind[near["prism"]])[0])
    is_over = near["apart_m"] == 0
    is_close = near["gap_m"] < limits.vertical_m - FILE_MARGIN_M
    is_close &= is_over | (near["apart_m"] < limits.horizontal_m - FILE_MARGIN_M)
    over_gap_m = near["gap_m"].where(is_over)
    is_hit = over_gap_m <= 0
    close = merged(near.assign(gap_m=over_gap_m)[is_hit | is_close], "prism")

    # A stretch belongs to a hit, and is left out, if it ends within the last stretch of hits that begins before it. A
    # stretch that begins before all hits gets the place -1, the end of -inf that is appended, and so is kept.
    of_hits = merged(close.loc[close["gap_m"] <= 0, SPAN])
    place = np.searchsorted(of_hits["from_m"] - TOUCH_M, close["from_m"], side="right") - 1
    close = close[close["to_m"] > np.append(of_hits["to_m"] + TOUCH_M, -np.inf)[place]]

    hits = merged(near[is_hit], "kind")
    over = merged(close[close["gap_m"] > 0], "kind")
    beside = merged(close[close["gap_m"].isna()], "kind")
    over_text = "passes {:.1f} m over or under a {}"
    beside_text = "passes {:.1f} m beside a {}"
    return [
        _described(
            hits, buildings, "flies {where} a {1}, up to {0:.1f} m below its {top}", -hits["gap_m"]
        ),
        _described(over, buildings, over_text, over["gap_m"], limits.vertical_m),
        _described(beside, buildings, beside_text, beside["apart_m"], limits.horizontal_m),
    ]


def _described(
    rows: pd.DataFrame, buildings: Prisms, text: str, metres: pd.Series, asked_m: float = 0.0
) -> pd.DataFrame:
    """Return stretches in or near buildings with the columns of findings added.

    Args:
      rows: the stretches; ``prism`` is the number of the building.
      buildings: that the numbers are of.
      text: what happens, with places for the metres and the kind.
      metres: of each row, inside a building or apart from it.
      asked_m: the clearance from which ``by_m`` counts: what the metres are short of it, or 0 for what is inside.
    """
    prism = rows["prism"].to_numpy(int)
    is_guessed = buildings.is_guessed[prism]
    kinds = buildings.kind[prism]
    top_m = buildings.top_m[prism]
    tops = np.where(np.isfinite(buildings.floor_m[prism]), "top or above its underside", "top")
    endings = np.where(is_guessed, " of guessed height", "")
    what = []
    for apart_m, kind, height_m, top, ending in zip(
        metres, kinds, top_m, tops, endings, strict=True
    ):
        is_wire = kind in WIRES  # a curtain from the ground up
        where = "below or beside" if is_wire else "through"
        sentence = text.format(apart_m, kind, where=where, top=top) + ending
        if is_wire:
            sentence += f", whose height is taken as {height_m:.1f} m"
        what.append(sentence)
    return rows.assign(
        what=what,
        is_guessed=is_guessed,
        kind="building",
        by_m=(asked_m - metres).abs(),
        building_m=top_m,
    )


def _in_zones(steps: Steps, ground: Elevation, zones: Sequence[Zone]) -> pd.DataFrame:
    """Return a row for each step in each no-fly zone (`contacts`)."""
    rows = contacts(steps, _zones_of(ground, zones), ground)
    return rows[rows["gap_m"] <= 0]


def _zones_of(ground: Elevation, zones: Sequence[Zone]) -> Prisms:
    """Return no-fly zones as prisms of known heights."""
    limit_m = np.full(len(zones), -np.inf)
    return Prisms(
        polygons=np.array([zone.on(ground.maps.grid) for zone in zones], object),
        floor_m=np.array([zone.floor_m for zone in zones], float),
        top_m=np.array([zone.ceiling_m for zone in zones], float),
        limit_m=limit_m,
        likely_m=limit_m,
        kind=np.full(len(zones), "zone", object),
    )


def _zones(steps: Steps, ground: Elevation, zones: Sequence[Zone], ceiling_m: int) -> pd.DataFrame:
    """Return a row for each stretch of a mission in a no-fly zone, which says how it is passed up to a ceiling."""
    rows = merged(_in_zones(steps, ground, zones), "prism")
    entered = [zones[number] for number in rows["prism"]]
    what = [
        f"enters the no-fly zone {zone.label}, {zone.heights_past(ceiling_m)}" for zone in entered
    ]
    return rows.assign(kind="zone", what=what)
