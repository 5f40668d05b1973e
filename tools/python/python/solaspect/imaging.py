"""Photons as an image of the Sun. sunpy is needed: `pip install 'solaspect[maps]'`."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from ._native import run
from .archive import Refined

if TYPE_CHECKING:
    from astropy.units import Quantity
    from sunpy.map import GenericMap

    from ._types import PathLike

__all__ = ["image"]

Layer = Literal["counts", "exposure", "rate", "invalid"]


def image(
    events: PathLike,
    refined: Refined | PathLike,
    *,
    detectors: PathLike,
    pixel: Quantity | float = 5.0,
    centre: Quantity | tuple[float, float] = (0.0, 0.0),
    size: Quantity | tuple[float, float] = (2400.0, 2400.0),
    energy: tuple[str, float, float] | None = None,
    layer: Layer = "counts",
    out: PathLike | None = None,
) -> GenericMap:
    """Image of photons on the Sun, as `solaspect events --image` writes it; docs/events.md states which photons count.

    Parameters
    ----------
    events
        The event list, FITS, plain or gzipped.
    refined
        The refined flight, or its folder.
    detectors
        DET.toml: how the detectors are mounted, with their fields.
    pixel
        Side of a pixel, arcsec.
    centre
        Middle of the image from the Sun's centre, to solar west and north, arcsec.
    size
        Width and height, arcsec.
    energy
        Only photons whose number in a column is in a range, both ends included: ("PI", 100, 400).
    layer
        "counts" of valid photons, "exposure" in s of live time, "rate" in photons per s, NaN where nothing was seen, or "invalid": photons that
        are not to be used.
    out
        Keeps the file of the image there; it is replaced if it exists.

    Returns
    -------
    sunpy.map.GenericMap
        Solar north up, pixels of float, with coordinates for the balloon as observer.
    """
    options = [
        f"--detectors={os.fspath(detectors)}",
        f"--pixel-arcsec={_arcsec(pixel)}",
        f"--image-centre={_pair(centre)}",
        f"--image-size={_pair(size)}",
    ]
    if energy is not None:
        column, low, high = energy
        options += [f"--energy-column={column}", f"--range={low},{high}"]
    folder = refined.directory if isinstance(refined, Refined) else Path(refined)
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch, "image.fits") if out is None else Path(out)
        run(["events", *options, f"--image={path}", "--", os.fspath(folder), os.fspath(events)])
        return _read(path, layer)


def _read(path: Path, layer: Layer) -> GenericMap:
    import numpy as np
    import sunpy.map
    from astropy.io import fits

    names = {"counts": "COUNTS", "exposure": "EXPOSURE", "rate": "COUNTS", "invalid": "INVALID"}
    if layer not in names:
        raise ValueError(f"layer: expected one of {', '.join(names)}, found {layer!r}")
    with fits.open(path) as hdus:
        hdu = hdus[names[layer]]
        values, header = hdu.data.astype(np.float32), hdu.header.copy()
        if layer == "rate":
            seconds = hdus["EXPOSURE"].data
            values = np.divide(values, seconds, out=np.full_like(values, np.nan), where=seconds > 0)
            header["BUNIT"] = "ct / s"
    return sunpy.map.Map(values, header)


def _arcsec(value: Any) -> Any:
    """Convert an astropy quantity to arcsec; a number is returned as it is."""
    return value.to_value("arcsec") if hasattr(value, "to_value") else value


def _pair(values: Any) -> str:
    x, y = _arcsec(values) if hasattr(values, "to_value") else map(_arcsec, values)
    return f"{float(x)!r},{float(y)!r}"
