"""The corners of a mission as autopilots cut them: chords inside of each corner at which they do not stop."""

from collections.abc import Sequence

import numpy as np

from jaxurban.io.read.mission import Leg, Place
from jaxurban.paths.legs import Flight, Steps

# How near to a waypoint autopilots turn: by default WPNAV_RADIUS of ArduPilot's multicopters, and NAV_ACC_RAD of PX4's.
CORNER_M = 2.0
MOST_CUT_M = 10.0  # before and after a slight corner
SHARES = (
    1 / 3,
    2 / 3,
    1.0,
)  # of what is cut: chords so far from the corner stand for the area within
STRAIGHT_RAD = np.radians(1.0)  # less is no corner
FLOWN_ON = ("leg", "jump")  # kinds of legs between which a corner may be cut


def corners_of(flight: Flight) -> Steps:
    """Return chords inside of the corners of a mission, as steps: three of each corner.

    A chord joins the two legs at equal distances from the corner; the last is `CORNER_M` from it, but begins and ends
    no more than `MOST_CUT_M` or half a leg away. Its heights are those of the legs there.
    """
    steps = flight.steps
    before, after = _steps_at_corners(flight.mission.legs, steps)
    ways_m = steps.ends_m[:, 1] - steps.ends_m[:, 0]
    over_m = steps.over_m
    is_corner = (over_m[before] > 0) & (over_m[after] > 0)
    before, after = before[is_corner], after[is_corner]
    came, goes = (ways_m[step] / over_m[step][:, None] for step in (before, after))
    turn_rad = np.arccos(np.clip((came * goes).sum(axis=1), -1.0, 1.0))

    # How far from the corner the last chord begins.
    leg_m = np.bincount(steps.leg, over_m)
    half_m = np.minimum(leg_m[steps.leg[before]], leg_m[steps.leg[after]]) / 2
    cut_m = CORNER_M / np.sin(np.maximum(turn_rad, STRAIGHT_RAD) / 2)
    cut_m = np.minimum(cut_m, np.minimum(half_m, MOST_CUT_M))
    cut_m[turn_rad < STRAIGHT_RAD] = 0.0

    chords = []
    climb = (steps.z_m[:, 1] - steps.z_m[:, 0]) / np.where(over_m > 0, over_m, 1.0)
    corner_m, corner_z_m = steps.ends_m[after, 0], steps.z_m[after, 0]
    for back_m in (share * cut_m for share in SHARES):
        begin_m = corner_m - back_m[:, None] * came
        end_m = corner_m + back_m[:, None] * goes
        z_m = [corner_z_m - back_m * climb[before], corner_z_m + back_m * climb[after]]
        along_m = steps.along_m[after, 0]
        ends_m = np.stack([begin_m, end_m], axis=1)
        values = (
            ends_m,
            np.stack(z_m, axis=1),
            flight.ground.at(ends_m),
            np.stack([along_m - back_m, along_m + back_m], axis=1),
            steps.leg[after],
            steps.cell[after],
        )
        chords.append(Steps(*values).take(back_m > 0))
    return Steps(*map(np.concatenate, zip(*chords, strict=True)))


def _steps_at_corners(legs: Sequence[Leg], steps: Steps) -> tuple[np.ndarray, np.ndarray]:
    """Return ``[C]`` the last step of the leg before each corner, and the first of the leg after it.

    Args:
      legs: of the mission.
      steps: of these legs, in their order; of some legs there may be none.
    """
    arrived: dict[Place, int] = {}  # the last leg that ends at a place
    departs: dict[Place, int] = {}  # the first that begins there
    pairs = []
    for number, leg in enumerate(legs):
        if leg.is_variant:
            continue
        pairs.append((arrived.get(leg.start, -1), number))
        departs.setdefault(leg.start, number)
        arrived[leg.start if leg.kind == "loiter" else leg.end] = number
    # Where a jump leads, the mission goes on as it did before.
    jumps = [number for number, leg in enumerate(legs) if leg.kind == "jump"]
    pairs += [(number, departs.get(legs[number].end, -1)) for number in jumps]

    is_flown_on = np.array([leg.kind in FLOWN_ON for leg in legs])
    stops = np.array([leg.has_stop for leg in legs])
    before, after = np.array(pairs, int).reshape(-1, 2).T
    is_cut = (before >= 0) & (after >= 0)
    is_cut &= is_flown_on[before] & is_flown_on[after] & ~stops[before]
    before, after = before[is_cut], after[is_cut]

    # Legs of which a step is missing at the corner are left out.
    last = np.full(len(legs), -1)
    last[steps.leg] = np.arange(len(steps.leg))
    first = np.full(len(legs), -1)
    first[steps.leg[::-1]] = np.arange(len(steps.leg))[::-1]
    has_steps = (last[before] >= 0) & (first[after] >= 0)
    return last[before[has_steps]], first[after[has_steps]]
