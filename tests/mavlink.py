"""Missions as MAVSDK reads them: a ground station and an autopilot of this process, over UDP on this machine alone."""

import json
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import zip_longest
from operator import attrgetter
from pathlib import Path

import numpy as np
from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.mission_raw import MissionItem, MissionRaw

RELATIVE_TO_HOME = 3  # MAV_FRAME_GLOBAL_RELATIVE_ALT
EXCLUSION = 5002  # MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION
DISCOVERY_S = 20.0
NUMBERS = attrgetter("param1", "param2", "param3", "param4", "z")


class Reader:
    """MAVSDK's reader of missions."""

    def __init__(self, missions: MissionRaw) -> None:
        self.missions = missions

    def read(self, file: Path) -> tuple[list[int], np.ndarray]:
        """Return commands, and longitude, latitude, height above home ``[W, 3]``, of a mission's places."""
        items = [item for item in self.items(file)[0] if item.frame == RELATIVE_TO_HOME]
        return [item.command for item in items], np.array(
            [[item.y / 1e7, item.x / 1e7, item.z] for item in items]
        )

    def items(self, file: Path) -> tuple[list[MissionItem], list[MissionItem]]:
        """Return the items of a mission and of its geofence; check their order, and that nothing else is there."""
        read = self.missions.import_qgroundcontrol_mission(str(file))
        assert read.rally_items == []
        for items in (read.mission_items, read.geofence_items):
            assert [item.seq for item in items] == list(range(len(items)))
        return read.mission_items, read.geofence_items

    def differences(self, file: Path) -> list[str]:
        """Return what MAVSDK reads otherwise than it was written: commands, frames, parameters, places, the geofence.

        Places are told to the seventh decimal of a degree, other numbers as 32-bit floats, as MAVLink carries them.
        """
        plan = json.loads(file.read_text())
        rings = [ring["polygon"] for ring in plan["geoFence"]["polygons"]]
        assert not any(ring["inclusion"] for ring in plan["geoFence"]["polygons"])
        wanted = [
            (item["command"], item["frame"], *_as_read(item)) for item in plan["mission"]["items"]
        ]
        wanted += [(EXCLUSION, len(ring), *_in_units(*corner)) for ring in rings for corner in ring]
        mission, fence = self.items(file)
        read = [
            (item.command, item.frame, item.x, item.y, *_floats(*NUMBERS(item))) for item in mission
        ]
        read += [(item.command, int(item.param1), item.x, item.y) for item in fence]
        pairs = zip_longest(read, wanted)
        return [
            f"{one} instead of {other}" for one, other in pairs if str(one) != str(other)
        ]  # NaN is NaN as text


def _as_read(item: dict) -> tuple:
    """Return a written item's place, its four parameters and its height as MAVLink carries them."""
    *params, lat, lon, z_m = item["params"]
    place = _in_units(lat, lon) if item["frame"] == RELATIVE_TO_HOME else (round(lat), round(lon))
    return (*place, *_floats(*params, z_m))


def _floats(*values: float | None) -> tuple[float, ...]:
    return tuple(float(np.float32(np.nan if value is None else value)) for value in values)


def _in_units(lat: float, lon: float) -> tuple[int, int]:
    return round(lat * 1e7), round(lon * 1e7)


@contextmanager
def mission_reader() -> Iterator[Reader]:
    """Yield MAVSDK's reader of missions; it reads only while it sees an autopilot, so one is made."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    station = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    autopilot = Mavsdk(Configuration.create_with_component_type(ComponentType.AUTOPILOT))
    try:
        station.add_any_connection(f"udpin://127.0.0.1:{port}")
        autopilot.add_any_connection(f"udpout://127.0.0.1:{port}")
        system = station.first_autopilot(DISCOVERY_S)
        assert system is not None, "MAVSDK's ground station does not see MAVSDK's autopilot"
        missions = MissionRaw(system)
        yield Reader(missions)
        missions.destroy()
    finally:
        station.destroy()
        autopilot.destroy()
