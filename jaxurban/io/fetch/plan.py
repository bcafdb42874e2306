"""What to fetch for a region: the settings of the job, and the downloads that follow from them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date
from functools import cached_property

import shapely

from jaxurban.errors import InputError, one_of
from jaxurban.io.fetch.download import Download
from jaxurban.io.fetch.reading import check_orbits, osm_format, read_block_zip, read_counts, read_geojson
from jaxurban.io.fetch.sources import CENSUS_YEARS, MOST_OVERPASS_KM2, Source, overpass_query, sources_of
from jaxurban.io.read.orbits import WARN_AGE_DAYS
from jaxurban.world.grid import WGS84, Bounds, check_bounds, transformer, utm_crs

WHAT = ("osm", "census", "districts", "orbits")
BLOCK_MARGIN_M = 100.0  # the maps' box is snapped outward and densified, and NAD83 is a metre or two off WGS 84
# Where the Census Bureau counts people, roughly (its own response decides): the states, Hawaii, Alaska, Puerto Rico.
CENSUS_BOXES = (
    (-125.0, 24.0, -66.5, 49.5),
    (-161.0, 18.5, -154.0, 22.5),
    (-180.0, 51.0, -129.0, 72.0),
    (172.0, 51.0, 180.0, 54.0),
    (-68.0, 17.5, -64.0, 19.0),
)
NYC_FIELD = "BoroCD"
NYC_BOX = (-74.26, 40.49, -73.70, 40.92)


@dataclass(frozen=True)
class FetchJob:
    """The settings of a fetch; checked when made.

    Attributes:
      bounds: west, south, east, north of the region in degrees.
      what: of `WHAT`.
      day: of the GPS maps; None for the elements' own time (of nominal ones: today).
      today: tells whether current element sets serve that day.
      given_urls: URL templates by source that replace the known ones.
      margin_m: how far around the region buildings are fetched.
      census_year: of `CENSUS_YEARS`.
      counties: five-digit ids; empty: those of the blocks that touch the region.
      district_field: the districts' label.
      most_bytes: the largest file accepted, also when unpacked.
    """

    bounds: tuple[float, float, float, float]
    day: date | None
    today: date
    what: tuple[str, ...] = WHAT
    given_urls: Mapping[str, str] = field(default_factory=dict)
    margin_m: float = 1000.0
    census_year: str = CENSUS_YEARS[0]
    counties: tuple[str, ...] = ()
    district_field: str = NYC_FIELD
    most_bytes: int = 500 * 2**20

    def __post_init__(self) -> None:
        check_bounds(self.bounds)
        for name in self.what:
            one_of("--what", name, WHAT)
        if not self.what:
            raise InputError(f"--what names nothing: choose of {', '.join(WHAT)}")
        if bad := [county for county in self.counties if not (len(county) == 5 and county.isdigit())]:
            raise InputError(f"the county {bad[0]!r} must be five digits, state and county (36061 is Manhattan)")
        if not 0 <= self.margin_m <= 20_000:
            raise InputError(f"the margin must be from 0 to 20,000 m, got {self.margin_m:g}")
        _ = self.sources  # checks the URLs

    @cached_property
    def sources(self) -> dict[str, Source]:
        """The sources by name."""
        return sources_of(self.census_year, self.given_urls)

    @property
    def has_nyc_labels(self) -> bool:
        """Whether the districts are New York City's, whose commercial ones the scenario knows by default."""
        return self.district_field == NYC_FIELD and _touches(self.bounds, (NYC_BOX,))

    @cached_property
    def crs(self) -> str:
        """The region's UTM zone."""
        west, south, east, north = self.bounds
        return utm_crs((west + east) / 2, (south + north) / 2)

    def box(self, margin_m: float) -> Bounds:
        """Return west, south, east, north of the region's projected box, grown by a margin."""
        to_m = transformer(WGS84, self.crs)
        x_min, y_min, x_max, y_max = to_m.transform_bounds(*self.bounds, densify_pts=21)
        grown = (x_min - margin_m, y_min - margin_m, x_max + margin_m, y_max + margin_m)
        return transformer(self.crs, WGS84).transform_bounds(*grown, densify_pts=21)


@dataclass(frozen=True)
class FetchPlan:
    """The downloads of a job, as far as they are known before the first response, and what is left out and why.

    Attributes:
      downloads: in order; a ``{county}`` in a URL is not known yet.
      left_out: a sentence each.
    """

    downloads: tuple[Download, ...]
    left_out: tuple[str, ...]

    def of(self, name: str) -> Download | None:
        """Return the first download from a source, None without one."""
        return next((download for download in self.downloads if download.source.name == name), None)


def plan_fetch(job: FetchJob) -> FetchPlan:
    """Return the downloads that a job makes.

    Raises:
      InputError: the region is too large for the Overpass API.
    """
    downloads: list[Download] = []
    left_out: list[str] = []
    sources = job.sources
    if "osm" in job.what:
        downloads.append(_osm_download(job))
    if "census" in job.what:
        if sources["population"].is_given or _touches(job.bounds, CENSUS_BOXES):
            downloads.append(population_download(job, 0))
            downloads += [block_download(job, county) for county in job.counties or ("{county}",)]
        else:
            left_out.append(
                "population: no source is known outside the United States, so the layer is left out; "
                "set [population] blocks and table to files of your own"
            )
    if "districts" in job.what:
        source = sources["districts"]
        if source.is_given or _touches(job.bounds, (NYC_BOX,)):
            field = job.district_field
            downloads.append(Download(source, source.url, lambda path: read_geojson(path, job.crs, field)))
        else:
            left_out.append(
                "districts: none are known for this region (only New York City's), so every block counts "
                "as residential; name a GeoJSON file with --districts URL"
            )
    if "orbits" in job.what:
        elements = sources["orbits"]
        if elements.is_given or job.day is None or abs((job.day - job.today).days) <= WARN_AGE_DAYS:
            downloads.append(Download(elements, elements.url, lambda path: check_orbits(path, job.day)))
        else:
            left_out.append(
                f"element sets: CelesTrak has the current ones only, and {job.day} is not within "
                f"{WARN_AGE_DAYS:.0f} days; historical ones need a login at space-track.org (free), so "
                "the nominal constellation stands in; set [gps] orbits to a file of your own"
            )
    return FetchPlan(tuple(downloads), tuple(left_out))


def _touches(bounds: Bounds, boxes: Sequence[Bounds]) -> bool:
    return any(shapely.box(*bounds).intersects(shapely.box(*box)) for box in boxes)


def _osm_download(job: FetchJob) -> Download:
    source, box = job.sources["osm"], job.box(job.margin_m)
    url = source.fill(box, query=overpass_query(box))
    if "{" not in source.url:  # an extract
        return Download(source, url, osm_format)
    x_min, y_min, x_max, y_max = transformer(WGS84, job.crs).transform_bounds(*box)
    area_km2 = (x_max - x_min) * (y_max - y_min) / 1e6
    if area_km2 > MOST_OVERPASS_KM2:
        raise InputError(
            f"the region with its margin of {job.margin_m:g} m has {area_km2:,.0f} km2, and the Overpass API, a "
            f"shared server, is asked for {MOST_OVERPASS_KM2:g} km2 at most: give an extract that covers it with "
            "--extract URL (download.geofabrik.de has them), or a smaller region"
        )
    return Download(source, url, osm_format)


def population_download(job: FetchJob, offset: int) -> Download:
    """Return the download of the counts of the region's blocks, from a row on."""
    source = job.sources["population"]
    return Download(source, source.fill(job.box(BLOCK_MARGIN_M), offset=str(offset)), read_counts)


def block_download(job: FetchJob, county: str) -> Download:
    """Return the download of the blocks of a county."""
    source = job.sources["blocks"]
    return Download(source, source.fill(county=county), lambda path: read_block_zip(path, job.most_bytes))
