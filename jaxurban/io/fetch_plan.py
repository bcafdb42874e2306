"""What to fetch for a region: the public sources, where they are and whose, and the requests that a job makes."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, date, datetime
from functools import cached_property
from urllib.parse import quote, urlsplit

import shapely

from jaxurban.errors import InputError, one_of
from jaxurban.io.download import Source
from jaxurban.io.read.orbits import WARN_AGE_DAYS
from jaxurban.world.grid import WGS84, Bounds, check_bounds, transformer, utm_crs

ENVIRONMENT_PREFIX = "JAXURBAN_SOURCE_"  # JAXURBAN_SOURCE_OSM=https://a.mirror/...
DAY_S = 24 * 3600.0
MOST_OVERPASS_KM2 = 100.0  # a dense city of this size is some 200 MB of XML and a minute of a shared server's time
MOST_MARGIN_M = 20_000.0
BLOCK_MARGIN_M = 100.0  # the maps' box is snapped outward and densified, and NAD83 is a metre or two off WGS 84
# Where the Census Bureau counts people and the city has districts, roughly: the response decides.
CENSUS_BOX, NYC_BOX = (-180.0, 17.0, -64.0, 72.0), (-74.26, 40.49, -73.70, 40.92)
NYC_FIELD = "BoroCD"
COUNTY_DIGITS = 5
FILES = {  # by what is asked for
    "osm": ("buildings.osm", "buildings.osm.pbf"),
    "census": ("population.csv", "blocks.parquet"),
    "districts": ("districts.geojson",),
    "orbits": ("gps-ops.txt",),
}
TIGERWEB = (
    "https://tigerweb.geo.census.gov/arcgis/rest/services/TIGERweb/tigerWMS_Census{year}/MapServer/{layer}/query"
    "?where=1%3D1&geometry={west},{south},{east},{north}&geometryType=esriGeometryEnvelope&inSR=4326"
    "&spatialRel=esriSpatialRelIntersects&outFields=GEOID,POP100&returnGeometry=false&orderByFields=GEOID"
    "&resultOffset={offset}&f=json"
)
TIGER = "https://www2.census.gov/geo/tiger/"
CENSUS = {  # by year: the blocks' number in TIGERweb's map, and where their outlines are
    "2020": ("10", TIGER + "TIGER2020PL/LAYER/TABBLOCK/2020/tl_2020_{county}_tabblock20.zip"),
    "2010": ("18", TIGER + "TIGER2010/TABBLOCK/2010/tl_2010_{county}_tabblock10.zip"),
}
CENSUS_TERMS = ("U.S. Census Bureau", "public domain (U.S. government work)", 30 * DAY_S)
# The Census Data API asks for a personal key; TIGERweb, which holds the same counts by block, does not. CelesTrak
# updates every two hours and wants programs to stop at the first refusal; two-line elements cannot name satellites
# catalogued since 2026, so its OMM (CSV) is asked for.
SOURCES = (
    Source(
        "osm",
        "https://overpass-api.de/api/interpreter?data={query}",
        "© OpenStreetMap contributors",
        "ODbL 1.0: keep the credit, share changed data alike",
        DAY_S,
    ),
    Source("population", "", *CENSUS_TERMS),
    Source("blocks", "", *CENSUS_TERMS),
    Source(
        "districts",
        "https://services5.arcgis.com/GfwWNkhOj9bNBqoJ/arcgis/rest/services/NYC_Community_Districts/FeatureServer"
        "/0/query?where=1%3D1&outFields=*&outSR=4326&f=pgeojson",
        "New York City Department of City Planning",
        "NYC Open Data terms",
        30 * DAY_S,
    ),
    Source(
        "orbits",
        "https://celestrak.org/NORAD/elements/gp.php?GROUP=gps-ops&FORMAT=csv",
        "CelesTrak (T. S. Kelso), from 18th Space Defense Squadron data",
        "free; once in two hours at most",
        DAY_S / 12,
        num_tries=1,
    ),
)
OVERPASS = (
    "[out:xml][timeout:180][bbox:{1:.6f},{0:.6f},{3:.6f},{2:.6f}];"
    '(way["building"];way["building:part"];relation["building"];relation["building:part"];);(._;>;);out body;'
)


@dataclass(frozen=True)
class FetchJob:
    """The settings of a fetch; checked when made.

    Attributes:
      bounds: west, south, east, north of the region in degrees.
      what: of `FILES`.
      day: of the GPS maps; None for the elements' own time (of nominal ones: today).
      given_urls: URL templates by source that replace the known ones, and those that the environment names.
      margin_m: how far around the region buildings are fetched.
      census_year: of `CENSUS`.
      counties: five-digit ids; empty: those of the blocks that touch the region.
      district_field: the districts' label.

    Raises:
      InputError: a setting that is none, a URL that cannot be used, or a region too large for the Overpass API.
    """

    bounds: tuple[float, ...]
    what: Sequence[str] = tuple(FILES)
    day: date | None = None
    given_urls: Mapping[str, str] = field(default_factory=dict)
    margin_m: float = 1000.0
    census_year: str = "2020"
    counties: Sequence[str] = ()
    district_field: str = NYC_FIELD

    def __post_init__(self) -> None:
        check_bounds(self.bounds)
        for name in self.what or ("",):
            one_of("--what", name, FILES)
        if bad := [county for county in self.counties if not (len(county) == COUNTY_DIGITS and county.isdigit())]:
            raise InputError(f"the county {bad[0]!r} must be five digits, state and county (36061 is Manhattan)")
        if not 0 <= self.margin_m <= MOST_MARGIN_M:
            raise InputError(f"the margin must be from 0 to {MOST_MARGIN_M:,.0f} m, got {self.margin_m:g}")
        for name in self.sources:
            self.url(name)
        x_min, y_min, x_max, y_max = transformer(WGS84, self.crs).transform_bounds(*self.box(self.margin_m))
        area_km2 = (x_max - x_min) * (y_max - y_min) / 1e6
        if "osm" in self.what and "{" in self.sources["osm"].url and area_km2 > MOST_OVERPASS_KM2:
            raise InputError(
                f"the region with its margin of {self.margin_m:g} m has {area_km2:,.0f} km2, and the Overpass API, a "
                f"shared server, is asked for {MOST_OVERPASS_KM2:g} km2 at most: give an extract that covers it with "
                "--extract URL (download.geofabrik.de has them), or a smaller region"
            )

    @cached_property
    def urls(self) -> dict[str, str]:
        """The URL templates that replace those of the sources, by source."""
        environment = {source.name: os.environ.get(ENVIRONMENT_PREFIX + source.name.upper()) for source in SOURCES}
        return {name: url for name, url in environment.items() if url} | dict(self.given_urls)

    @cached_property
    def sources(self) -> dict[str, Source]:
        """The sources by name, each with the URL template that is used."""
        layer, blocks = CENSUS[one_of("the census year", self.census_year, CENSUS)]
        counts = TIGERWEB.replace("{year}", self.census_year).replace("{layer}", layer)
        sources = {source.name: source for source in SOURCES}
        for name, url in ({"population": counts, "blocks": blocks} | self.urls).items():
            sources[name] = replace(sources[one_of("a source", name, sources)], url=url)
        return sources

    def has(self, name: str, box: Bounds) -> bool:
        """Whether a source serves the region: one for a box, or another place that was named."""
        return name in self.urls or shapely.box(*self.bounds).intersects(shapely.box(*box))

    @cached_property
    def crs(self) -> str:
        """The region's UTM zone."""
        west, south, east, north = self.bounds
        return utm_crs((west + east) / 2, (south + north) / 2)

    def box(self, margin_m: float) -> Bounds:
        """Return west, south, east, north of the region's projected box, grown by a margin."""
        to_m = transformer(WGS84, self.crs)
        x_min, y_min, x_max, y_max = to_m.transform_bounds(*check_bounds(self.bounds), densify_pts=21)
        grown = (x_min - margin_m, y_min - margin_m, x_max + margin_m, y_max + margin_m)
        return transformer(self.crs, WGS84).transform_bounds(*grown, densify_pts=21)

    def url(self, name: str, county: str = "{county}", offset: int = 0) -> str:
        """Return the URL of a source for the region, of a county or from a row on where it comes in parts."""
        url = self.sources[name].url
        box = self.box(self.margin_m if name == "osm" else BLOCK_MARGIN_M)
        places = {side: f"{value:.6f}" for side, value in zip(("west", "south", "east", "north"), box, strict=True)}
        query = quote(OVERPASS.format(*box), safe="")
        try:
            if urlsplit(url).scheme not in ("http", "https") or not urlsplit(url).hostname:
                raise ValueError("it must begin with https:// or http:// and a host")
            return url.format(**places, query=query, county=county, offset=offset)
        except (ValueError, LookupError, AttributeError) as error:
            unknown = isinstance(error, LookupError)
            why = f"the placeholder {{{error.args[0]}}} is none of {{query}}, {{west}} ..." if unknown else error
            raise InputError(
                f"the URL {url!r} of source {name!r} cannot be used ({why}): mend it, and double an odd brace"
            ) from error


def plan_fetch(job: FetchJob) -> tuple[list[tuple[str, str]], list[str]]:
    """Return source and URL of each request of a job with an empty cache, and a sentence for each part left out.

    A ``{county}`` in a URL is not known before the first response.

    Raises:
      InputError: nothing can be fetched.
    """
    requests: list[tuple[str, str]] = []
    left_out: list[str] = []
    if "osm" in job.what:
        requests.append(("osm", job.url("osm")))
    if "census" in job.what and job.has("population", CENSUS_BOX):
        requests.append(("population", job.url("population")))
        requests += [("blocks", job.url("blocks", county)) for county in job.counties or ("{county}",)]
    elif "census" in job.what:
        left_out.append(
            "population: no source is known outside the United States, so the layer is left out; "
            "set [population] blocks and table to files of your own"
        )
    if "districts" in job.what and job.has("districts", NYC_BOX):
        requests.append(("districts", job.url("districts")))
    elif "districts" in job.what:
        left_out.append(
            "districts: none are known for this region (only New York City's), so every block counts "
            "as residential; name a GeoJSON file with --districts URL"
        )
    is_current = job.day is None or abs((job.day - datetime.now(UTC).date()).days) <= WARN_AGE_DAYS
    if "orbits" in job.what and (is_current or "orbits" in job.urls):
        requests.append(("orbits", job.url("orbits")))
    elif "orbits" in job.what:
        left_out.append(
            f"element sets: CelesTrak has the current ones only, and {job.day} is not within "
            f"{WARN_AGE_DAYS:.0f} days; historical ones need a login at space-track.org (free), so "
            "the nominal constellation stands in; set [gps] orbits to a file of your own"
        )
    if not requests:
        raise InputError(f"nothing of --what can be fetched here ({'; '.join(left_out)})")
    return requests, left_out
