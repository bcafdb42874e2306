"""How long the viewer takes: the first picture, routes under new weights, bytes sent, memory of the server.

usage: python -m benchmarks.viewer DIR [--pairs 20] [--json FILE]

The server runs in a process of its own, as `jaxurban view` starts it, and is asked as its page asks it. Times are of
the wall at the page's side; the server's own CPU seconds stand beside them, since other work on the machine counts in
the one and hardly in the other.
"""

import http.client
import json
import re
import subprocess
import sys
import time
from argparse import ArgumentParser
from pathlib import Path

import numpy as np
import psutil
from scipy.ndimage import label

from jaxurban.maps.metric_maps import MetricMaps, open_maps
from jaxurban.viewer.tiles import TILE, strides_of

CANVAS = (980, 720)  # pixels of the map at 1280 x 720


class Page:
    """Asks a server as the page does, and counts bytes, seconds and the server's CPU seconds."""

    def __init__(self, address: str, server: psutil.Process) -> None:
        self.connection = http.client.HTTPConnection(address)
        self.server, self.address, self.num_bytes = server, address, 0

    def ask(self, name: str, params: dict) -> tuple[bytes, float, float]:
        """Return the answer, wall seconds and CPU seconds of the server."""
        cpu_s, begin_s = sum(self.server.cpu_times()[:2]), time.perf_counter()
        headers = {"Content-Type": "application/json", "Host": self.address}
        self.connection.request("POST", f"/ask/{name}", json.dumps(params), headers)
        reply = self.connection.getresponse()
        body = reply.read()
        assert reply.status == 200, body
        self.num_bytes += len(body)
        return body, time.perf_counter() - begin_s, sum(self.server.cpu_times()[:2]) - cpu_s


def first_picture(page: Page, shape: tuple[int, int]) -> tuple[float, float, int]:
    """Return wall and CPU seconds, and bytes, until all that the first picture needs has arrived."""
    num_bytes, seconds = page.num_bytes, np.zeros(2)
    seconds += page.ask("scene", {})[1:]
    shown = {"layer": "gps", "at": [0, 0, 0], "minus": None}
    seconds += page.ask("legend", shown)[1:]
    scale = 1.06 * max(shape[0] / CANVAS[1], shape[1] / CANVAS[0])  # cells a pixel
    strides = strides_of(shape)
    for stride in {strides[-1], max([each for each in strides if each <= scale * 1.01], default=1)}:
        for row in range(-(-shape[0] // (stride * TILE))):
            for col in range(-(-shape[1] // (stride * TILE))):
                seconds += page.ask("tile", {**shown, "stride": stride, "row": row, "col": col})[1:]
    return *seconds.tolist(), page.num_bytes - num_bytes


def queries(maps: MetricMaps, num: int, seed: int = 18) -> list[dict]:
    """Return random pairs of joined free cells at the lowest altitude, each under weights of its own."""
    rng = np.random.default_rng(seed)
    parts = label(maps.is_free(maps.altitudes_m[0]))[0]
    cells = np.argwhere(parts == 1 + np.argmax(np.bincount(parts.ravel())[1:]))
    found = []
    for _ in range(num):
        ends = [np.round(maps.grid.lonlat_of_cell(*cells[k]), 7).tolist() for k in rng.integers(len(cells), size=2)]
        weights = {name: float(f"{10 ** rng.uniform(-1.5, 1.5):.3g}") for name in maps.metrics}
        found.append({"start": ends[0], "goal": ends[1], "at": [0, 0, 0], "weights": {"distance": 0.1, **weights}})
    return found


def summary(times: list[tuple[float, float]]) -> dict[str, float]:
    """Return median and worst of wall and CPU milliseconds."""
    wall, cpu = 1000 * np.array(times).T
    return {"median": np.median(wall), "worst": wall.max(), "median_cpu": np.median(cpu), "worst_cpu": cpu.max()}


def main() -> None:
    """Measure one folder of maps."""
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--pairs", type=int, default=20)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    maps = open_maps(given.folder)
    command = [sys.executable, "-m", "jaxurban", "view", str(given.folder), "--no-browser"]
    begin_s = time.perf_counter()
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as running:
        assert running.stderr is not None
        address = next(found[1] for line in running.stderr if (found := re.search(r"http://([\d.:]+)/", line)))
        start_s = time.perf_counter() - begin_s
        page = Page(address, psutil.Process(running.pid))
        wall_s, cpu_s, num_bytes = first_picture(page, maps.grid.shape)
        facts = {"cells": int(np.prod(maps.grid.shape)), "start_s": start_s, "picture_s": wall_s}
        facts |= {"picture_cpu_s": cpu_s, "picture_bytes": num_bytes}
        asked = queries(maps, given.pairs + 1)
        facts["cost_map_s"] = page.ask("plan", asked[0])[1]  # the altitude's first route makes its cost map
        facts["route"] = summary([page.ask("plan", each)[1:] for each in asked[1:]])
        facts["preview"] = summary([page.ask("coarse", each)[1:] for each in asked])
        facts["report"] = summary([page.ask("report", each)[1:] for each in asked[-5:]])
        facts |= {"bytes": page.num_bytes, "memory_mib": page.server.memory_info().rss / 2**20}
        facts["peak_mib"] = _peak_mib(running.pid)
        running.terminate()
    print(json.dumps(facts, indent=2))
    if given.json:
        given.json.write_text(json.dumps(facts, indent=2) + "\n", encoding="utf-8")


def _peak_mib(pid: int) -> float:
    """Return the largest resident memory of a process so far, from Linux."""
    found = re.search(r"VmHWM:\s+(\d+) kB", Path(f"/proc/{pid}/status").read_text(encoding="utf-8"))
    return int(found[1]) / 1024 if found else float("nan")


if __name__ == "__main__":
    main()
