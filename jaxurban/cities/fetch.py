"""The files that the maps of a region need, from public sources into a folder, and a scenario that uses them."""

import json
import os
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Any
from urllib.parse import quote, urlsplit

import shapely
import tomli_w

from jaxurban.checks import one_of
from jaxurban.cities.census import read_blocks, read_districts
from jaxurban.cities.download import Source, cache_folder, download
from jaxurban.cities.kinds import NOT_BUILT, STANDING, WATERS, Nothing
from jaxurban.cities.osm import MAYBE, read_osm
from jaxurban.cities.rules import BY_VALUE, LIVES, OF_AREAS, RULES
from jaxurban.errors import InputError, readable
from jaxurban.io.broken import BROKEN
from jaxurban.io.files import ELSEWHERE, SCRATCH_SUFFIX, only_writer, sweep_scraps
from jaxurban.io.orbits import WARN_AGE_DAYS, middle_epoch, read_orbits
from jaxurban.io.workspace import Workspace
from jaxurban.metrics.population import Population
from jaxurban.progress import LOG
from jaxurban.settings import NOMINAL
from jaxurban.world.grid import WGS84, Bounds, box_of, check_bounds, transformer, utm_of

DAY_S = 24 * 3600.0
# A dense city of this size is some 200 MB of XML and a minute of a shared server's time.
MOST_OVERPASS_KM2 = 100.0
MOST_MARGIN_M = 20_000.0
# The maps' box is snapped outward and densified, and NAD83 is a metre or two off WGS 84.
BLOCK_MARGIN_M = 100.0
NOON = "T12:00:00Z"
RECORD_FILE = "fetch.json"
SCENARIO_FILE = "scenario.toml"
BLOCK_FIELD = "GEOID"
REMEDY = f"{ELSEWHERE}, or pass --overwrite, which keeps it under another name"
# TIGERweb has the counts and the outlines of blocks in one layer, and unlike the Census Data API asks for no key; it
# sends nothing where a query is not ordered. CelesTrak updates every two hours and wants programs to stop at the first
# refusal; two-line elements cannot name satellites catalogued since 2026, so its OMM (CSV) is asked for.
SOURCES = {
    source.name: source
    for source in (
        Source(
            "osm",
            "https://overpass-api.de/api/interpreter?data={query}",
            "buildings.osm",
            "© OpenStreetMap contributors",
            "ODbL 1.0: keep the credit, share changed data alike",
            DAY_S,
        ),
        Source(
            "census",
            "https://tigerweb.geo.census.gov/arcgis/rest/services/TIGERweb/tigerWMS_Census2020/MapServer/10/query"
            "?where=1%3D1&geometry={west},{south},{east},{north}&geometryType=esriGeometryEnvelope&inSR=4326"
            "&spatialRel=esriSpatialRelIntersects&outFields=GEOID,POP100&returnGeometry=true&outSR=4326"
            "&geometryPrecision=7&orderByFields=GEOID&f=geojson",
            "blocks.geojson",
            "U.S. Census Bureau",
            "public domain (U.S. government work)",
            30 * DAY_S,
        ),
        Source(
            "districts",
            "https://services5.arcgis.com/GfwWNkhOj9bNBqoJ/arcgis/rest/services/NYC_Community_Districts/FeatureServer"
            "/0/query?where=1%3D1&outFields=*&outSR=4326&f=pgeojson",
            "districts.geojson",
            "New York City Department of City Planning",
            "NYC Open Data terms",
            30 * DAY_S,
        ),
        Source(
            "orbits",
            "https://celestrak.org/NORAD/elements/gp.php?GROUP=gps-ops&FORMAT=csv",
            "gps-ops.txt",
            "CelesTrak (T. S. Kelso), from 18th Space Defense Squadron data",
            "free; once in two hours at most",
            DAY_S / 12,
            num_tries=1,
        ),
    )
}
NONE_HERE = {  # reported where a file holds nothing for the region or the day
    "census": "population: the census has no block in this region (it counts the United States), so the layer is left "
    "out; set [population] blocks to a file of your own",
    "districts": "districts: these (New York City's) do not touch this region, so every block counts as residential; "
    "set [population] districts to a file of your own",
    "orbits": f"element sets: these are more than {WARN_AGE_DAYS:.0f} days from --date, so the nominal constellation "
    "stands in; historical ones need a login at space-track.org (free): set [gps] orbits to a file of them",
}
# All that the reader knows: by keys, of some by values, and ways of water and of raised traffic. Of barriers, of which
# there are many, the commonest that are nothing are left there.
SOME = [("way", key, [*values]) for key, values in WATERS.items()]
AREAS = []  # keys of which areas may stand by many values
for key, rules in BY_VALUE.items():
    of_areas = {value for value, name in rules.items() if OF_AREAS in name}
    nothing = {value for value, name in rules.items() if isinstance(RULES[name], Nothing)}
    SOME.append(("nwr", key, [value for value in rules if value not in of_areas | nothing]))
    AREAS += [key] if of_areas else []
LIFE = (*STANDING, *NOT_BUILT)
AS_THEY_ARE = [key for key in MAYBE if not key.startswith(("barrier", *LIFE))]
ASKED = (
    *(f'nwr["{key}"];' for key in AS_THEY_ARE),
    f'nwr[~"^({"|".join(LIFE)}):({"|".join(LIVES)})$"~"."];',
    'nwr["barrier"]["barrier"!~"^(fence|hedge|kerb|bollard|gate)$"];',
    *(f'{what}["{key}"~"^({"|".join(values)})$"];' for what, key, values in SOME if values),
    'way["highway"]["layer"~"^[1-9]"];way["railway"]["layer"~"^[1-9]"];',
    *(f'way["{key}"];relation["{key}"];' for key in AREAS),
    'relation["type"="building"];',
)
OVERPASS = (
    "[out:xml][timeout:180][bbox:{south},{west},{north},{east}];("
    f"{''.join(ASKED)});(._;>;);out body;"
)
Settings = dict[str, Any]


@dataclass(frozen=True)
class FetchJob:
    """The settings of a fetch; checked when made.

    Attributes:
      bounds: west, south, east, north of the region in degrees.
      what: names of the sources to fetch, keys of `SOURCES`.
      day: of the GPS maps; None for the elements' own time (of nominal ones: today).
      urls: URL templates by name of a source, in place of those of `SOURCES`.
      margin_m: how far around the region buildings are fetched.

    Raises:
      InputError: an invalid setting, or a margin out of range.
    """

    bounds: tuple[float, ...]
    what: Sequence[str] = tuple(SOURCES)
    day: date | None = None
    urls: Mapping[str, str] = field(default_factory=dict)
    margin_m: float = 1000.0

    def __post_init__(self) -> None:
        """Check the settings; InputError as of the class."""
        check_bounds(self.bounds)
        for name in self.what or ("",):  # nothing at all is refused as an unknown name is
            one_of("--what", name, SOURCES)
        for name in self.urls:
            one_of("--source", name, SOURCES)
        if not 0 <= self.margin_m <= MOST_MARGIN_M:
            raise InputError(
                f"the margin must be from 0 to {MOST_MARGIN_M:,.0f} m, got {self.margin_m:g}"
            )

    @property
    def crs(self) -> str:
        """The region's UTM zone."""
        return utm_of(self.bounds)

    def box_m(self, margin_m: float) -> Bounds:
        """Return x_min, y_min, x_max, y_max of the region's box in `crs`, grown by a margin on each side."""
        box = shapely.box(*box_of(check_bounds(self.bounds), self.crs))
        return box.buffer(margin_m, join_style="mitre").bounds

    def requests(self) -> list[Source]:
        """Return the sources to ask, each with its URL for the region.

        Raises:
          InputError: a URL that cannot be used, or a region too large for the Overpass API.
        """
        return [self._source(name) for name in SOURCES if name in self.what]

    def _source(self, name: str) -> Source:
        """Return a source with its URL for the region.

        A source whose URL the user gave has the credit and the terms of its host; OpenStreetMap's stay the same
        everywhere.

        Raises:
          InputError: as of `requests`.
        """
        source = SOURCES[name]
        template = self.urls.get(name, source.url)
        margin_m = self.margin_m if name == "osm" else BLOCK_MARGIN_M
        box_m = self.box_m(margin_m)
        url = self._url_of(name, template, box_m)

        # A template without places is of a whole extract, which no server cuts out.
        area_km2 = shapely.box(*box_m).area / 1e6
        if name == "osm" and "{" in template and area_km2 > MOST_OVERPASS_KM2:
            raise InputError(
                f"the region with its margin of {margin_m:g} m has {area_km2:,.0f} km2, and the Overpass API, a shared "
                f"server, is asked for {MOST_OVERPASS_KM2:g} km2 at most: give an extract that covers it with "
                "--source osm=URL (download.geofabrik.de has them), or a smaller region"
            )

        asked = replace(source, url=url)
        parts = urlsplit(url)
        if name != "osm" and name in self.urls:
            return replace(asked, credit=parts.hostname or "", licence="ask its publisher")
        if name == "osm" and parts.path.endswith(".pbf"):
            return replace(asked, file=f"{source.file}.pbf")
        return asked

    def _url_of(self, name: str, template: str, box_m: Bounds) -> str:
        """Return the URL of a template, with the sides of a box in degrees and the query of the Overpass API.

        Args:
          name: of the source, for messages.
          template: as of `SOURCES`.
          box_m: x_min, y_min, x_max, y_max in `crs`.

        Raises:
          InputError: a URL that cannot be used.
        """
        box = transformer(self.crs, WGS84).transform_bounds(*box_m, densify_pts=21)
        sides = zip(("west", "south", "east", "north"), box, strict=True)
        degrees = {side: f"{value:.6f}" for side, value in sides}
        try:
            url = template.format(**degrees, query=quote(OVERPASS.format(**degrees), safe=""))
            parts = urlsplit(url)
            if parts.scheme not in ("http", "https") or not parts.hostname or not url.isprintable():
                raise ValueError("no address of the web")
        except (ValueError, LookupError, AttributeError) as error:
            raise InputError(
                f"the URL {template!r} of the source {name!r} cannot be used ({error}): it must begin with https:// or "
                "http:// and a host; {query}, {west}, {south}, {east} and {north} may stand in it, other braces doubled"
            ) from error
        return url


def fetch(job: FetchJob, folder: Path, *, most_bytes: int, overwrite: bool = False) -> Settings:
    """Get the files of a job into a folder, with ``scenario.toml``, which uses them, and ``fetch.json``.

    All files come into the folder at the end, the scenario last. Without ``osm`` in the job's ``what`` there is no
    scenario, as maps need buildings.

    Args:
      job: what to get.
      folder: where the files go; made if it is not there.
      most_bytes: the largest file accepted.
      overwrite: set aside what is there under the names of these files; otherwise only what an earlier fetch wrote, and
        nobody changed, may be there.

    Returns:
      What ``fetch.json`` holds: of every file where it is from, whose it is, when it came, its length and its SHA-256,
      and what was left out.

    Raises:
      InputError: something cannot be had, or the folder cannot be written to. Finished downloads stay in the cache.
    """
    sources = job.requests()
    names = [*(source.file for source in sources), RECORD_FILE, SCENARIO_FILE]
    with Workspace.open(folder, "fetch", is_shared=True) as workspace:
        if not overwrite:
            workspace.check_way((folder / name for name in names), REMEDY)
        with (
            only_writer(
                cache_folder(), "set XDG_CACHE_HOME to another folder that can be written to"
            ),
            tempfile.TemporaryDirectory(SCRATCH_SUFFIX, ".fetch.", folder) as scratch,
        ):
            stage = Path(scratch)
            workspace.begin(stage)
            sweep_scraps(cache_folder())
            record = _fetch(job, sources, stage, most_bytes)

            for path in sorted(stage.iterdir(), key=lambda path: path.name == SCENARIO_FILE):
                target = folder / path.name
                if overwrite and os.path.lexists(target) and not workspace.is_own(target):
                    workspace.set_aside(target)
                workspace.put(path, target)
    return record


def _fetch(job: FetchJob, sources: Sequence[Source], stage: Path, most_bytes: int) -> Settings:
    """Get the files of sources into a folder, write `SCENARIO_FILE` and `RECORD_FILE` there, and return the record.

    The scenario is written only where buildings are among what was fetched.

    Args:
      job: its region and day.
      sources: with their URLs for the region.
      stage: an empty folder.
      most_bytes: the size of the largest file that is accepted.

    Returns:
      ``bounds``; ``files``, a dictionary for each; and ``left_out``, a sentence for each source that has nothing in the
      region.

    Raises:
      InputError: a file cannot be had or read (then its copy in the cache is removed), or all were left out.
    """
    # The scenario's settings by section: those of all scenarios, then those of each source.
    today = datetime.now(UTC).date()
    settings: Settings = {
        "region": {"bounds": list(job.bounds)},
        "gps": {"orbits": NOMINAL, "times": [f"{job.day or today}{NOON}"]},
    }
    files = []
    left_out = []
    for source in sources:
        path = download(source, most_bytes)
        sections = _sections_of(job, source, path)
        if not sections:
            left_out.append(NONE_HERE[source.name])
            continue
        shutil.copyfile(path, stage / source.file)
        for section, values in sections.items():
            settings.setdefault(section, {}).update(values)
        files.append(_entry_of(source, path))
    if not files:
        raise InputError(f"nothing of --what can be fetched here ({'; '.join(left_out)})")
    record = {"bounds": list(job.bounds), "files": files, "left_out": left_out}
    (stage / RECORD_FILE).write_text(
        json.dumps(record, indent=1, ensure_ascii=False) + "\n", encoding="utf-8"
    )
    if "blocks" not in settings.get("population", {}):  # districts alone make no population
        settings.pop("population", None)
    if "buildings" in settings:
        scenario = f"{_head_of(files)}\n\n{tomli_w.dumps(settings)}"
        (stage / SCENARIO_FILE).write_text(scenario, encoding="utf-8")
    return record


def _sections_of(job: FetchJob, source: Source, path: Path) -> Settings:
    """Return the sections of a scenario that use a download, empty where it has nothing in the region.

    Args:
      job: its region and day.
      source: of the file, whose URL messages name.
      path: of the file in the cache.

    Raises:
      InputError: it cannot be read, and is removed, so that the same command downloads it again.
    """
    kind = f"{source.name} data"
    try:
        with readable(path, kind, "run the same command again", *BROKEN, what=source.url):
            return READERS[source.name](job, path, source.file)
    except InputError as error:
        path.unlink()
        raise InputError(str(error).replace(str(path), source.url)) from error


def _head_of(files: Sequence[Settings]) -> str:
    """Return the comment above a scenario, which credits the sources of its files, as of `_entry_of`."""
    credits = [f"# {file['source']}: {file['credit']} ({file['licence']})" for file in files]
    return "\n".join(
        ["# Made by jaxurban fetch; fetch.json says where each file is from.", *credits]
    )


def _entry_of(source: Source, path: Path) -> Settings:
    """Return what `RECORD_FILE` says of a file: where it is from, whose it is, when it came, and what it is.

    Args:
      source: of the file.
      path: of its copy in the cache, of which `download` makes the name.
    """
    fetched = datetime.fromtimestamp(path.stat().st_mtime, UTC)
    return {
        "source": source.name,
        "file": source.file,
        "credit": source.credit,
        "licence": source.licence,
        "url": source.url,
        "fetched_utc": fetched.isoformat(timespec="seconds"),
        "num_bytes": path.stat().st_size,
        "sha256": path.name.split("-")[1],
    }


def _read_osm(job: FetchJob, path: Path, file: str) -> Settings:
    """Return the sections of a scenario that use OpenStreetMap data.

    Args:
      job: its region.
      path: the download, XML of the Overpass API, or a whole extract.
      file: its name in the user's folder.

    Raises:
      InputError: the file cannot be read, or the server sent a part of the data only.
    """
    read_osm(path)
    return {"buildings": {"source": file}}


def _read_census(job: FetchJob, path: Path, file: str) -> Settings:
    """Return the sections of a scenario that use census blocks, empty where there is no block.

    Args:
      job: its region.
      path: the download, GeoJSON.
      file: its name in the user's folder.

    Raises:
      InputError: the server sent an error or a part of the blocks only, or the blocks cannot be read.
    """
    content = json.loads(path.read_bytes())
    if "features" not in content:
        raise InputError(
            f"{str(path)!r} holds no features but {str(content)[:200]}: run the same command later"
        )
    # ArcGIS writes it in either place.
    holders = (content, content.get("properties", {}))
    is_cut = any(holder.get("exceededTransferLimit") for holder in holders)
    if is_cut:
        raise InputError(
            f"{str(path)!r} holds a part of the region's blocks only: ask for a smaller region"
        )
    if not content["features"]:
        return {}
    # What a run could not read is refused now.
    read_blocks(Population(blocks=path, block_field=BLOCK_FIELD), job.crs)
    return {"population": {"blocks": file, "block_field": BLOCK_FIELD}}


def _read_districts(job: FetchJob, path: Path, file: str) -> Settings:
    """Return the sections of a scenario that use district polygons, empty where none touches the region.

    Args:
      job: its region.
      path: the download, a vector file.
      file: its name in the user's folder.

    Raises:
      InputError: the polygons cannot be read, or there are none.
    """
    polygons, _, _ = read_districts(path, job.crs)
    if not len(polygons):
        raise InputError(
            f"{str(path)!r} holds no polygons: name another file with --source districts=URL"
        )
    if not shapely.intersects(polygons, shapely.box(*job.box_m(BLOCK_MARGIN_M))).any():
        return {}
    return {"population": {"districts": file}}


def _read_orbits(job: FetchJob, path: Path, file: str) -> Settings:
    """Return the sections of a scenario that use element sets, empty where they are too far from the job's day.

    Without a day the maps are of the middle one of the elements' epochs.

    Args:
      job: its day.
      path: the download.
      file: its name in the user's folder.
    """
    epoch = str(middle_epoch(read_orbits(path)))
    if job.day and abs((job.day - date.fromisoformat(epoch[:10])).days) > WARN_AGE_DAYS:
        return {}
    time = f"{job.day}{NOON}" if job.day else epoch
    LOG.info(f"orbits: the GPS maps are of {time}")
    return {"gps": {"orbits": file, "times": [time]}}


READERS = {
    "osm": _read_osm,
    "census": _read_census,
    "districts": _read_districts,
    "orbits": _read_orbits,
}
