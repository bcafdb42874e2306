"""Flights from the logs of PX4 (ULog), by ``pyulog``: the fixes of the receiver."""

import io
from contextlib import redirect_stdout
from pathlib import Path

import numpy as np

from jaxurban.errors import InputError
from jaxurban.flights.missions.lines import Line, Shapes
from jaxurban.flights.missions.parts import DamagedError
from jaxurban.io.sniff import in_own_words

TOPIC = "vehicle_gps_position"
MESSAGES = b"ABCDFILMOPQRS"  # their types, each a byte
# Fields of old logs, whole numbers of 1e-7 degrees and of millimetres, and of new ones, in degrees and metres.
OLD = {"lon": 1e-7, "lat": 1e-7, "alt": 1e-3}
NEW = {"longitude_deg": 1.0, "latitude_deg": 1.0, "altitude_msl_m": 1.0}
LEAST_FIX = 3  # fix_type of a fix with a height


def ulog_lines(path: Path, data: bytes) -> Shapes:
    """Return the fixes of a log as one line above the geoid, with their times.

    Raises:
      InputError: ``pyulog`` is not installed.
      ValueError: the file cannot be read, is cut short or damaged, or holds no fix.
    """
    try:
        from pyulog import ULog
    except ImportError as error:
        raise InputError("ULog is read by pyulog: pip install 'jaxurban[ulog]'") from error
    with in_own_words(Exception), redirect_stdout(io.StringIO()):
        # Of a log that is cut pyulog reads what is left, and others back and forth without end.
        start = 16  # bytes of the header
        while start < len(data) and data[start + 2 : start + 3] in MESSAGES:
            start += 3 + int.from_bytes(data[start : start + 2], "little")
        if start != len(data):
            raise EOFError
        log = ULog(io.BytesIO(data), [TOPIC])
        if log.file_corruption:
            raise EOFError
    if not log.data_list:
        raise DamagedError("it holds no fix of a receiver, as the topic vehicle_gps_position")
    fields = log.data_list[0].data
    is_fix = fields["fix_type"] >= LEAST_FIX
    units = OLD if "lon" in fields else NEW
    columns = [fields[name][is_fix] * unit for name, unit in units.items()]
    moments = fields["time_utc_usec"][is_fix].astype("datetime64[us]")
    times = np.datetime_as_string(moments, timezone="UTC").tolist()
    points = list(map(tuple, np.column_stack(columns).tolist()))
    return [Line("fixes", points, "geoid", times=times)], len(is_fix)
