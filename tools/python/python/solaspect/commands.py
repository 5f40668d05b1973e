"""Commands of the program as functions: simulated frames, refinement and calibration.

Their keywords are the program's options; `solaspect COMMAND --help` describes each.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

from . import _native
from ._native import Instrument
from .archive import Refined

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ._native import SimulatedFrame
    from ._types import AnyInstrument, AnyPlace, AnyTime, PathLike, Paths

__all__ = ["calibrate_camera", "calibrate_mounting", "calibrate_plate", "compare", "refine", "simulate"]


def _paths(paths: Paths) -> list[str]:
    """One path or several, as a list."""
    return [os.fspath(paths)] if isinstance(paths, (str, os.PathLike)) else [os.fspath(path) for path in paths]


def _instrument(instrument: AnyInstrument) -> str:
    """The argument of `--instrument`."""
    return os.fspath(instrument.path if isinstance(instrument, Instrument) else instrument)


def _options(**keywords: Any) -> list[str]:
    """Keywords as options: None and False are omitted, a tuple is one value with commas, a list an option that is repeated."""
    options = []
    for name, value in keywords.items():
        option = "--" + name.replace("_", "-")
        if value is None or value is False:
            continue
        if value is True:
            options.append(option)
            continue
        for one in value if isinstance(value, list) else [value]:
            text = ",".join(map(str, one)) if isinstance(one, tuple) else one
            options.append(f"{option}={text}")
    return options


def simulate(
    *,
    frames: int = 10,
    seed: int = 1,
    instrument: AnyInstrument = "demo",
    utc: AnyTime = "2013-09-21T18:00:00Z",
    rate: float = 4.0,
    drift: bool = False,
    place: AnyPlace | None = None,
    sun_radius: float | None = None,
    peak: float | None = None,
    sunspots: int | str | None = None,
    smear: float | None = None,
    partial: bool = False,
    no_sun: bool = False,
    rotation: float | None = None,
    keystone: float | None = None,
    scale: float | None = None,
    plate_centre: tuple[float, float] | None = None,
    contrast: float | None = None,
    mark_scatter: float | None = None,
    scratches: int | None = None,
    leaks: int | None = None,
    blur: float | None = None,
    vignetting: float | None = None,
    gradient: float | None = None,
    disc_gradient: float | None = None,
    ghost: float | None = None,
    coma: float | None = None,
    bits: int | None = None,
    noise: float | None = None,
    electrons: float | None = None,
    background: float | None = None,
    column_smear: float | None = None,
    tap_step: float | None = None,
    hot_pixels: int | None = None,
    dust: int | None = None,
) -> list[SimulatedFrame]:
    """Frames of random scenes, with the truth about them, as `solaspect simulate` writes them.

    The same seed makes the same frames. What is not given is as the instrument states it, or as the program's default.

    Parameters
    ----------
    frames
        How many.
    utc
        Mid-exposure of the first frame, with its zone.
    rate
        Frames per second.
    drift, place
        A drift scan: the gondola stands still at `place` while the Sun crosses the plate.
    sun_radius
        Angular radius of the Sun, arcsec; by the ephemeris if not given.
    peak, background, noise, gradient, disc_gradient, tap_step
        Light and noise, DN of an 8-bit camera.
    sunspots
        How many, or "hmi": the Sun of SDO/HMI of 2023-01-31.
    smear, blur
        Motion during the exposure, and 1 sigma of the blur, px.
    partial, no_sun
        The disc cut by the sensor's edge; no Sun.
    rotation, keystone
        Turn of the picture and tilt of the camera, deg.
    scale
        Plate length per pixel, mil/px.
    plate_centre
        Where the plate's centre is seen, px.
    mark_scatter
        Displacement of the marks, rms per axis, mil.
    contrast, vignetting, ghost, coma, column_smear
        Fractions.
    scratches, leaks, hot_pixels, dust
        How many.
    bits
        8, or 12 in uint16.
    electrons
        Photo-electrons of one DN: adds the noise of photons.

    Examples
    --------
    >>> import solaspect
    >>> frames = solaspect.simulate(frames=2, seed=7, rotation=33, hot_pixels=60, bits=12)
    >>> frames[0].array.shape, frames[0].array.dtype
    ((966, 1296), dtype('uint16'))
    >>> frames[0].mark_ids.shape == frames[0].marks_px.shape
    True
    >>> solaspect.simulate(contrast=1.2)
    Traceback (most recent call last):
        ...
    ValueError: invalid value '1.2' for '--contrast <C>': expected a number from 0 to 1
    """
    options = dict(locals())
    options["instrument"] = _instrument(instrument)
    options["utc"] = _native.time_text(utc)
    options["place"] = None if place is None else _native.place_text(place)
    # The option names the folder of frames, but nothing is written.
    options["out"] = os.devnull
    return _native.simulate(_options(**options))


def compare(before: AnyInstrument, after: AnyInstrument) -> dict[str, Any]:
    """Differences of two instruments, each in its own unit and in arcsec on the sky, as `solaspect calibrate compare --json`.

    Examples
    --------
    >>> import solaspect
    >>> solaspect.compare("demo", "demo")["plate_centre_px"]
    {'by': [0.0, 0.0], 'arcsec': 0.0}
    """
    return _native.compare(before, after)


def refine(
    archive: PathLike,
    out: PathLike,
    *,
    instrument: AnyInstrument | Sequence[AnyInstrument] | None = None,
    roll_camera: PathLike | None = None,
    config: PathLike | None = None,
    jobs: int | None = None,
    since: AnyTime | None = None,
    until: AnyTime | None = None,
    place: AnyPlace | None = None,
    imu: Paths = (),
    gps: Paths = (),
    navigation: PathLike | None = None,
    rate: float | None = None,
    aem: bool = False,
) -> Refined:
    """Make the best aspect history from a flight's archive, as `solaspect refine` does; its summary is printed.

    KeyboardInterrupt ends a run at the next frame; one that was interrupted goes on where it was. The GIL is released meanwhile.

    Parameters
    ----------
    archive
        A folder tree of FITS frames.
    out
        Where journal and results go.
    instrument
        One, or one for each camera; the archive's own if not given.
    jobs
        Frames at a time; as many as there are cores if not given.
    since, until
        Only frames between these times, each with its zone.
    place
        Where the frames were taken, for frames that do not say so.
    imu, gps, navigation, rate, aem
        The flight's IMU and GPS for the attitude between frames; its rows per second (Hz), and whether to write attitude.aem.
    """
    if instrument is None:
        instruments = []
    elif isinstance(instrument, (str, os.PathLike, Instrument)):
        instruments = [_instrument(instrument)]
    else:
        instruments = [_instrument(one) for one in instrument]
    options = _options(
        out=os.fspath(out),
        instrument=instruments,
        roll_camera=roll_camera,
        config=config,
        jobs=jobs,
        since=None if since is None else _native.time_text(since),
        until=None if until is None else _native.time_text(until),
        place=None if place is None else _native.place_text(place),
        imu=_paths(imu),
        gps=_paths(gps),
        navigation=navigation,
        rate=rate,
        aem=aem,
    )
    _native.run(["refine", *options, "--", os.fspath(archive)])
    return Refined(out)


def calibrate_plate(
    frames: Paths,
    out: PathLike,
    *,
    instrument: AnyInstrument = "demo",
    from_drawing: bool = False,
    report: PathLike | None = None,
) -> Instrument:
    """Measure every mark of the plate, the lens's distortion and the camera's poses, as `solaspect calibrate plate` does.

    Parameters
    ----------
    frames
        Frames, or folders of them, with the Sun all over the plate, in several poses of the camera.
    out
        The new instrument file.
    instrument
        The instrument as it is known so far.
    from_drawing
        Drop the marks that the instrument has measured.
    report
        Folder for a page with figures.
    """
    options = _options(out=out, instrument=_instrument(instrument), from_drawing=from_drawing, report=report)
    return _calibrate("plate", out, options, _paths(frames))


def calibrate_mounting(
    frames: Paths,
    out: PathLike,
    *,
    instrument: AnyInstrument = "demo",
    pointing: PathLike | None = None,
    apparent: bool = False,
    drift: bool = False,
    place: AnyPlace | None = None,
    air: tuple[float, float] | None = None,
    report: PathLike | None = None,
) -> Instrument:
    """Measure boresight, clocking, plate distance, rule of directions and mirror, as `solaspect calibrate mounting` does.

    Parameters
    ----------
    pointing, apparent
        CSV file of where the telescope pointed (UTC, azimuth and elevation in deg); whether its elevations hold refraction.
    drift
        The gondola stood still while the Sun crossed the plate.
    air
        Pressure (hPa) and temperature (deg C) of the air about the observer.
    """
    options = _options(
        out=out,
        instrument=_instrument(instrument),
        pointing=pointing,
        apparent=apparent,
        drift=drift,
        place=None if place is None else _native.place_text(place),
        air=air,
        report=report,
    )
    return _calibrate("mounting", out, options, _paths(frames))


def calibrate_camera(
    frames: Paths,
    out: PathLike,
    *,
    instrument: AnyInstrument = "demo",
    dark: PathLike | None = None,
    flat: PathLike | None = None,
    report: PathLike | None = None,
) -> Instrument:
    """Measure dark level, noise, gain, hot pixels, vignetting and blur, as `solaspect calibrate camera` does.

    Parameters
    ----------
    frames
        Frames of the Sun on the plate, or folders of them; may be empty.
    dark, flat
        Folders of frames without light, and of evenly lit ones.
    """
    options = _options(out=out, instrument=_instrument(instrument), dark=dark, flat=flat, report=report)
    return _calibrate("camera", out, options, _paths(frames))


def _calibrate(part: str, out: PathLike, options: list[str], frames: list[str]) -> Instrument:
    _native.run(["calibrate", part, *options, "--", *frames])
    return Instrument.load(out)
