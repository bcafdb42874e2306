"""The files that the maps of a region need, fetched into a folder, and the settings that use them."""

import json
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from types import MappingProxyType
from typing import Any
from urllib.parse import urlsplit

import geopandas as gpd
import pandas as pd
import shapely

from jaxurban.errors import InputError
from jaxurban.io.fetch.download import Cache, CacheEntry, Download, UnfitError
from jaxurban.io.fetch.plan import BLOCK_MARGIN_M, FetchJob, block_download, plan_fetch, population_download
from jaxurban.io.fetch.reading import (
    check_buildings,
    counties_of,
    orbits_suffix,
    osm_format,
    read_block_zip,
    read_counts,
)
from jaxurban.io.fetch.sources import Source
from jaxurban.io.fetch.staging import RECORD_FILE, SCENARIO_FILE
from jaxurban.io.files import whole_file, write_whole
from jaxurban.io.read.orbits import NOMINAL, middle_epoch, read_orbits
from jaxurban.io.read.osm import cut_buildings, header_box
from jaxurban.progress import LOG

UTC_HOUR = "12:00:00"
MOST_COUNTIES, MOST_PAGES = 12, 20
TARGETS = MappingProxyType(
    {
        "osm": ("buildings.osm", "buildings.osm.pbf"),
        "census": ("population.csv", "blocks.parquet"),
        "districts": ("districts.geojson",),
        "orbits": tuple(f"gps-ops{suffix}" for suffix in (".csv", ".json", ".xml", ".tle")),
    }
)


def targets(what: Sequence[str]) -> list[str]:
    """Return the names of the files that a job may write."""
    return [*chain.from_iterable(TARGETS[name] for name in what), RECORD_FILE, SCENARIO_FILE]


def fetch(job: FetchJob, folder: Path, cache: Cache) -> tuple[dict[str, Any], dict[str, Any]]:
    """Get the files of a job into a folder; return the settings of a scenario that uses them, and the record.

    The settings are those of ``scenario.toml`` by section; paths in them are relative to the folder. They have no
    ``buildings`` where ``osm`` is not in ``what``. The record says of every file where it is from, whose it is, its
    length and its SHA-256, and what was left out; it is also written as ``fetch.json``.

    Raises:
      InputError: something cannot be had, or the folder cannot be written to. Finished downloads stay in the cache.
    """
    plan = plan_fetch(job)
    if not plan.downloads:
        raise InputError(f"nothing of --what can be fetched here ({'; '.join(plan.left_out)})")
    parts = _Fetching(job, folder, cache, left_out=list(plan.left_out))
    settings: dict[str, Any] = {"region": {"bounds": list(job.bounds)}}
    if download := plan.of("osm"):
        settings["buildings"] = {"source": parts.buildings(download)}
    settings["gps"] = {"orbits": NOMINAL, "times": [f"{job.day or job.today}T{UTC_HOUR}Z"]}
    if download := plan.of("orbits"):
        settings["gps"] |= parts.orbits(download)
    if plan.of("population") and (population := parts.census()):
        settings["population"] = population
    if download := plan.of("districts"):
        found = parts.districts(download)
        if "population" in settings:
            settings["population"] |= found
    record = {
        "bounds": list(job.bounds),
        "files": parts.files,
        "left_out": parts.left_out,
        "num_requests": cache.num_requests,
    }
    write_whole(folder / RECORD_FILE, json.dumps(record, indent=1, ensure_ascii=False) + "\n")
    return settings, record


@dataclass
class _Fetching:
    """A job under way: each method gets one part and returns what the scenario says of it."""

    job: FetchJob
    folder: Path
    cache: Cache
    left_out: list[str]
    files: list[dict[str, Any]] = field(default_factory=list)

    def _note(self, entry: CacheEntry, source: Source, name: str) -> None:
        # Another place's terms are not known here, but OpenStreetMap's data are its own wherever they are from.
        has_terms = source.name == "osm" or not source.is_given
        self.files.append(
            {
                "source": source.name,
                "file": name,
                "url": entry.url,
                "credit": source.credit if has_terms else str(urlsplit(entry.url).hostname),
                "licence": source.licence if has_terms else "ask its publisher",
                "fetched_utc": entry.fetched_utc,
                "num_bytes": entry.num_bytes,
                "sha256": entry.sha256,
            }
        )

    def _copy(self, entry: CacheEntry, source: Source, name: str) -> str:
        with whole_file(self.folder / name) as scratch:
            shutil.copyfile(entry.path, scratch)
        self._note(entry, source, name)
        return name

    def buildings(self, download: Download) -> str:
        entry = self.cache.get(download)
        file_format = osm_format(entry.path)
        covered = header_box(entry.path, file_format)
        if covered is not None and not shapely.box(*covered).contains(shapely.box(*self.job.bounds)):
            shown = ", ".join(f"{value:.3f}" for value in covered)
            raise InputError(
                f"{download.url} covers {shown} (west, south, east, north), not all of the region "
                f"{list(self.job.bounds)}: name another extract with --extract"
            )
        if file_format == "osm":
            return self._copy(entry, download.source, "buildings.osm")
        name = "buildings.osm.pbf"
        LOG.info(f"osm: cutting the region and {self.job.margin_m:g} m around it out of the extract")
        with whole_file(self.folder / name) as scratch:
            try:
                cut_buildings(entry.path, scratch, self.job.box(self.job.margin_m))
                check_buildings(scratch, "pbf")
            except UnfitError as error:
                raise InputError(f"the region was cut out of {download.url}, and {error}") from error
            except RuntimeError as error:
                raise InputError(
                    f"{download.url} cannot be cut ({error}): put it in order with `osmium sort`, or name another "
                    "extract with --extract"
                ) from error
        self._note(entry, download.source, name)
        return name

    def orbits(self, download: Download) -> dict[str, Any]:
        entry = self.cache.get(download)
        found: dict[str, Any] = {"orbits": self._copy(entry, download.source, f"gps-ops{orbits_suffix(entry.path)}")}
        if self.job.day is None:
            time = middle_epoch(read_orbits(entry.path))
            found["times"] = [time]
            LOG.info(f"orbits: the GPS maps are of {time}, the middle of the elements' epochs")
        return found

    def census(self) -> dict[str, Any]:
        table = self._counts()
        counties = list(self.job.counties) or counties_of(table)
        if not counties:
            self.left_out.append("population: the census has no block in this region, so the layer is left out")
            return {}
        if len(counties) > MOST_COUNTIES:
            raise InputError(
                f"the population table names {len(counties)} counties: say with --county which of them "
                f"the region needs ({', '.join(counties[:3])} ...)"
            )
        frames = []
        for county in counties:
            download = block_download(self.job, county)
            entry = self.cache.get(download)
            frames.append(read_block_zip(entry.path, self.job.most_bytes))
            self._note(entry, download.source, "blocks.parquet")
        blocks = pd.concat([frame.to_crs(frames[0].crs) for frame in frames], ignore_index=True)
        west, south, east, north = self.job.box(BLOCK_MARGIN_M)
        blocks = gpd.GeoDataFrame(blocks, crs=frames[0].crs).cx[west:east, south:north]
        if blocks.empty:
            raise InputError(f"no block of {', '.join(counties)} touches the region: check --county and --bounds")
        with whole_file(self.folder / "blocks.parquet") as scratch:
            blocks.sort_values("GEOID").to_parquet(scratch, index=False)
        write_whole(self.folder / "population.csv", table.to_csv(index=False))
        return {"blocks": "blocks.parquet", "block_field": "GEOID", "table": "population.csv"}

    def _counts(self) -> pd.DataFrame:
        """Return the whole table of population, which may come in pages."""
        pages: list[pd.DataFrame] = []
        has_more = True
        while has_more:
            download = population_download(self.job, sum(map(len, pages)))
            entry = self.cache.get(download)
            page, has_more = read_counts(entry.path)
            self._note(entry, download.source, "population.csv")
            pages.append(page)
            table = pd.concat(pages, ignore_index=True)
            if has_more and (len(pages) == MOST_PAGES or page.empty or table.duplicated().any()):
                raise InputError(
                    f"{entry.url} says that there is more to send, but sends nothing new or has more than {MOST_PAGES} "
                    "pages, which must go on from {offset} in the URL: run it again later, ask for a smaller region, "
                    "or give a table of the whole region with --source population=URL"
                )
        return table

    def districts(self, download: Download) -> dict[str, Any]:
        name = self._copy(self.cache.get(download), download.source, "districts.geojson")
        found: dict[str, Any] = {"districts": name, "district_field": self.job.district_field}
        if not self.job.has_nyc_labels:
            found["commercial"] = []
            self.left_out.append(
                "commercial districts: none are marked, so nobody commutes into any; list their "
                "labels in [population] commercial"
            )
        return found
