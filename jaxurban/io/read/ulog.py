"""Flights from the logs of PX4 (ULog), by ``pyulog``: the fixes of the receiver."""

import io
from contextlib import redirect_stdout
from pathlib import Path

import numpy as np

from jaxurban.errors import InputError
from jaxurban.io.read.mission_lines import Line, Shapes
from jaxurban.io.read.mission_parts import DamagedError
from jaxurban.io.read.sniff import in_own_words

TOPIC = "vehicle_gps_position"
MOST_BACK = 10_000
# Fields of old logs, whole numbers of 1e-7 degrees and of millimetres, and of new ones, in degrees and metres.
OLD = {"lon": 1e-7, "lat": 1e-7, "alt": 1e-3}
NEW = {"longitude_deg": 1.0, "latitude_deg": 1.0, "altitude_msl_m": 1.0}
LEAST_FIX = 3  # fix_type of a fix with a height


class _Log(io.BytesIO):
    """The bytes of a log; EOFError where it is read back and forth without end, as pyulog reads some damaged ones."""

    num_back = 0

    def seek(self, offset: int, whence: int = 0) -> int:
        """Move as a file does, back at most `MOST_BACK` times."""
        self.num_back += offset < 0
        if self.num_back > MOST_BACK:
            raise EOFError
        return super().seek(offset, whence)


def ulog_lines(path: Path, data: bytes) -> Shapes:
    """Return the fixes of a log as one line above the geoid, with their times.

    Raises:
      InputError: ``pyulog`` is not installed.
      ValueError: the file cannot be read, or holds no fix.
    """
    try:
        from pyulog import ULog
    except ImportError as error:
        raise InputError("ULog is read by pyulog: pip install 'jaxurban[ulog]'") from error
    with in_own_words(Exception), redirect_stdout(io.StringIO()):
        log = ULog(_Log(data), [TOPIC])
    if not log.data_list:
        raise DamagedError("it holds no fix of a receiver, as the topic vehicle_gps_position")
    fields = log.data_list[0].data
    is_fix = fields["fix_type"] >= LEAST_FIX
    units = OLD if "lon" in fields else NEW
    lon, lat, height_m = (fields[name][is_fix] * unit for name, unit in units.items())
    moments = fields["time_utc_usec"][is_fix].astype("datetime64[us]")
    times = np.datetime_as_string(moments, timezone="UTC").tolist()
    points = list(zip(lon.tolist(), lat.tolist(), height_m.tolist(), strict=True))
    return [Line("fixes", points, "geoid", times=times)], len(is_fix)
