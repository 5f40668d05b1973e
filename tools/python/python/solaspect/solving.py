"""From an array to the Sun's centre on the plate."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from . import _native

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from ._native import Solution, Track
    from ._types import AnyInstrument, AnyPlace, AnyTime


def solve(
    array: npt.NDArray[np.integer[Any] | np.floating[Any]],
    *,
    instrument: AnyInstrument | None = None,
    time: AnyTime | None = None,
    place: AnyPlace | None = None,
    target: tuple[float, float] | None = None,
    prior: Track | None = None,
    saturation_dn: int | None = None,
    corner_px: tuple[int, int] | None = None,
) -> Solution:
    """Find the Sun's centre on the plate, and the telescope's offset from its target.

    The same arguments always give the same solution: that of the program `solaspect solve`, bit for bit. The GIL is released meanwhile,
    so threads solve in parallel; the array must not be written to until the solution is there.

    Parameters
    ----------
    array
        The frame's pixels, rows by columns. An array of uint8 or uint16 that is C-contiguous and in the machine's byte order is not
        copied; any other becomes uint8 or uint16. Negative, larger and floating-point numbers are scaled as the program scales those of a
        file; a pixel that is not a number is masked.
    instrument
        An `Instrument`, the path of its file, or the name of a built-in one; "demo" if not given. A file is read in every call: for
        many frames load it once.
    time
        Mid-exposure, with its zone: text ("2013-09-21T18:00:00Z"), a `datetime` with `tzinfo`, or an astropy `Time`. It gives the
        Sun's radius; without it the radius is free.
    place
        Latitude (deg), longitude (deg, east positive) and height (m), or an astropy `EarthLocation`. With it and `time` the solution
        has an offset.
    target
        Where the telescope should point, (x, y) in arcsec from the Sun's centre towards solar west and north; the centre if not given.
    prior
        The `track` of the previous frame's solution: the search starts there.
    saturation_dn
        The value at which a pixel saturates. If not given: 255 for uint8; for uint16 4095, or 65535 if a pixel is brighter.
    corner_px
        Column and row of the sensor at which the array begins, if only a part of the sensor was read.

    Raises
    ------
    TypeError, ValueError
        An invalid argument; the message names it. A frame without a Sun is not an error: its `quality` is "none" and `reason` gives the reason.
    SolaspectError
        An instrument file that cannot be used.

    Examples
    --------
    >>> import solaspect
    >>> [frame] = solaspect.simulate(frames=1)
    >>> solution = solaspect.solve(frame.array, time=frame.time, place=(34.49, -104.2218, 38405.0))
    >>> solution.quality
    'fine'
    >>> bool(abs(solution.sun_px - frame.sun_px).max() < 0.05)
    True
    >>> solaspect.solve(frame.array[:100])
    Traceback (most recent call last):
        ...
    ValueError: array: size: expected 1296 x 966 px as of instrument "demo", found 1296 x 100; a part of the sensor is placed by CORNER-X and CORNER-Y (or XORGSUBF and YORGSUBF, DETSEC, CCDSEC)
    >>> solaspect.solve(frame.array, time="2013-09-21T18:00:00")
    Traceback (most recent call last):
        ...
    ValueError: time: expected a time with its zone such as "2013-09-21T18:00:00Z", found "2013-09-21T18:00:00"
    """
    return _native.solve(
        array,
        instrument=instrument,
        time=time,
        place=place,
        target=target,
        prior=prior,
        saturation_dn=saturation_dn,
        corner_px=corner_px,
    )
