"""What the page may ask for: the parameters of each request, checked before anything is done."""

from typing import Annotated, Any

from pydantic import Base64Bytes, BaseModel, ConfigDict, Field, ValidationError

from jaxurban.errors import InputError
from jaxurban.flights.missions.parts import Datum
from jaxurban.settings import DEFAULTS, FlownBy, Rules, UnknownHeights

MOST_LETTERS = 64 * 1024  # of zones
Index = Annotated[int, Field(strict=True, ge=0, le=10**6)]
Name = Annotated[str, Field(max_length=100)]
Degrees = Annotated[float, Field(strict=True, ge=-360, le=360)]
Metres = Annotated[float, Field(strict=True, ge=0, le=10**5)]
Weight = Annotated[float, Field(strict=True, ge=0, le=10**30)]
MapIndex = tuple[Index, Index, Index]  # of an altitude, a time and a time of day of the scene
Place = tuple[Degrees, Degrees]  # longitude, latitude


class Request(BaseModel):
    """Parameters of a request, none here; those that are not known are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class RulesRequest(Request):
    """What routes and missions must keep, and when they fly.

    ``zones`` is GeoJSON of the no-fly zones drawn, as text. Left out, ``vertical_clearance_m`` is that of the maps'
    scenario, and ``unknown_heights`` that of flights (`Constraints.for_flight`).
    """

    at: MapIndex
    clearance_m: Metres = Rules.clearance_m
    vertical_clearance_m: Metres | None = None
    unknown_heights: UnknownHeights | None = None
    zones: Annotated[str, Field(max_length=MOST_LETTERS)] = ""


class Plan(RulesRequest):
    """A route that is wanted; `jaxurban.plan` names the same.

    Left out, ``flight_m``, the altitude of flight, is the level of ``at``; speed and power are those of the vehicle.
    """

    start: Place
    goal: Place
    weights: dict[Name, Weight]
    planner: Name = DEFAULTS.planner
    flight_m: Metres | None = None
    speed_m_s: Metres | None = None
    power_w: Metres | None = None
    snap: Annotated[bool, Field(strict=True)] = True
    on_ground: Annotated[bool, Field(strict=True)] = False


class MissionRequest(RulesRequest):
    """A mission of another tool.

    ``file`` is the name of its file, ``data`` its bytes in base64, ``heights`` what its heights are above, and
    ``autopilot`` which one flies it, where it leaves these open.
    """

    file: Name
    data: Base64Bytes
    heights: Datum | None = None
    autopilot: FlownBy | None = None


class View(Request):
    """A map: its layer, and the numbers of its altitude, time and time of day in the lists of the scene.

    ``home`` is that of the layer of returns, which has no values without it. ``plan`` is a route whose rules close the
    cells of the layer of these; left out, the scenario's do.
    """

    layer: Name
    at: MapIndex
    home: Place | None = None
    plan: Plan | None = None


class Tile(View):
    """A tile of a map (`jaxurban.viewer.tiles`)."""

    stride: Index
    row: Index
    col: Index


class Cell(Request):
    """A cell, at an altitude, time and time of day, and the home of the layer of returns, if one is chosen."""

    at: MapIndex
    row: Index
    col: Index
    home: Place | None = None


class SkyRequest(Request):
    """The sky over a place, at an altitude and time."""

    at: MapIndex
    place: Place


class Save(Plan):
    """A route as a file of a format, by its suffix (`jaxurban.flights.export.write.FORMATS`)."""

    format: Name


def parse(kind: type[Request], params: Any) -> Any:
    """Return the parameters of a request, checked and as an instance of its kind.

    Args:
      kind: the class of the request.
      params: what the page sent, any value of JSON.

    Raises:
      InputError: they are not parameters of its kind; the sentence says where the first fault is.
    """
    try:
        return kind.model_validate(params)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(str(part)[:40] for part in first["loc"]) or "the request"
        raise InputError(f"{where}: {first['msg']}") from error
