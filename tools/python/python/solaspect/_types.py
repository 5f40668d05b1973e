"""Types of arguments."""

from __future__ import annotations

import datetime
import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Tuple, Union

from ._native import Instrument

if TYPE_CHECKING:
    from astropy.coordinates import EarthLocation
    from astropy.time import Time

PathLike = Union[str, "os.PathLike[str]"]
#: An instrument, the path of its file, or the name of a built-in one.
AnyInstrument = Union[Instrument, PathLike]
#: Text with its zone, a datetime with its zone, or astropy's Time.
AnyTime = Union[str, datetime.datetime, "Time"]
#: Latitude (deg), longitude (deg, east positive) and height (m), or astropy's EarthLocation.
AnyPlace = Union[Tuple[float, float, float], "EarthLocation"]
Paths = Union[PathLike, Sequence[PathLike]]
