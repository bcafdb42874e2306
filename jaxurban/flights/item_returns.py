"""The least altitude at which a mission may return home from wherever it is, and what to say of it."""

import numpy as np
import pandas as pd
import shapely

from jaxurban.flights.autopilots import low_returns, parameter_texts, typed_m
from jaxurban.flights.contacts import Prisms
from jaxurban.flights.legs import NOWHERE_M, Flight
from jaxurban.kernels.line.homeward import highest_homeward
from jaxurban.kernels.tolerances import FILE_MARGIN_M
from jaxurban.paths.constraints import Constraints
from jaxurban.paths.elevation import Elevation
from jaxurban.paths.steps import Steps
from jaxurban.public import listed

OF_STRETCH = {  # of its steps
    "leg": "first",
    "apart_m": "min",
    "own_m": "min",
    "end_m": "last",
    "ground_m": "max",
}
MOST_STRETCHES = 1_000  # that a mission is cut into: those of long ones are longer than a cell
FANS_AT_ONCE = 500  # so that few pairs of them and outlines are held
BEYOND = (
    "No return up to the ceiling, {} m above the ground at home, clears all from the ways to {}, which need up "
    "to {:.0f} m: set a rally point there, or return along the way flown."
)
UNKNOWN = (
    "No return altitude is known from item {} on: a line home leaves what is known, comes nearer to its border than "
    "the clearance, or meets a roof that nothing bounds."
)


def departures_of(
    flight: Flight, buildings: Prisms, known: shapely.Geometry, limits: Constraints
) -> pd.DataFrame:
    """Return the least altitude at which a straight, level way home clears everything, from wherever a mission flies.

    It clears outlines that are no farther from the line in plan than the horizontal clearance, up to the bound of what
    is of guessed height, and the ground below the line, by the vertical clearance. What hangs in the air is passed
    above. Ground counts as the highest in each cell, also below what stands. No-fly zones and closed cells do not
    count, nor do the climb and the landing straight above home and the mission's own returns; a climb, descent or
    landing elsewhere does.

    Args:
      flight: the mission over the maps.
      buildings: what stands there.
      known: the area in which all buildings are known, in the maps' CRS.
      limits: the clearances.

    Returns:
      A row for each stretch of a leg over the maps, about a cell long, in the order flown: ``item``, to which it leads,
      ``apart_m`` (least distance from home), ``own_m`` (least height of the flight), ``end_m`` (its height at the
      end) and ``least_m`` (NaN where it is not known), all above home. No row without a home.
    """
    mission, ground = flight.mission, flight.ground
    grid = ground.maps.grid
    nothing = pd.DataFrame(columns=["item", "apart_m", "own_m", "end_m", "least_m"])
    if mission.home is None:
        return nothing
    home_m = np.nan_to_num(grid.xy_at(np.array(mission.home)), posinf=NOWHERE_M)
    steps = Steps(*map(np.concatenate, zip(flight.steps, flight.variants, strict=True)))
    is_return = np.array([leg.kind == "return" for leg in mission.legs], bool)[steps.leg]
    is_above_home = (steps.ends_m == home_m).all(axis=(1, 2))
    steps = steps.take(~is_above_home & ~is_return)
    if not len(steps.leg):
        return nothing
    zero_m = ground.at(home_m) + mission.home_above_ground_m
    high_m = _highest_ground_on_way(ground, home_m) - zero_m

    # Stretches, and the areas that their ways home pass.
    stretch_m = max(grid.resolution_m, steps.length_m.sum() / MOST_STRETCHES)
    state = np.column_stack([steps.leg, steps.along_m[:, 0] // stretch_m])
    stretch = np.cumsum(np.diff(state, axis=0, prepend=state[:1]).any(axis=1))
    corners_m = np.insert(steps.ends_m, 1, home_m, axis=1).reshape(-1, 2)
    fans = shapely.convex_hull(shapely.linestrings(corners_m, indices=np.repeat(stretch, 3)))
    own_m = steps.z_m + steps.ground_m - zero_m
    rows = pd.DataFrame(
        {
            "leg": steps.leg,
            "apart_m": np.linalg.norm(steps.ends_m - home_m, axis=2).min(axis=1),
            "own_m": own_m.min(axis=1),
            "end_m": own_m[:, 1],
            "ground_m": high_m[tuple(steps.cell.T)],
        }
    )
    table = rows.groupby(stretch).agg(OF_STRETCH)

    # The least altitude that clears what is there.
    clear_m = least_clear(fans, buildings, ground, known, limits) - zero_m
    least_m = (table.pop("ground_m") + limits.vertical_m).clip(lower=clear_m)
    items = [mission.legs[leg].item for leg in table["leg"]]
    table = table.assign(item=items, least_m=least_m.where(np.isfinite(least_m)))
    return table.sort_values("leg", kind="stable").drop(columns="leg")


def _highest_ground_on_way(ground: Elevation, home_m: np.ndarray) -> np.ndarray:
    """Return ``[Y, X]`` the highest ground on straight ways home from each cell; inf over cells without data."""
    grid = ground.maps.grid
    high_m = np.where(ground.maps.ds["has_data"].values, ground.highest_m, np.float32(np.inf))
    if not high_m.any():  # level ground, all of which is known
        return high_m
    col, row = ((home_m - grid.bounds_m[:2]) / grid.resolution_m).clip(0, grid.shape[::-1])
    return highest_homeward(high_m, (row, col))


def least_clear(
    areas: np.ndarray,
    buildings: Prisms,
    ground: Elevation,
    known: shapely.Geometry,
    limits: Constraints,
) -> np.ndarray:
    """Return the least elevation in areas that clears what stands there, ``[A]``; -inf where nothing does.

    It is inf where an area is missing, or leaves what is known or comes nearer to its border than the clearance.

    Args:
      areas: polygons or lines.
      buildings: what stands, up to the bound of what is of guessed height.
      ground: on which it stands; the highest in the cells of its bounding box counts.
      known: the area in which all buildings are known.
      limits: the clearances.
    """
    top_m = np.maximum(buildings.top_m, buildings.limit_m)
    if not ground.is_flat:
        grid = ground.maps.grid
        corners_m = shapely.bounds(buildings.polygons).reshape(-1, 2, 2) - grid.bounds_m[:2]
        corners = (
            (corners_m / grid.resolution_m).astype(int).clip(0, np.array(grid.shape)[::-1] - 1)
        )
        for number, ((west, south), (east, north)) in enumerate(corners):
            top_m[number] += ground.highest_m[south : north + 1, west : east + 1].max()
    tree = shapely.STRtree(buildings.polygons)
    highest_m = np.full(len(areas), -np.inf)
    for part in np.array_split(np.arange(len(areas)), len(areas) // FANS_AT_ONCE + 1):
        area, prism = tree.query(areas[part], "dwithin", distance=limits.horizontal_m)
        np.maximum.at(highest_m, part[area], top_m[prism])
    known = shapely.buffer(known, -limits.horizontal_m)
    shapely.prepare(known)
    highest_m[~shapely.covers(known, areas)] = np.inf
    return highest_m + max(limits.vertical_m, FILE_MARGIN_M)


def by_item(departures: pd.DataFrame) -> pd.DataFrame:
    """Return a row for each item that a mission flies to, from `departures_of`: that of the last stretch before it.

    ``way_m`` is the least altitude from wherever on the way to it, NaN where it is not known. Of a mission that two
    autopilots fly otherwise, with the departures of both, the rows are the second's, and ``way_m`` is of both.
    """
    way_m = departures.groupby("item")["least_m"].agg(lambda least_m: least_m.max(skipna=False))
    last = departures.drop_duplicates("item", keep="last")
    last = last.assign(own_m=last["end_m"], way_m=last["item"].map(way_m)).drop(columns="end_m")
    return last.reset_index(drop=True)


def return_lines(departures: pd.DataFrame, flight: Flight, ceiling_m: int) -> list[str]:
    """Return what to say of the altitudes at which a mission may return: of its own, the least, and what to type.

    Args:
      departures: the least altitudes (`departures_of`).
      flight: the mission, whose autopilot and return altitude count, over the maps.
      ceiling_m: above the ground at home. Places from which it takes more are named, with what else is possible, and
        what to type is for the others.
    """
    lines = []
    mission = flight.mission
    everywhere = departures
    unknown = departures["item"][departures["least_m"].isna()]
    has_gaps = mission.not_judged or len(flight.unknown) or len(unknown)
    cleared = "all that is judged" if has_gaps else "all"
    low = low_returns(departures, mission.autopilot, 0.0)
    beyond = low[low["least_m"].map(typed_m) > ceiling_m - mission.home_above_ground_m]
    if len(beyond):
        numbers = [*map(str, beyond["item"].unique())]
        noun = "item" if len(numbers) == 1 else "items"
        items = f"{noun} {listed(numbers)}"
        lines.append(BEYOND.format(ceiling_m, items, beyond["least_m"].max()))
        departures = departures.drop(beyond.index)
        low = low.drop(beyond.index)
        cleared += " from elsewhere"
    if len(low):
        altitude_m = mission.return_altitude_m
        failing = low_returns(departures, mission.autopilot, altitude_m)["item"]
        least_m = low["least_m"].max()
        fails = ""
        if len(failing):
            by_cone = "flown level, " if altitude_m >= least_m else ""
            fails = f"{altitude_m:g} m fails from item {failing.iloc[0]} on; {by_cone}"
        lines.append(f"A return at {fails}{typed_m(least_m)} m clears {cleared}.")
        parameters = parameter_texts(least_m, mission.autopilot, departures)
        lines += [f"{program}: {text}" for program, text in parameters.items()]
    elif departures["least_m"].notna().any():
        line = f"A return clears {cleared} at the height that the flight has, wherever it begins"
        named_m = mission.return_altitude_m
        if not np.isnan(named_m):
            failing = low_returns(everywhere, mission.autopilot, named_m)["item"]
            fails = f"fails from item {failing.iloc[0]} on" if len(failing) else "clears it too"
            line += f"; one at {named_m:g} m {fails}"
        lines.append(f"{line}.")
    return [*map(UNKNOWN.format, unknown[:1]), *lines]  # no number is read before a gap
