"""What stands under keys of OpenStreetMap as its extracts have them, by their counts, and under values in no table.

Half of it is drawn by the counts, and half evenly, so that the seldom comes as well. What is higher than the file says,
or whose height it does not say, is as high as the bound of its kind allows; sizes in plan are the least that stands.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import shapely

from tests.cities.generator.plant import Draw, Prism, Record, edit, nothing

SHAPES = ("points", "lines", "areas")
COUNTS = pd.read_csv(Path(__file__).with_name("extracts.csv"), comment="#").melt(
    ["key", "value", "bound_m"], SHAPES, "shape", "num"
)
COUNTS = COUNTS[COUNTS["num"] > 0]
ROWS = [*COUNTS.itertuples(index=False)]
AREAS = [row for row in ROWS if row.shape == "areas"]
# Made up, and plausible: what no table may have.
IN_NO_ROW = {
    "man_made": ("lattice_arm", "light_column", "sky_frame", "stage_rig", "weather_spire"),
    "power": ("busbar_frame", "floating_pylon"),
    "aerialway": ("cargo_rope", "ropeway_bent"),
    "attraction": ("sky_swing",),
    "roller_coaster": ("lift_hill",),
    "historic": ("siege_tower", "war_column"),
    "barrier": ("glass_screen", "sound_wall"),
    "telecom": ("relay_arm",),
    "communication": ("dish_frame",),
    "pipeline": ("aerial_bent",),
    "bridge": ("catwalk_net",),
    "bridge:support": ("strut_frame",),
}
BOUNDS_M = {"attraction": 200.0, "roller_coaster": 200.0, "bridge": 22.0, "bridge:support": 350.0}
OTHER_BOUND_M = 50.0
HIGHEST_M = 150.0  # whatever the bound is, as flights stay low
LEAST_M = 6.5  # that is written: what is named nothing stands from 6 m on
LAYER_M = 12.0  # that the bound of a bridge grows by
RADII_M = {"tower": 2.0, "line": 5.0, "crane": 1.0}
THIN_M = 0.3
REACH_M = 30.0  # beside all that something may be taken to fill
JIB_M = 80.0
RINGS = ("barrier", "pipeline")  # keys of closed ways that are lines
WIRES = ("line", "minor_line", "wire")
WIRE_M = 4.0  # from the lowest to the highest of them


FROM_EXTRACTS = ("of the extracts", "in no row", "area of the extracts", "area in no row")


@edit("tags", "points")
def of_the_extracts(draw):
    return counted(draw, ROWS)


@edit("tags")
def area_of_the_extracts(draw):
    return counted(draw, AREAS)


@edit("tags", "points")
def in_no_row(draw):
    return unlisted(draw, draw.one_of(*SHAPES))


@edit("tags")
def area_in_no_row(draw):
    return unlisted(draw, "areas")


def counted(draw: Draw, rows: Sequence[Any]) -> tuple[Any, ...]:
    """Return the fields of what one of some rows of the counts has."""
    counts = np.array([row.num for row in rows])
    weights = counts / counts.sum() if draw.one_of(True, False) else None
    row = rows[draw.rng.choice(len(rows), p=weights)]
    return thing(draw, row.key, row.value, row.shape, row.bound_m)


def unlisted(draw: Draw, shape: str) -> tuple[Any, ...]:
    """Return the fields of something as a shape that no table knows."""
    key, value = draw.one_of(*((key, value) for key in IN_NO_ROW for value in IN_NO_ROW[key]))
    return thing(draw, key, value, shape, BOUNDS_M.get(key, OTHER_BOUND_M))


def thing(draw: Draw, key: str, value: str, shape: str, bound_m: float) -> tuple[Any, ...]:
    """Return the fields of a thing under a key, whose height is written or not."""
    tags = {key: value}
    drawn, core = outlines(draw, shape, RADII_M.get(value, THIN_M))
    if key == "bridge":
        layer = draw.one_of(1, 1, 2)
        tags |= {"highway": draw.one_of("footway", "primary"), "layer": str(layer)}
        bound_m += LAYER_M * (layer - 1)
    if key in RINGS and shape == "areas":
        core = drawn.boundary.buffer(THIN_M)
    may_say = bound_m > 0 or key == "barrier"
    is_said = may_say and draw.one_of(True, False, False)
    if not is_said and not bound_m:
        return nothing(Record(drawn, tags))

    top_m = draw.uniform(LEAST_M if is_said else 2.0, min(bound_m or 20.0, HIGHEST_M))
    if is_said:
        tags["height"] = f"{top_m:g}"
    floor_m = top_m - WIRE_M if value in WIRES and shape == "lines" else -math.inf
    reach_m = (JIB_M if value in ("crane", "mast") else REACH_M) + top_m / 2
    is_known = is_said and "bridge" not in key
    hull = Prism(drawn.buffer(reach_m), top_m if is_known else math.inf)
    return (Record(drawn, tags),), (Prism(core, top_m, floor_m),), (hull,), is_known


def outlines(draw: Draw, shape: str, radius_m: float) -> tuple[shapely.Geometry, shapely.Polygon]:
    """Return a shape in the slot, and what of it surely stands."""
    if shape == "areas":
        outline = draw.box(4, 16)
        return outline, outline
    drawn = shapely.Point(0, 0)
    if shape == "lines":
        half_m, bend_m = draw.uniform(8, 24), draw.one_of(0.0, draw.uniform(-6, 6))
        drawn = shapely.LineString([(-half_m, 0), (0, bend_m), (half_m, 0)])
    drawn = draw.placed(drawn)
    return drawn, drawn.buffer(radius_m)
