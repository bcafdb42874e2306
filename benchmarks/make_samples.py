"""Makes the sample cities from files of their sources: ``python -m benchmarks.make_samples [DATA]``.

DATA is the folder of these files, else ``JAXURBAN_DATA``, else ``../shared/data``. ``jaxurban/samples/NOTICE.md`` says
what each file is.
"""

import math
import os
import shutil
import sys
from collections.abc import Iterable
from datetime import date
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from sgp4.exporter import export_tle
from skyfield.api import load

from jaxurban.cities.base_map import read_base_map
from jaxurban.cities.census import read_blocks, read_districts
from jaxurban.cities.land_cover import projected
from jaxurban.cities.osm import OF_BUILDINGS, OSM_CREDIT, header_box, read_osm
from jaxurban.cities.outlines import Outlines, joined_outlines
from jaxurban.cities.stands import is_water, what_stands
from jaxurban.io.geoparquet import write_geoparquet
from jaxurban.io.nominal import GPS, MARK, Constellation, nominal_satellites
from jaxurban.io.samples import (
    BASE_MAP_FILE,
    BUILDINGS_FILE,
    HOME,
    LOG_FILE,
    SAMPLES,
    STRUCTURES_FILE,
)
from jaxurban.metrics.population import Population
from jaxurban.receivers.validation.logs import read_receiver_log
from jaxurban.world.grid import WGS84, Bounds, box_of, transformer, utm_of

STEP_DEG = 1e-6  # of coordinates, about 0.1 m
MARGIN_M = 400.0  # of Shinjuku: so far around the region every roof is kept
MASK_DEG = 5.0  # beyond, those that hide a satellite above it from some place in the region
NIHONBASHI_LOG = "tokyo/tokyo_nihonbashi_2023-06-22_satellites.csv.gz"
KNOWN_M = 300.0  # of Nihonbashi: so far around the drive every roof is kept
EDGE_M = 0.2  # so that no roof that is cut and rounded leaves it
ROW_DEG = 1.5e-4  # height of the boxes that the file covers
CELL_DEG = 1e-4  # step of their ends
ODBL = "ODbL-1.0"
CC_BY = "CC-BY-4.0"
PUBLIC_DOMAIN = "public domain"
PLATEAU_CREDIT = "Project PLATEAU (MLIT), CC BY 4.0"
CENSUS_CREDIT = "US Census Bureau"
DISTRICTS_CREDIT = "NYC Open Data (Department of City Planning)"
TAG_OF = {  # of the names of `Outlines` that differ from OpenStreetMap's
    "part": "building:part",
    "levels": "building:levels",
    "roof_levels": "roof:levels",
    "min_level": "building:min_level",
    "levels_below": "building:levels:underground",
    "razed": "razed:building",
    "crown": "diameter_crown",
    "wind": "generator:source",
    "rotor": "rotor:diameter",
    "hub": "height:hub",
    "construction": "tower:construction",
    "bridge_structure": "bridge:structure",
    "bridge_movable": "bridge:movable",
}
NOT_OF_PARTS = {"amenity", "tourism"}  # which say nothing of the heights of parts

# Source: European GNSS Service Centre, Orbital and technical parameters (www.gsc-europa.eu), reference constellation:
# Walker 24/3/1, 17 orbits in 10 sidereal days. Its nodes count from an origin that does not turn, as its rates show
# (613.72253566 degrees of latitude a day are 1.7 turns of Earth against that origin): the equinox moves away by the
# precession in right ascension, 4612.157 arcseconds a century since 2000 (IAU 2006).
PRECESSION_RATE_DEG = 4612.157 / 3600 / 36525
GALILEO = Constellation(
    name="GALILEO {}",
    first_number=101,
    slots={
        f"{plane}0{slot}": (
            317.632 + PRECESSION_RATE_DEG * 6168.5 + 120 * p,
            180.153 + 45 * (slot - 1) + 15 * p,
        )
        for p, plane in enumerate("ABC")
        for slot in range(1, 9)
    },
    table_date=date(2016, 11, 21),  # 6168.5 days after 2000-01-01 12:00
    inclination_deg=56.0,
    axis_km=29_600.318,
    node_rate_deg=-0.02764398 + PRECESSION_RATE_DEG,
    turns=1.7,
)


def _frame(outlines: Outlines, names: Iterable[str]) -> gpd.GeoDataFrame:
    """Return outlines with those of the tags ``names`` that any of them has."""
    columns = {TAG_OF.get(name, name): outlines.column(name) for name in names}
    filled = {name: values for name, values in columns.items() if pd.notna(values).any()}
    return gpd.GeoDataFrame(filled, geometry=outlines.polygons, crs=WGS84)


def make_lower_manhattan(data: Path, home: Path) -> None:
    """Write the files of Lower Manhattan: what stands, base map, census blocks, districts and satellites.

    Args:
      data: folder of the sources.
      home: folder to write to.
    """
    # Outlines and their tags.
    osm = data / "osm/lower-manhattan.osm.pbf"
    outlines = read_osm(osm)
    # Areas of buildings and bridges, with the tags that these have.
    is_kept = pd.notna(outlines.column("building")) | pd.notna(outlines.column("part"))
    is_kept |= outlines.texts("man_made") == "bridge"
    is_kept &= shapely.get_dimensions(outlines.polygons) == 2
    issues = {issue.value: count for issue, count in outlines.issues.items() if count}
    facts = {"credit": OSM_CREDIT, "licence": ODBL, "boxes": outlines.boxes, "issues": issues}
    # Not rounded: its maps are those of the extract itself.
    kept = outlines.take(is_kept)
    is_building = pd.notna(kept.column("building"))
    for name in kept.tags:
        if TAG_OF.get(name, name) not in OF_BUILDINGS:
            kept.tags[name][is_building] = None  # from which their heights do not follow
    names = [name for name in kept.tags if name not in NOT_OF_PARTS]
    write_geoparquet(home / BUILDINGS_FILE, _frame(kept, names), facts)

    # What else stands, with all tags that say so, and the water that bridges cross.
    rest = outlines.take(~is_kept)
    others = joined_outlines(osm, [what_stands(rest, False)[0], _crossed(rest)])
    facts = {"credit": OSM_CREDIT, "licence": ODBL}
    write_geoparquet(home / STRUCTURES_FILE, _frame(others, outlines.tags), facts)

    # Base map and census blocks in the extract's box.
    box = header_box(osm)
    assert box is not None
    census = Population(
        blocks=data / "census/tl_2010_36061_tabblock10.shp",
        table=data / "census/DECENNIALSF12010.P1_nyc_blocks.csv",
    )
    crs = utm_of(box)
    box_m = box_of(box, crs)
    base_map = read_base_map(osm, crs, box_m)
    write_geoparquet(home / BASE_MAP_FILE, base_map, base_map.attrs)
    blocks, _ = read_blocks(census, crs, box_m)
    counts = {"GEOID10": blocks.block_id, "POP10": blocks.night_count.astype(np.int64)}
    frame = gpd.GeoDataFrame(counts, geometry=blocks.polygons, crs=crs).to_crs(WGS84)
    facts = {"credit": CENSUS_CREDIT, "licence": PUBLIC_DOMAIN}
    write_geoparquet(home / "blocks.parquet", rounded(frame), facts)

    # Districts, cut 10 m beyond the blocks.
    areas, labels, _ = read_districts(data / "districts/nyc_community_districts.geojson", crs)
    around = shapely.box(*shapely.total_bounds(blocks.polygons)).buffer(10.0, join_style="mitre")
    areas = shapely.intersection(areas, around)
    frame = gpd.GeoDataFrame({"BoroCD": labels}, geometry=areas, crs=crs).to_crs(WGS84)
    facts = {"credit": DISTRICTS_CREDIT, "licence": "NYC Open Data terms of use"}
    write_geoparquet(home / "districts.parquet", rounded(frame[~frame.is_empty]), facts)
    write_nominal(home / "gps.tle", date(2020, 4, 27), GPS)


def _crossed(outlines: Outlines) -> Outlines:
    """Return the water that bridges cross."""
    water = outlines.take(is_water(outlines))
    bridges = outlines.polygons[outlines.texts("bridge") != ""]
    _, crossed = shapely.STRtree(water.polygons).query(bridges, predicate="intersects")
    return water.take(np.unique(crossed))


def make_shinjuku(data: Path, home: Path) -> None:
    """Write the files of Shinjuku: roof planes with their heights to 0.1 m, and satellites.

    Args:
      data: folder of the sources.
      home: folder to write to.
    """
    # Roofs near the region, and those farther away that can hide a satellite above the mask from its border.
    frame = gpd.read_parquet(data / "tokyo/tokyo-central-lod2.parquet")
    bounds: Bounds = tuple(SAMPLES["shinjuku"]["region"]["bounds"])
    crs = utm_of(bounds)
    region_m = box_of(bounds, crs)
    polygons = projected(frame.geometry.to_numpy(), crs)
    away_m = shapely.distance(polygons, shapely.box(*region_m))
    is_kept = (away_m <= MARGIN_M) | (frame["height"] >= away_m * math.tan(math.radians(MASK_DEG)))

    # The box in which all roofs are kept. A box in degrees lies slightly askew in metres: of the four corners' sorted
    # degrees the middle two of each axis bound one that is inside.
    x_min, y_min, x_max, y_max = region_m
    kept_box = shapely.box(x_min - MARGIN_M, y_min - MARGIN_M, x_max + MARGIN_M, y_max + MARGIN_M)
    corners = np.array(kept_box.exterior.coords)[:4]
    lon, lat = np.sort(np.array(transformer(crs, WGS84).transform(*corners.T)), axis=1)
    box = [round(float(degrees), 6) for degrees in (lon[1], lat[1], lon[2], lat[2])]
    frame = frame[is_kept].assign(height=frame["height"].round(1))
    facts = {"credit": PLATEAU_CREDIT, "licence": CC_BY, "boxes": [box]}
    write_geoparquet(home / BUILDINGS_FILE, rounded(frame), facts)
    write_nominal(home / "gps.tle", date(2018, 12, 19), GPS)
    write_nominal(home / "galileo.tle", date(2018, 12, 19), GALILEO)


def make_nihonbashi(data: Path, home: Path) -> None:
    """Write the files of Nihonbashi: a drive's log, the roofs around it, and satellites.

    The roofs are cut at the boxes that the file covers, so that all of a box is known.

    Args:
      data: folder of the sources.
      home: folder to write to.
    """
    # The log, and the boxes around the drive.
    shutil.copyfile(data / NIHONBASHI_LOG, home / LOG_FILE)
    track = read_receiver_log(data / NIHONBASHI_LOG).epochs
    bounds: Bounds = tuple(SAMPLES["nihonbashi"]["region"]["bounds"])
    crs = utm_of(bounds)
    drive = np.column_stack(transformer(WGS84, crs).transform(track["lon_deg"], track["lat_deg"]))
    boxes = boxes_inside(shapely.LineString(drive).buffer(KNOWN_M), crs)
    known = shapely.union_all([shapely.box(*box_of(box, crs)) for box in boxes])
    known = known.buffer(-EDGE_M, join_style="mitre")

    # The roofs in them, with their heights to 0.1 m.
    frame = gpd.read_parquet(data / "tokyo/tokyo-east-lod2.parquet")
    frame = frame.set_geometry(shapely.make_valid(frame.geometry.to_numpy())).to_crs(crs)
    frame = frame.clip(known).sort_index().to_crs(WGS84)
    frame = frame.assign(height=frame["height"].round(1))
    facts = {"credit": PLATEAU_CREDIT, "licence": CC_BY, "boxes": boxes}
    write_geoparquet(home / BUILDINGS_FILE, rounded(frame), facts)
    write_nominal(home / "gps.tle", date(2023, 6, 22), GPS)
    write_nominal(home / "galileo.tle", date(2023, 6, 22), GALILEO)


def boxes_inside(area: shapely.Polygon, crs: str) -> list[Bounds]:
    """Return boxes, west, south, east, north in degrees, that lie in an area and cover most of it, row by row.

    Rows are `ROW_DEG` high; ends of boxes are at multiples of `CELL_DEG`, or somewhat inside of these.

    Args:
      area: in ``crs``.
      crs: projected, in metres.
    """
    to_crs = transformer(WGS84, crs)
    bounds_m: Bounds = area.bounds
    west, south, east, north = to_crs.transform_bounds(*bounds_m, direction="INVERSE")

    def is_inside(box_west: float, box_south: float, box_east: float) -> bool:
        """Return whether the area covers a box of a row."""
        box = box_west, box_south, box_east, box_south + ROW_DEG
        return area.covers(shapely.box(*box_of(box, crs)))

    boxes: list[Bounds] = []
    cells_deg = np.arange(round(west / CELL_DEG), round(east / CELL_DEG) + 1) * CELL_DEG
    for row_deg in np.arange(round(south / ROW_DEG), round(north / ROW_DEG) + 1) * ROW_DEG:
        # Runs of cells that are inside: where one begins, and the first cell after it.
        is_cell_inside = [is_inside(cell, row_deg, cell + CELL_DEG) for cell in cells_deg]
        turns = np.flatnonzero(np.diff([False, *is_cell_inside, False]))
        for begin, end in turns.reshape(-1, 2):
            first = cells_deg[begin]
            last = cells_deg[end - 1] + CELL_DEG
            # A row lies askew in metres, so that a run of cells may reach out though none of them does.
            while first < last and not is_inside(first, row_deg, last):
                first += CELL_DEG / 2
                last -= CELL_DEG / 2
            if first < last:
                box = np.round([first, row_deg, last, row_deg + ROW_DEG], 6).tolist()
                boxes.append(tuple(box))
    return boxes


def write_nominal(path: Path, day: date, constellation: Constellation) -> None:
    """Write a nominal constellation as two-line elements of a day; the names of its satellites say that it is one."""
    satellites = nominal_satellites(day, load.timescale(builtin=True), constellation)
    lines: list[str] = []
    for satellite in satellites:
        lines += [f"{satellite.name} {MARK}", *export_tle(satellite.model)]
    path.write_text("".join(f"{line}\n" for line in lines))


def rounded(frame: gpd.GeoDataFrame) -> gpd.GeoDataFrame:
    """Return features in whole steps of `STEP_DEG`, valid, without those that become empty."""
    shapes = shapely.set_precision(shapely.make_valid(frame.geometry.to_numpy()), STEP_DEG)
    frame = frame.set_geometry(shapes, crs=frame.crs)
    return frame[~frame.is_empty].reset_index(drop=True)


def main(arguments: list[str]) -> None:
    """Make all cities, from the folder that the arguments name, and print their sizes."""
    data = Path(arguments[0] if arguments else os.environ.get("JAXURBAN_DATA", "../shared/data"))
    makers = {
        "lower-manhattan": make_lower_manhattan,
        "shinjuku": make_shinjuku,
        "nihonbashi": make_nihonbashi,
    }
    for name, make in makers.items():
        home = HOME / name
        home.mkdir(exist_ok=True)
        make(data, home)
        sizes = {path.name: path.stat().st_size for path in sorted(home.iterdir())}
        listed = ", ".join(f"{file} {size:,}" for file, size in sizes.items())
        print(f"{name}: {sum(sizes.values()):,} bytes ({listed})")


if __name__ == "__main__":
    main(sys.argv[1:])
