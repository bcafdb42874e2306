"""The corners of a mission as autopilots cut them: chords inside of each corner at which they do not stop."""

from collections.abc import Sequence

import numpy as np

from jaxurban.flights.legs import Flight
from jaxurban.flights.missions.parts import Leg, Place
from jaxurban.paths.steps import Steps, between

MOST_CUT_M = 10.0  # before and after a slight corner, if the vehicle does not turn farther from it
# Shares of what is cut: chords so far from the corner stand for the area within.
SHARES = np.array([1 / 3, 2 / 3, 1.0])
STRAIGHT_RAD = np.radians(1.0)  # less is no corner
NO_LEG = -1
FLOWN_ON = ("leg", "jump")  # kinds of legs between which a corner may be cut


def corners_of(flight: Flight) -> Steps:
    """Return chords inside of the corners of a mission, as steps: three of each corner.

    A chord joins the two legs at equal distances from the corner; the last is as far from it as the vehicle turns, but
    begins and ends no more than `MOST_CUT_M` or half a leg away. Its heights are those of the legs there. Its leg
    is the one that leads to the corner.
    """
    steps = flight.steps
    at = _steps_at_corners(flight.mission.legs, steps)
    over_m = steps.over_m
    came, goes = (steps.ends_m[at, 1] - steps.ends_m[at, 0]) / over_m[at][..., None]
    bend = np.linalg.norm(goes - came, axis=1)  # twice the sine of half the turn
    is_corner = bend >= STRAIGHT_RAD
    at = at[:, is_corner]
    before, after = at

    # How far from the corner each chord begins and ends.
    half_m = np.bincount(steps.leg, over_m)[steps.leg[at]].min(axis=0) / 2
    turn_m = np.array([leg.turn_m for leg in flight.mission.legs])[steps.leg[before]]
    most_m = np.minimum(half_m, np.maximum(turn_m, MOST_CUT_M))
    cut_m = np.minimum(2 * turn_m / bend[is_corner], most_m)
    back_m = cut_m[:, None] * SHARES

    states = np.dstack([steps.ends_m, steps.z_m])
    begin = between(states[before], 1.0 - back_m / over_m[before, None])
    end = between(states[after], back_m / over_m[after, None])
    chords = np.stack([begin, end], axis=2).reshape(-1, 2, 3)
    corners = steps.take(np.repeat(after, len(SHARES)))
    return corners._replace(
        ends_m=chords[..., :2],
        z_m=chords[..., 2],
        ground_m=flight.ground.at(chords[..., :2]),
        leg=steps.leg[np.repeat(before, len(SHARES))],
        along_m=corners.along_m[:, :1] + back_m.reshape(-1, 1) * [-1, 1],
    )


def _steps_at_corners(legs: Sequence[Leg], steps: Steps) -> np.ndarray:
    """Return ``[2, C]`` the last step of the leg before each corner, and the first of the leg after it.

    Args:
      legs: of the mission.
      steps: of these legs, in their order; legs of which there are none have no corners.
    """
    arrived: dict[Place, int] = {}  # the last leg that ends at a place
    departs: dict[Place, int] = {}  # the first that begins there
    pairs = []
    for number, leg in enumerate(legs):
        if leg.is_variant:
            continue
        pairs.append((arrived.get(leg.start, NO_LEG), number))
        departs.setdefault(leg.start, number)
        arrived[leg.start if leg.kind == "loiter" else leg.end] = number
    # Where a jump leads, the mission goes on as it did before.
    pairs += [
        (number, departs.get(leg.end, NO_LEG))
        for number, leg in enumerate(legs)
        if leg.kind == "jump"
    ]

    moving = np.unique(steps.leg[steps.over_m > 0]).tolist()
    flown_on = {number for number in moving if legs[number].kind in FLOWN_ON}
    corners = [pair for pair in pairs if {*pair} <= flown_on and legs[pair[0]].turn_m > 0]
    before, after = np.array(corners, int).reshape(-1, 2).T
    last = np.searchsorted(steps.leg, before, side="right") - 1
    return np.stack([last, np.searchsorted(steps.leg, after)])
