"""Protection maps of a district against sidereon, a call a choice of satellites.

Tokyo, all of the file at 5 m (2.7 million cells), GPS and Galileo, one altitude. Visibility is made beforehand and not
counted. Where the file is missing, the synthetic city in the box of Lower Manhattan under nominal orbits.
"""

from dataclasses import replace

import numpy as np

from benchmarks.common import Row, clocked, in_turn
from benchmarks.scenes import MASK_DEG, SYNTHETIC, TOKYO, Place, Scene, load_place
from benchmarks.sidereon_peer import Peer
from jaxurban.maps.build import view_sky
from jaxurban.maps.params import MapParams
from jaxurban.maps.task import MapTask
from jaxurban.metrics.gps import Gps
from jaxurban.metrics.protection import (
    IntegritySupport,
    Protection,
    levels_of_satellites,
    protection_maps,
    ranging_of,
)
from jaxurban.metrics.visibility import distinct_choices, visibility
from jaxurban.world.sky import InView

DISTRICT = replace(TOKYO, name="Tokyo", bounds=(139.680, 35.655, 139.785, 35.720))
GALILEO = TOKYO.orbits.with_name("galileo_2018-12-19.tle")
ALTITUDE_M, RESOLUTION_M = 20.0, 5.0
PARAMS = Protection()
ISD = IntegritySupport()
NEAR_M = (
    1000.0  # levels beyond are those of satellites that all but leave the position undetermined
)


def views(
    place: Place, altitude_m: float, resolution_m: float, times: list[str]
) -> tuple[np.ndarray, list[tuple[np.ndarray, InView]]]:
    """Return ``[y, x]`` obstacles of a place, and at each time the words ``[W, y, x]`` and the satellites."""
    scene = load_place(place)
    region = scene.region(resolution_m)
    orbits: str | list = "nominal" if place.buildings is None else [place.orbits]
    if place.orbits == TOKYO.orbits and place.buildings is not None:
        orbits = [place.orbits, GALILEO]
    sky = view_sky(
        region, Gps(orbits=orbits, times=times, mask_deg=MASK_DEG, reference=place.reference)
    )
    task = MapTask(
        scene.city,
        region,
        sky,
        MapParams(altitudes_m=(altitude_m,), sections={"gps": Gps(mask_deg=MASK_DEG)}),
    )
    surface = task.surface()
    is_obstacle = np.asarray(surface.crop(surface.roof_m)) >= altitude_m
    words = (
        np.asarray(visibility(surface, *task.in_view(t).angles, [altitude_m]))[:, 0]
        for t in range(len(times))
    )
    return is_obstacle, [(of_time, task.in_view(t)) for t, of_time in enumerate(words)]


def measure(_: Scene, num_runs: int) -> list[Row]:
    """Return the row of the protection maps; its note says how many patterns there are, and how far levels differ."""
    place = DISTRICT if DISTRICT.is_here else SYNTHETIC
    is_obstacle, [(words, in_view)] = views(place, ALTITUDE_M, RESOLUTION_M, [place.time])
    patterns, _ = distinct_choices(words, is_obstacle)
    peer = Peer(ranging_of(in_view, ISD), in_view.systems, ISD.budget)
    sides = {
        "ours": clocked(lambda: protection_maps(words, is_obstacle, in_view, PARAMS)),
        "levels": clocked(lambda: levels_of_satellites(in_view, ISD, patterns)),
        "sidereon": clocked(lambda: peer.levels(patterns)),
    }
    times = in_turn(sides, num_runs)
    ours, theirs = levels_of_satellites(in_view, ISD, patterns), peer.levels(patterns)
    is_near = np.isfinite(theirs) & (theirs < NEAR_M)
    apart_m = np.abs(ours[is_near] - theirs[is_near]).max()
    num_other = int((np.isfinite(ours) != np.isfinite(theirs)).any(axis=0).sum())
    num, share = patterns.shape[1], np.isfinite(theirs[0]).mean()
    note = (
        f"{place.name} at {ALTITUDE_M:g} m: {is_obstacle.size:,} cells, {len(in_view.systems)} satellites, {num:,} "
        f"patterns, {share:.0%} with levels; levels below {NEAR_M:g} m differ by {apart_m:.0e} m at most, {num_other} "
        f"patterns have levels in one alone; the maps take {times['ours'].median_cpu_s:.2f} CPU s"
    )
    levels = times["levels"], times["sidereon"]
    return [Row("protection levels", "sidereon", "patterns", num, num, *levels, note=note)]
