"""What one receiver clock a system changes against one for all, over a district of Tokyo: the table of docs/clocks.md.

Run as ``python -m benchmarks.clocks``, with the data at hand (JAXURBAN_DATA).
"""

import os
import re
from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np

import jaxurban as ju
from benchmarks.common import ROOT
from jaxurban.maps.build import view_sky
from jaxurban.maps.task import MapParams, MapTask
from jaxurban.metrics.gps import GpsParams, SatelliteSet
from jaxurban.metrics.obstacle import obstacle_mask
from jaxurban.metrics.visibility import visibility

BOUNDS = (139.690, 35.684, 139.712, 35.700)  # Shinjuku, the station in the middle
TIME, MASK_DEG, RESOLUTION_M = "2018-12-19T06:25:00Z", 10.0, 5.0
ALTITUDES_M = (2.0, 20.0, 60.0, 122.0)
SYSTEMS = ("gps", "galileo")
PAGE = ROOT / "docs" / "clocks.md"
TABLE = re.compile(r"(?:^\|.*\n)+", re.MULTILINE)
COLUMNS = ("altitude, m", "satellites", "clocks", "GDOP: median", "95th percentile", "undetermined", "mean m_gps")


def sky_task(folder: Path) -> MapTask:
    """Return the district under the two systems."""
    city = ju.City.from_files(folder / "tokyo-central-lod2.parquet", bounds=BOUNDS)
    grid = ju.Grid.from_bounds(BOUNDS, RESOLUTION_M, city.crs)
    orbits = [folder / f"{system}_2018-12-19.tle" for system in SYSTEMS]
    sky = view_sky(grid, orbits, [TIME], mask_deg=MASK_DEG, reference=None, max_age_days=90)
    return MapTask(city, grid, sky, MapParams(altitudes_m=ALTITUDES_M, mask_deg=MASK_DEG))


def rows(task: MapTask) -> list[tuple[str, ...]]:
    """Return the table's rows, by altitude and kind of clocks."""
    surface = task.surface()
    words = visibility(surface, *task.angles(0), ALTITUDES_M)
    is_obstacle = obstacle_mask(jnp.asarray(surface.crop(surface.roof_m)), ALTITUDES_M)
    found = []
    kinds = {"one": GpsParams(clocks="one"), "one a system": GpsParams()}
    made = {}
    for kind, params in kinds.items():
        of_kind = replace(task, params=replace(task.params, gps=params))
        made[kind] = SatelliteSet.of(*of_kind.angles(0), params, of_kind.clocks(0)).maps(words, is_obstacle)
    for a, altitude_m in enumerate(ALTITUDES_M):
        is_free = ~np.asarray(is_obstacle[a])
        for kind, maps in made.items():
            gdop, m, num = (np.asarray(values[a])[is_free] for values in (maps.gdop, maps.m, maps.num_visible))
            ends = [float(np.quantile(gdop, share, method="higher")) for share in (0.5, 0.95)]
            found.append(
                (
                    f"{altitude_m:g}",
                    f"{num.mean():.1f}",
                    kind,
                    *(f"{end:.2f}" if np.isfinite(end) else "∞" for end in ends),
                    f"{np.mean(np.isinf(gdop)):.1%}",
                    f"{m.mean():.3f}",
                )
            )
    return found


def table(task: MapTask) -> str:
    """Return the table in Markdown."""
    lines = ["| " + " | ".join(row) + " |" for row in (COLUMNS, ("---",) * len(COLUMNS), *rows(task))]
    return "\n".join(lines) + "\n"


def main() -> None:
    folder = Path(os.environ.get("JAXURBAN_DATA", ROOT.parent / "shared" / "data")) / "tokyo"
    drawn = TABLE.sub(lambda _: table(sky_task(folder)), PAGE.read_text(encoding="utf-8"))
    PAGE.write_text(drawn, encoding="utf-8")


if __name__ == "__main__":
    main()
