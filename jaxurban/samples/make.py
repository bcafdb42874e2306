"""Makes the sample cities from files of their sources: ``python -m jaxurban.samples.make [DATA]``.

DATA is the folder of these files, else ``JAXURBAN_DATA``, else ``../shared/data``. NOTICE.md says what each file is.
"""

import math
import os
import shutil
import sys
from datetime import date
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from sgp4.exporter import export_tle
from skyfield.api import load

from jaxurban.io.geoparquet import write_geoparquet
from jaxurban.io.read.base_map import read_base_map, write_base_map
from jaxurban.io.read.census import read_blocks, read_districts
from jaxurban.io.read.nominal import GALILEO, GPS, MARK, Constellation, nominal_satellites
from jaxurban.io.read.osm import OSM_CREDIT, TAGS, header_box, projected, read_osm
from jaxurban.io.read.receiver import read_receiver_log
from jaxurban.io.samples import BASE_MAP_FILE, BUILDINGS_FILE, LOG_FILE, SAMPLES
from jaxurban.metrics.population import Population
from jaxurban.world.grid import WGS84, Bounds, box_of, transformer, utm_of

HERE = Path(__file__).parent
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
}


def make_lower_manhattan(data: Path, home: Path) -> None:
    """Write the files of Lower Manhattan."""
    osm = data / "osm/lower-manhattan.osm.pbf"
    outlines = read_osm(osm, has_decks=True)
    columns = {TAG_OF.get(name, name): values for name, values in outlines.tags.items()}
    frame = gpd.GeoDataFrame(columns, geometry=outlines.polygons, crs=WGS84)
    assert set(frame.columns) - {"geometry"} <= set(TAGS)
    issues = {issue.value: count for issue, count in outlines.issues.items() if count}
    facts = {"credit": OSM_CREDIT, "licence": ODBL, "boxes": outlines.boxes, "issues": issues}
    # Not rounded: its maps are those of the extract itself.
    write_geoparquet(home / BUILDINGS_FILE, frame, facts)

    box = header_box(osm)
    assert box is not None
    census = Population(
        blocks=data / "census/tl_2010_36061_tabblock10.shp",
        table=data / "census/DECENNIALSF12010.P1_nyc_blocks.csv",
    )
    crs = utm_of(box)
    box_m = box_of(box, crs)
    write_base_map(home / BASE_MAP_FILE, read_base_map(osm, crs, box_m))
    blocks, _ = read_blocks(census, crs, box_m)
    counts = {"GEOID10": blocks.block_id, "POP10": blocks.night_count.astype(np.int64)}
    frame = gpd.GeoDataFrame(counts, geometry=blocks.polygons, crs=crs).to_crs(WGS84)
    write_geoparquet(
        home / "blocks.parquet", rounded(frame), {"credit": CENSUS_CREDIT, "licence": PUBLIC_DOMAIN}
    )

    areas, labels, _ = read_districts(data / "districts/nyc_community_districts.geojson", crs)
    around = shapely.box(*shapely.total_bounds(blocks.polygons)).buffer(10.0, join_style="mitre")
    frame = gpd.GeoDataFrame(
        {"BoroCD": labels}, geometry=shapely.intersection(areas, around), crs=crs
    ).to_crs(WGS84)
    facts = {"credit": DISTRICTS_CREDIT, "licence": "NYC Open Data terms of use"}
    write_geoparquet(home / "districts.parquet", rounded(frame[~frame.is_empty]), facts)
    write_nominal(home / "gps.tle", date(2020, 4, 27), GPS)


def make_shinjuku(data: Path, home: Path) -> None:
    """Write the files of Shinjuku: roof planes with their heights to 0.1 m."""
    frame = gpd.read_parquet(data / "tokyo/tokyo-central-lod2.parquet")
    bounds: Bounds = tuple(SAMPLES["shinjuku"]["region"]["bounds"])
    crs = utm_of(bounds)
    region_m = box_of(bounds, crs)
    polygons = projected(frame.geometry.to_numpy(), crs)
    away_m = shapely.distance(polygons, shapely.box(*region_m))
    is_kept = (away_m <= MARGIN_M) | (frame["height"] >= away_m * math.tan(math.radians(MASK_DEG)))
    x_min, y_min, x_max, y_max = region_m
    wide_m = (x_min - MARGIN_M, y_min - MARGIN_M, x_max + MARGIN_M, y_max + MARGIN_M)
    # A box in degrees lies slightly askew in metres: this one is inside.
    corners = np.array(shapely.box(*wide_m).exterior.coords)[:4]
    lon, lat = np.sort(np.array(transformer(crs, WGS84).transform(*corners.T)), axis=1)
    box = [round(float(value), 6) for value in (lon[1], lat[1], lon[2], lat[2])]
    frame = frame[is_kept].assign(height=frame["height"].round(1))
    facts = {"credit": PLATEAU_CREDIT, "licence": CC_BY, "boxes": [box]}
    write_geoparquet(home / BUILDINGS_FILE, rounded(frame), facts)
    write_nominal(home / "gps.tle", date(2018, 12, 19), GPS)
    write_nominal(home / "galileo.tle", date(2018, 12, 19), GALILEO)


def make_nihonbashi(data: Path, home: Path) -> None:
    """Write the files of Nihonbashi: a drive's log, and the roofs around it, cut at the boxes that are known whole."""
    shutil.copyfile(data / NIHONBASHI_LOG, home / LOG_FILE)
    track = read_receiver_log(data / NIHONBASHI_LOG).epochs
    bounds: Bounds = tuple(SAMPLES["nihonbashi"]["region"]["bounds"])
    crs = utm_of(bounds)
    drive = np.column_stack(transformer(WGS84, crs).transform(track["lon_deg"], track["lat_deg"]))
    boxes = boxes_inside(shapely.LineString(drive).buffer(KNOWN_M), crs)
    known = shapely.union_all([shapely.box(*box_of(box, crs)) for box in boxes])
    known = known.buffer(-EDGE_M, join_style="mitre")
    frame = gpd.read_parquet(data / "tokyo/tokyo-east-lod2.parquet")
    frame = frame.set_geometry(shapely.make_valid(frame.geometry.to_numpy())).to_crs(crs)
    frame = frame.clip(known).sort_index().to_crs(WGS84)
    facts = {"credit": PLATEAU_CREDIT, "licence": CC_BY, "boxes": boxes}
    write_geoparquet(
        home / BUILDINGS_FILE, rounded(frame.assign(height=frame["height"].round(1))), facts
    )
    write_nominal(home / "gps.tle", date(2023, 6, 22), GPS)
    write_nominal(home / "galileo.tle", date(2023, 6, 22), GALILEO)


def boxes_inside(area: shapely.Polygon, crs: str) -> list[Bounds]:
    """Return rows of boxes, west, south, east, north in degrees, whose boxes in ``crs`` lie in an area of it."""
    to_crs = transformer(WGS84, crs)
    bounds_m: Bounds = area.bounds
    west, south, east, north = to_crs.transform_bounds(*bounds_m, direction="INVERSE")

    def is_inside(first: float, low: float, last: float) -> bool:
        return area.covers(shapely.box(*box_of((first, low, last, low + ROW_DEG), crs)))

    boxes: list[Bounds] = []
    steps = np.arange(round(west / CELL_DEG), round(east / CELL_DEG) + 1) * CELL_DEG
    for low in np.arange(round(south / ROW_DEG), round(north / ROW_DEG) + 1) * ROW_DEG:
        is_known = [is_inside(step, low, step + CELL_DEG) for step in steps]
        turns = np.flatnonzero(np.diff([False, *is_known, False]))
        for begin, end in turns.reshape(-1, 2):
            first = steps[begin]
            last = steps[end - 1] + CELL_DEG
            while first < last and not is_inside(first, low, last):  # a row lies askew in metres
                first = first + CELL_DEG / 2
                last = last - CELL_DEG / 2
            if first < last:
                box = np.round([first, low, last, low + ROW_DEG], 6).tolist()
                boxes.append(tuple(box))
    return boxes


def write_nominal(path: Path, day: date, constellation: Constellation) -> None:
    """Write a nominal constellation as two-line elements of a day; their names say what they are."""
    satellites = nominal_satellites(day, load.timescale(builtin=True), constellation)
    sets = [[f"{satellite.name} {MARK}", *export_tle(satellite.model)] for satellite in satellites]
    path.write_text("".join(f"{line}\n" for lines in sets for line in lines))


def rounded(frame: gpd.GeoDataFrame) -> gpd.GeoDataFrame:
    """Return features in whole steps of `STEP_DEG`, valid, without those that become empty."""
    shapes = shapely.set_precision(shapely.make_valid(frame.geometry.to_numpy()), STEP_DEG)
    frame = frame.set_geometry(shapes, crs=frame.crs)
    return frame[~frame.is_empty].reset_index(drop=True)


def main(arguments: list[str]) -> None:
    """Make all cities, from the folder that the arguments name, and print their sizes."""
    data = Path(arguments[0] if arguments else os.environ.get("JAXURBAN_DATA", "../shared/data"))
    makers: dict[str, Any] = {
        "lower-manhattan": make_lower_manhattan,
        "shinjuku": make_shinjuku,
        "nihonbashi": make_nihonbashi,
    }
    for name, make in makers.items():
        home = HERE / name
        home.mkdir(exist_ok=True)
        make(data, home)
        sizes = pd.Series({path.name: path.stat().st_size for path in sorted(home.iterdir())})
        print(
            f"{name}: {sizes.sum():,} bytes ({', '.join(f'{file} {size:,}' for file, size in sizes.items())})"
        )


if __name__ == "__main__":
    main(sys.argv[1:])
