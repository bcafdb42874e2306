"""The files that the maps of a region need, from public sources into a folder, and the settings that use them."""

import io
import json
import os
import re
import shutil
import tempfile
import zipfile
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import urlsplit

import geopandas as gpd
import pandas as pd
import shapely

from jaxurban.errors import InputError, readable
from jaxurban.io.download import Cache, megabytes
from jaxurban.io.fetch_plan import BLOCK_MARGIN_M, COUNTY_DIGITS, FILES, NYC_BOX, NYC_FIELD, FetchJob, plan_fetch
from jaxurban.io.files import ELSEWHERE, SCRATCH_SUFFIX, write_whole
from jaxurban.io.read.census import read_districts
from jaxurban.io.read.orbits import look_angles, middle_epoch, read_orbits
from jaxurban.io.read.osm import cut_buildings, header_box
from jaxurban.io.read.osm import read_osm as read_outlines
from jaxurban.io.read.vector import open_frame
from jaxurban.io.workspace import Workspace
from jaxurban.progress import LOG
from jaxurban.settings import NOMINAL
from jaxurban.world.city import ReadIssue

MOST_COUNTIES = 12
CUT_REMEDY = "fetch it again, put it in order with `osmium sort`, or name another"
NOON = "T12:00:00Z"
BLOCK_ID = r"([0-9]{15})$"  # state 2, county 3, tract 6, block 4 digits; anything may stand before
BLOCK_FIELDS = ("GEOID20", "GEOID10", "GEOID")
SHAPEFILE_PARTS = (".shp", ".shx", ".dbf", ".prj")
RECORD_FILE, SCENARIO_FILE = "fetch.json", "scenario.toml"
COUNTS_FILE, BLOCKS_FILE = FILES["census"]
(DISTRICTS_FILE,), (ORBITS_FILE,) = FILES["districts"], FILES["orbits"]
REMEDY = f"{ELSEWHERE}, or pass --overwrite, which keeps it under another name"
Content = TypeVar("Content")
Settings = dict[str, Any]


@contextmanager
def staged(folder: Path, what: Collection[str], *, overwrite: bool) -> Iterator[Path]:
    """Yield a scratch folder whose files move into ``folder`` if the block succeeds, the scenario last.

    Args:
      folder: where to; made if it is not there.
      what: of `FILES`, beside the record and the scenario.
      overwrite: set aside what is there under these names; else only what an earlier fetch wrote, and nobody changed,
        may be there.

    Raises:
      InputError: a file of these names is in the way, or the folder cannot be written to.
    """
    with Workspace.open(folder, "fetch", is_shared=True) as workspace:
        names = chain(*(FILES[each] for each in what), (RECORD_FILE, SCENARIO_FILE))
        if not overwrite:
            workspace.check_way((folder / name for name in names), REMEDY)
        with tempfile.TemporaryDirectory(SCRATCH_SUFFIX, ".fetch.", folder) as stage:
            workspace.begin(Path(stage))
            yield Path(stage)
            for path in sorted(Path(stage).iterdir(), key=lambda path: path.name == SCENARIO_FILE):
                target = folder / path.name
                if overwrite and os.path.lexists(target) and not workspace.is_own(target):
                    workspace.set_aside(target)
                workspace.put(path, target)


def fetch(job: FetchJob, folder: Path, cache: Cache) -> tuple[Settings, Settings]:
    """Get the files of a job into a folder; return the settings of a scenario that uses them, and the record.

    The settings are those of ``scenario.toml`` by section; paths in them are relative to the folder. They have no
    ``buildings`` where ``osm`` is not in ``what``. The record says of every file where it is from, whose it is, its
    length and its SHA-256, and what was left out; it is also written as ``fetch.json``.

    Raises:
      InputError: something cannot be had, or the folder cannot be written to. Finished downloads stay in the cache.
    """
    requests, left_out = plan_fetch(job)
    names = {name for name, _ in requests}
    parts = Fetching(job, folder, cache, left_out)
    settings: Settings = {"region": {"bounds": list(job.bounds)}}
    if "osm" in names:
        settings["buildings"] = {"source": parts.buildings()}
    settings["gps"] = {"orbits": NOMINAL, "times": [f"{job.day or datetime.now(UTC).date()}{NOON}"]}
    if "orbits" in names:
        settings["gps"] = parts.orbits()
    if "population" in names and (population := parts.census()):
        settings["population"] = population
    if "districts" in names:
        settings.get("population", {}).update(parts.districts())
    record = {
        "bounds": list(job.bounds),
        "files": parts.files,
        "left_out": left_out,
        "num_requests": cache.num_requests,
    }
    write_whole(folder / RECORD_FILE, json.dumps(record, indent=1, ensure_ascii=False) + "\n")
    return settings, record


@dataclass
class Fetching:
    """A job under way: each method gets one part and returns what the scenario says of it."""

    job: FetchJob
    folder: Path
    cache: Cache
    left_out: list[str]
    files: list[Settings] = field(default_factory=list)

    def _get(self, name: str, file: str, read: Callable[[Path], Content], **part: Any) -> tuple[Path, Content]:
        """Return a download and what it holds, and note of which file it is."""
        source = self.job.sources[name]
        path, facts, content = self.cache.get(source, self.job.url(name, **part), read)
        facts = {key: value for key, value in facts.items() if key != "etag"}
        terms = source.credit, source.licence
        if name in self.job.urls and name != "osm":  # whose data are under its terms wherever they are from
            terms = str(urlsplit(facts["url"]).hostname), "ask its publisher"
        self.files.append({"source": name, "file": file, "credit": terms[0], "licence": terms[1], **facts})
        return path, content

    def buildings(self) -> str:
        """Get the buildings; return their file."""
        path, (name, problem) = self._get("osm", "", self.read_osm)
        self.files[-1]["file"] = name
        if problem:
            raise InputError(f"{self.job.url('osm')} {problem}")
        if not (self.folder / name).exists():
            shutil.copyfile(path, self.folder / name)
        return name

    def read_osm(self, path: Path) -> tuple[str, str]:
        """Read OpenStreetMap data, an extract cut to the region; return the file's name, and why it does not serve."""
        with path.open("rb") as file:
            is_extract = b"OSMHeader" in file.read(20)  # PBF, each block of which bears its own checksum
        name, file_format = FILES["osm"][is_extract], "pbf" if is_extract else "osm"
        if is_extract:
            LOG.info(f"osm: cutting the region and {self.job.margin_m:g} m around it out of the extract")
            with readable(path, "OpenStreetMap data", CUT_REMEDY, RuntimeError):
                cut_buildings(path, self.folder / name, self.job.box(self.job.margin_m))
        elif remark := re.search(rb"<remark>\s*(.*?)\s*</remark>", path.read_bytes(), re.DOTALL):
            # With status 200 the Overpass API sends what it had when its time or memory ran out.
            said = remark[1].decode("utf-8", "replace")
            raise InputError(f"the server says {said!r}: ask for a smaller region, or later")
        outlines = read_outlines(self.folder / name if is_extract else path, file_format)
        covered, problem = header_box(path, file_format), ""
        if covered is not None and not shapely.box(*covered).contains(shapely.box(*self.job.bounds)):
            shown = ", ".join(f"{value:.3f}" for value in covered)
            problem = f"covers {shown} (west, south, east, north), not all of the region: name another with --extract"
        elif not shapely.get_num_coordinates(outlines.polygons).any():
            bare = outlines.issues[ReadIssue.WAYS_WITH_MISSING_NODES]
            problem = "has no building in the region: check --bounds, longitude first"
            if bare:
                problem = f"has {bare:,} buildings but not their nodes: ask for them too, as with (._;>;)"
        if problem and not is_extract:
            raise InputError(f"it {problem}")
        return name, problem  # an extract is kept: it may serve another region

    def orbits(self) -> Settings:
        """Get the element sets."""
        path, time = self._get("orbits", ORBITS_FILE, self.read_orbits)
        shutil.copyfile(path, self.folder / ORBITS_FILE)
        LOG.info(f"orbits: the GPS maps are of {time}")
        return {"orbits": ORBITS_FILE, "times": [time]}

    def read_orbits(self, path: Path) -> str:
        """Read element sets; return the time of the maps, at which they may not be too old."""
        orbits = read_orbits(path)
        time = f"{self.job.day}{NOON}" if self.job.day else str(middle_epoch(orbits))
        look_angles(orbits, [time], 0.0, 0.0)
        return time

    def census(self) -> Settings:
        """Get people and blocks; nothing where there are none."""
        table = self._counts()
        counties = list(self.job.counties) or sorted(set(_block_ids(table).str[:COUNTY_DIGITS]))
        if not counties:
            self.left_out.append("population: the census has no block in this region, so the layer is left out")
            return {}
        if len(counties) > MOST_COUNTIES:
            raise InputError(
                f"the population table names {len(counties)} counties: say with --county which of them "
                f"the region needs ({', '.join(counties[:3])} ...)"
            )
        read = partial(read_block_zip, most_bytes=self.cache.most_bytes)
        frames = [self._get("blocks", BLOCKS_FILE, read, county=county)[1] for county in counties]
        blocks = pd.concat([frame.to_crs(frames[0].crs) for frame in frames], ignore_index=True)
        west, south, east, north = self.job.box(BLOCK_MARGIN_M)
        blocks = gpd.GeoDataFrame(blocks, crs=frames[0].crs).cx[west:east, south:north]
        if blocks.empty:
            raise InputError(f"no block of {', '.join(counties)} touches the region: check --county and --bounds")
        blocks.sort_values("GEOID").to_parquet(self.folder / BLOCKS_FILE, index=False)
        table.to_csv(self.folder / COUNTS_FILE, index=False)
        return {"blocks": BLOCKS_FILE, "block_field": "GEOID", "table": COUNTS_FILE}

    def _counts(self) -> pd.DataFrame:
        """Return the whole table of population, which may come in pages."""
        table, has_more = pd.DataFrame(), True
        while has_more:
            _, (page, has_more) = self._get("population", COUNTS_FILE, read_counts, offset=len(table))
            table = pd.concat([table, page], ignore_index=True)
            if has_more and (page.empty or table.duplicated().any()):
                raise InputError(
                    f"{self.files[-1]['url']} says that there is more to send, but sends nothing new: run it again "
                    "later, ask for a smaller region, or give a table of the whole region with --source population=URL"
                )
        return table

    def districts(self) -> Settings:
        """Get the districts."""
        path, _ = self._get("districts", DISTRICTS_FILE, self.read_districts)
        shutil.copyfile(path, self.folder / DISTRICTS_FILE)
        found: Settings = {"districts": DISTRICTS_FILE, "district_field": self.job.district_field}
        if self.job.district_field != NYC_FIELD or not shapely.box(*self.job.bounds).intersects(shapely.box(*NYC_BOX)):
            found["commercial"] = []
            self.left_out.append(
                "commercial districts: none are marked, so nobody commutes into any; list their "
                "labels in [population] commercial"
            )
        return found

    def read_districts(self, path: Path) -> None:
        """Read the GeoJSON of districts, which must hold some."""
        if not path.read_bytes().removeprefix(b"\xef\xbb\xbf").lstrip().startswith(b"{"):
            raise InputError("it is not GeoJSON")
        if not len(read_districts(path, self.job.crs, self.job.district_field)[0]):
            raise InputError("it holds no polygons on this globe")


def read_block_zip(path: Path, most_bytes: int) -> gpd.GeoDataFrame:
    """Return the blocks of a zipped Shapefile: their id, as ``GEOID``, and their polygons.

    Raises:
      InputError: it would unpack to more than ``most_bytes``, or holds no Shapefile of blocks.
      zipfile.BadZipFile, OSError: another kind of file, or a damaged one.
    """
    with zipfile.ZipFile(path) as archive, tempfile.TemporaryDirectory() as folder:
        parts = [info for info in archive.infolist() if Path(info.filename).suffix.lower() in SHAPEFILE_PARTS]
        if sum(info.file_size for info in parts) > most_bytes:
            raise InputError(f"it unpacks to more than {megabytes(most_bytes)}: raise --max-size")
        archive.extractall(folder, parts)
        shapes = list(Path(folder).rglob("*.[sS][hH][pP]"))
        if len(shapes) != 1:
            raise InputError(f"the zip does not hold one Shapefile, but {', '.join(archive.namelist()[:8])}")
        frame = open_frame(shapes[0], "blocks")
    fields = [name for name in BLOCK_FIELDS if name in frame.columns]
    if not fields:
        raise InputError(f"its fields are {', '.join(map(str, frame.columns))}, none of {', '.join(BLOCK_FIELDS)}")
    return frame[[fields[0], "geometry"]].rename(columns={fields[0]: "GEOID"})


def read_counts(path: Path) -> tuple[pd.DataFrame, bool]:
    """Return a table of population by block, as text, and whether the server has more to send.

    It is what TIGERweb sends (JSON), or a CSV with a column of 15-digit block ids.

    Raises:
      InputError: an error message of TIGERweb, or no ids of blocks.
      ValueError, LookupError, TypeError: another kind of file, or a damaged one.
    """
    text, has_more = path.read_bytes().decode("utf-8-sig", "replace"), False
    if not text.lstrip().startswith("{"):
        table = pd.read_csv(io.StringIO(text), dtype=str, keep_default_na=False, index_col=False)
    else:
        content = json.loads(text)
        if "features" not in content:
            raise InputError(f"it is JSON without features: {str(content.get('error', content))[:200]}")
        rows = [row["attributes"] for row in content["features"]]
        table = pd.DataFrame(rows, columns=["GEOID", "POP100"]).astype(str)
        has_more = bool(content.get("exceededTransferLimit"))
        if not rows:
            return table, has_more
    if not _block_ids(table).size:
        raise InputError(f"no column of it holds 15-digit block ids; it begins with {text[:40]!r}")
    return table, has_more


def _block_ids(table: pd.DataFrame) -> pd.Series:
    columns = [table[name].astype(str).str.extract(BLOCK_ID)[0].dropna() for name in table]
    return max(columns, key=len, default=pd.Series(dtype=str))
