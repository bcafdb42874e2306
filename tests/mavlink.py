"""Missions as MAVSDK reads them: a ground station and an autopilot of this process, over UDP on this machine alone."""

import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.mission_raw import MissionRaw

RELATIVE_TO_HOME = 3  # MAV_FRAME_GLOBAL_RELATIVE_ALT
DISCOVERY_S = 20.0


class Reader:
    """MAVSDK's reader of missions."""

    def __init__(self, missions: MissionRaw) -> None:
        self.missions = missions

    def read(self, file: Path) -> tuple[list[int], np.ndarray]:
        """Return commands, and longitude, latitude, height above home ``[W, 3]``; check that nothing else is there."""
        read = self.missions.import_qgroundcontrol_mission(str(file))
        assert (read.geofence_items, read.rally_items) == ([], [])
        items = read.mission_items
        assert [item.seq for item in items] == list(range(len(items)))
        assert {item.frame for item in items} == {RELATIVE_TO_HOME}
        return [item.command for item in items], np.array([[item.y / 1e7, item.x / 1e7, item.z] for item in items])


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
