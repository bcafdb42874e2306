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
from jaxurban.io.arrived import (
    check_buildings,
    counties_of,
    orbits_suffix,
    osm_box,
    osm_suffix,
    read_block_zip,
    read_counts,
)
from jaxurban.io.download import Client, Kept, UnfitError, Wanted
from jaxurban.io.fetchplan import BLOCK_MARGIN_M, FetchJob, plan_fetch, want_blocks, want_population
from jaxurban.io.landing import RECORD_FILE, SCENARIO_FILE, sha256_of
from jaxurban.io.orbits import NOMINAL, middle_epoch, read_orbits
from jaxurban.io.osmcut import cut_buildings
from jaxurban.io.store import whole_file

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


def fetch(job: FetchJob, folder: Path, client: Client) -> tuple[dict[str, Any], dict[str, Any]]:
    """Get the files of a job into a folder; return the settings of a scenario that uses them, and the record.

    The settings are those of ``scenario.toml`` by section; paths in them are relative to the folder. They have no
    ``buildings`` where ``osm`` was not asked for. The record says of every file where it is from, whose it is, its
    length and its SHA-256, and what was left out; it is also written as ``fetch.json``.

    Raises:
      InputError: something cannot be had, or the folder cannot be written to. What has arrived stays in the cache.
    """
    plan = plan_fetch(job)
    if not plan.requests:
        raise InputError(f"nothing of --what can be fetched here ({'; '.join(plan.left_out)})")
    parts = _Fetching(job, folder, client, left_out=list(plan.left_out))
    settings: dict[str, Any] = {"region": {"bounds": list(job.bounds)}}
    if plan.osm is not None:
        settings["buildings"] = {"source": parts.buildings(plan.osm)}
    settings["gps"] = {"orbits": NOMINAL, "times": [f"{job.day or job.today}T{UTC_HOUR}Z"]}
    if plan.orbits is not None:
        settings["gps"]["orbits"] = parts.orbits(plan.orbits)
        if job.day is None:
            settings["gps"]["times"] = [middle_epoch(read_orbits(folder / settings["gps"]["orbits"]))]
            client.tell(
                f"orbits: the GPS maps are of {settings['gps']['times'][0]}, the middle of the elements' epochs"
            )
    if plan.population is not None and (population := parts.census()):
        settings["population"] = population
    if plan.districts is not None:
        found = parts.districts(plan.districts)
        if "population" in settings:
            settings["population"] |= found
    record = {
        "bounds": list(job.bounds),
        "files": parts.files,
        "left_out": parts.left_out,
        "num_requests": client.asker.num_requests,
        "written": {path.name: sha256_of(path) for path in sorted(folder.iterdir())},
    }
    with whole_file(folder / RECORD_FILE) as scratch:
        scratch.write_text(json.dumps(record, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    return settings, record


@dataclass
class _Fetching:
    """A job under way: each method gets one part and returns what the scenario says of it."""

    job: FetchJob
    folder: Path
    client: Client
    left_out: list[str]
    files: list[dict[str, Any]] = field(default_factory=list)

    def _note(self, kept: Kept, source: str, name: str) -> None:
        known = self.job.sources[source]
        # Another place's terms are not known here, but OpenStreetMap's data are its own wherever they are from.
        has_terms = source == "osm" or not self.job.is_given(source)
        self.files.append(
            {
                "source": source,
                "file": name,
                "url": kept.url,
                "credit": known.credit if has_terms else str(urlsplit(kept.url).hostname),
                "licence": known.licence if has_terms else "ask its publisher",
                "fetched_utc": kept.fetched_utc,
                "num_bytes": kept.num_bytes,
                "sha256": kept.sha256,
            }
        )

    def _copy(self, kept: Kept, source: str, name: str) -> str:
        with whole_file(self.folder / name) as scratch:
            shutil.copyfile(kept.path, scratch)
        self._note(kept, source, name)
        return name

    def buildings(self, wanted: Wanted) -> str:
        kept = self.client.get(wanted)
        suffix = osm_suffix(kept.path)
        covered = osm_box(kept.path, suffix)
        if covered is not None and not shapely.box(*covered).contains(shapely.box(*self.job.bounds)):
            shown = ", ".join(f"{value:.3f}" for value in covered)
            raise InputError(
                f"{wanted.url} covers {shown} (west, south, east, north), not all of the region "
                f"{list(self.job.bounds)}: name another extract with --extract"
            )
        name = f"buildings{suffix}"
        if suffix == ".osm":
            return self._copy(kept, "osm", name)
        self.client.tell(f"osm: cutting the region and {self.job.margin_m:g} m around it out of the extract")
        with whole_file(self.folder / name) as scratch:
            try:
                cut_buildings(kept.path, scratch, self.job.box(self.job.margin_m))
                check_buildings(scratch, "pbf")
            except UnfitError as error:
                raise InputError(f"the region was cut out of {wanted.url}, and {error}") from error
            except RuntimeError as error:
                raise InputError(
                    f"{wanted.url} cannot be cut ({error}): put it in order with `osmium sort`, or name another "
                    "extract with --extract"
                ) from error
        self._note(kept, "osm", name)
        return name

    def orbits(self, wanted: Wanted) -> str:
        kept = self.client.get(wanted)
        return self._copy(kept, "orbits", f"gps-ops{orbits_suffix(kept.path)}")

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
            kept = self.client.get(want_blocks(self.job, county))
            frames.append(read_block_zip(kept.path, self.job.most_bytes))
            self._note(kept, "blocks", "blocks.parquet")
        blocks = pd.concat([frame.to_crs(frames[0].crs) for frame in frames], ignore_index=True)
        west, south, east, north = self.job.box(BLOCK_MARGIN_M)
        blocks = gpd.GeoDataFrame(blocks, crs=frames[0].crs).cx[west:east, south:north]
        if blocks.empty:
            raise InputError(f"no block of {', '.join(counties)} touches the region: check --county and --bounds")
        with whole_file(self.folder / "blocks.parquet") as scratch:
            blocks.sort_values("GEOID").to_parquet(scratch, index=False)
        with whole_file(self.folder / "population.csv") as scratch:
            table.to_csv(scratch, index=False)
        return {"blocks": "blocks.parquet", "block_field": "GEOID", "table": "population.csv"}

    def _counts(self) -> pd.DataFrame:
        """Return the whole table of population, which may come in pages."""
        pages: list[pd.DataFrame] = []
        seen: set[str] = set()
        has_more = True
        while has_more:
            if len(pages) == MOST_PAGES:
                raise InputError(f"the population table has more than {MOST_PAGES} pages: ask for a smaller region")
            kept = self.client.get(want_population(self.job, sum(map(len, pages))))
            page, has_more = read_counts(kept.path)
            if has_more and page.empty:
                raise InputError(f"{kept.url} says that there is more to send, but sends nothing: run it again later")
            ids = set(page.get("GEOID", ()))
            if not seen.isdisjoint(ids):
                raise InputError(
                    f"{kept.url} sends again what an earlier page of it held: its pages must go on from {{offset}} in "
                    "the URL; give another place, or a table of the whole region, with --source population=URL"
                )
            seen |= ids
            self._note(kept, "population", "population.csv")
            pages.append(page)
        return pd.concat(pages, ignore_index=True)

    def districts(self, wanted: Wanted) -> dict[str, Any]:
        kept = self.client.get(wanted)
        found: dict[str, Any] = {
            "districts": self._copy(kept, "districts", "districts.geojson"),
            "district_field": self.job.district_field,
        }
        if not self.job.has_nyc_labels:
            found["commercial"] = []
            self.left_out.append(
                "commercial districts: none are marked, so nobody commutes into any; list their "
                "labels in [population] commercial"
            )
        return found
