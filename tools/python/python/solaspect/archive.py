"""A flight's archive and its refined aspect as astropy's tables and times, its frames as arrays and sunpy's maps.

astropy is needed, and sunpy for maps: `pip install 'solaspect[maps]'`.
"""

from __future__ import annotations

import csv
import json
import os
import re
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ._native import PointingHistory, run
from .errors import SolaspectError
from .plotting import SunPath, plot_path, plot_pointing, sun_path
from .pointing import pointing_at

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    import numpy.typing as npt
    from astropy.io.fits import Header
    import pandas
    from astropy.table import Table
    from astropy.time import Time
    from astropy.units import Quantity
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from sunpy.map import GenericMap

    from ._types import AnyTime, PathLike
    from .pointing import Pointing

#: Units of the logs as astropy writes them: the endings of the columns' names, or what stands behind a name in brackets.
UNITS = {
    "%": "percent",
    "DN": "DN",
    "arcsec": "arcsec",
    "deg C": "deg_C",
    "deg": "deg",
    "dn": "DN",
    "mil": "25.4 um",
    "mil/px": "25.4 um / pix",
    "mil_per_px": "25.4 um / pix",
    "ms": "ms",
    "px": "pix",
    "s": "s",
    "us": "us",
}
#: Columns that hold text even if it reads like a number, or is empty throughout.
TEXT = {
    "solutions": {"file", "quality", "reason", "mapping", "disk"},
    "housekeeping": {"stopped", "ids", "disks", "commit", "configuration", "roll_reasons", "restarts"},
}


def open_archive(directory: PathLike) -> Archive:
    """The archive of a flight; of several cameras, the folder of one.

    Raises
    ------
    SolaspectError
        The folder is not there.
    """
    return Archive(directory)


def open_refined(directory: PathLike) -> Refined:
    """Results of `refine` in a folder.

    Raises
    ------
    SolaspectError
        The folder holds no refined flight.
    """
    return Refined(directory)


class Archive:
    """A flight's archive, as `solaspect fly` and `solaspect demo` write it.

    Attributes
    ----------
    directory : Path
        Its folder.
    """

    def __init__(self, directory: PathLike) -> None:
        self.directory = Path(directory).absolute()
        if not self.directory.is_dir():
            raise SolaspectError(f"{directory}: expected the folder of an archive, found none", str(directory))

    def __repr__(self) -> str:
        return f"Archive({str(self.directory)!r}, {len(self.frames())} frames)"

    def frames(self, camera: str = "") -> list[Path]:
        """The frames' files, by name, which begins with the time: those of the cameras that see the plate, or of the `camera` ("roll", "moon")."""
        begins = (f"{camera}_",) if camera else ("roll_", "moon_")
        files = self.directory.rglob("*.fits")
        return sorted(path for path in files if path.name.startswith(begins) == bool(camera))

    def array(self, frame: PathLike) -> npt.NDArray[np.uint8] | npt.NDArray[np.uint16]:
        """A frame's pixels, rows by columns, as `solve` takes them. A path that is not absolute is one of the archive."""
        from astropy.io import fits

        with fits.open(self.directory / frame) as hdus:
            return _image(hdus).data

    def header(self, frame: PathLike) -> Header:
        """A frame's keywords: docs/keywords.md explains them."""
        from astropy.io import fits

        with fits.open(self.directory / frame) as hdus:
            return _image(hdus).header

    def map(self, frame: PathLike) -> GenericMap:
        """A frame as a sunpy map, with helioprojective coordinates if the frame was solved.

        Its pixels are floats, so that it can be rotated: what comes in from outside is NaN.
        """
        import numpy as np
        import sunpy.map

        return sunpy.map.Map(self.array(frame).astype(np.float32), self.header(frame))

    def solutions(self) -> Table:
        """The solution log: one row for each solved frame of every start, in order. Unknown values are masked.

        `utc` is an astropy `Time`; the columns' units are those of their names, a mil being 25.4 um. docs/archive.md lists the columns.
        """
        return self._logs("solutions")

    def housekeeping(self) -> Table:
        """The housekeeping, one row each second, in the same form; docs/protocol.md lists the columns."""
        return self._logs("housekeeping")

    def _logs(self, kind: str) -> Table:
        rows = [row for path in sorted(self.directory.glob(f"{kind}_*.csv")) for row in _rows(path)]
        if not rows:
            where = self.directory / f"{kind}_*.csv"
            raise SolaspectError(f"{where}: expected a log with rows, found none", str(where))
        return _table(rows, TEXT[kind])


# Keys of summaries written by earlier versions, still read in 0.2.
_RENAMED = {"witnesses": "cameras_against_gyros", "odd": "flagged", "second_look": "second_pass", "swings": "swings_mil", "sigmas_raised": "inflation"}


def _with_new_names(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    return {_RENAMED.get(key, key): value for key, value in pairs}


class Refined:
    """Refined aspect of a flight; of several cameras, the folder of one.

    Attributes
    ----------
    directory : Path
        The folder with `aspect.fits`, `summary.json` and `report.html`.
    """

    def __init__(self, directory: PathLike) -> None:
        self.directory = Path(directory).absolute()
        if not (self.directory / "aspect.fits").is_file():
            raise SolaspectError(f"{directory}: expected aspect.fits of a refined flight, found none", str(directory))

    def __repr__(self) -> str:
        return f"Refined({str(self.directory)!r})"

    @property
    def summary(self) -> dict[str, Any]:
        """`summary.json`: counts, jumps of the mapping, steps of the clock, versions."""
        return json.loads((self.directory / "summary.json").read_text(), object_pairs_hook=_with_new_names)

    def aspect(self) -> Table:
        """A row for each frame; unknown values are NaN. `UTC` is an astropy `Time`, masked there. docs/refine-reference.md lists the columns."""
        table = self._table("ASPECT")
        table["UTC"] = _times(table["UTC"])
        return table

    def smoothed(self) -> Table:
        """The smoothed path of the Sun on the plate, at every frame and half-way between."""
        return self._table("SMOOTHED")

    def at(
        self,
        times: Time | Sequence[AnyTime] | AnyTime,
        *,
        most_sigma: Quantity | float = 10.0,
        fastest: Quantity | float = 450.0,
    ) -> Pointing:
        """Pointing of the telescope at any times of the flight, also between frames.

        Parameters
        ----------
        times
            An astropy `Time` of any shape and scale, or what makes one.
        most_sigma
            Up to which 1 sigma of the boresight, in its worse axis, a pointing is valid, arcsec.
        fastest
            Up to which speed over the sky, arcsec/s.

        Examples
        --------
        >>> pointing = refined.at("2013-09-21T18:00:03.25")  # doctest: +SKIP
        >>> pointing.coord, pointing.north_angle, pointing.valid  # doctest: +SKIP
        """
        return pointing_at(self._history, times, most_sigma, fastest)

    @cached_property
    def _history(self) -> PointingHistory:
        return PointingHistory.read(self.directory)

    @property
    def span(self) -> Time:
        """The first and the last time at which the pointing is known."""
        from astropy.time import Time

        ends = self._history.ends_s
        if ends is None:
            raise SolaspectError(f"{self.directory}: expected times at which the pointing is known, found none", str(self.directory))
        return Time(list(ends), format="unix", scale="utc")

    def pointing(self) -> Table:
        """The pointing at a constant rate, as `refine` wrote it; `at` gives it at any time."""
        return self._table("POINTING")

    def roll(self) -> Table:
        """A row for each frame of the roll camera: docs/refine-reference.md lists the columns."""
        return self._table("ROLL", "roll.fits")

    def attitude(self) -> Table:
        """The attitude at the samples of the IMU."""
        return self._table("ATTITUDE", "attitude.fits")

    def stabilisation(self) -> Table:
        """The offset from the target at the rate that `refine` was given."""
        return self._table("STABILISATION", "stabilisation.fits")

    def events(self, events: PathLike, out: PathLike, *, detectors: PathLike) -> Table:
        """Assign each photon of an event list its position on the Sun, as `solaspect events` does; docs/events.md lists the columns and DET.toml.

        Parameters
        ----------
        events
            The event list, FITS, plain or gzipped.
        out
            The copy with the photons' places; replaced if it exists.
        detectors
            DET.toml: how the detectors are mounted.

        Returns
        -------
        Table
            The photons of the copy. A list that is larger than memory is for the program.
        """
        from astropy.io import fits
        from astropy.table import Table

        options = [f"--detectors={os.fspath(detectors)}", f"--out={os.fspath(out)}"]
        run(["events", *options, "--", os.fspath(self.directory), os.fspath(events)])
        with fits.open(out) as hdus:
            photons = next(n for n, hdu in enumerate(hdus) if n and "HP_VALID" in getattr(hdu, "columns", fits.ColDefs([])).names)
            return Table.read(hdus, hdu=photons)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the boresight's path over the Sun with its heliographic grid: valid pointings coloured by time, others grey."""
        return plot_path(self._sun_path(), ax)

    def plot_pointing(self) -> Figure:
        """Draw the pointing: the path on the Sun and near its target with the ellipse of 1 sigma, the dwell time, and the distance from the target
        with the time within 20 arcsec and 1 arcmin."""
        return plot_pointing(self._sun_path())

    def _sun_path(self) -> SunPath:
        middle = self.span[0] + (self.span[1] - self.span[0]) / 2
        return sun_path(self.pointing(), *PointingHistory.graticule(middle.unix, 15))

    def to_pandas(self, table: str = "aspect") -> pandas.DataFrame:
        """A table as a pandas data frame: "aspect", "smoothed", "pointing", "roll", "attitude" or "stabilisation"."""
        known = ("aspect", "smoothed", "pointing", "roll", "attitude", "stabilisation")
        if table not in known:
            raise ValueError(f"table: expected one of {', '.join(known)}, found {table!r}")
        return getattr(self, table)().to_pandas()

    def _table(self, name: str, file: str = "aspect.fits") -> Table:
        """A table in the machine's own bytes, texts as str, and a unit on each column that has one."""
        import numpy as np
        from astropy.io import fits
        from astropy.table import Table

        path = self.directory / file
        if not path.is_file():
            raise SolaspectError(f"{path}: expected the table {name} of a refined flight, found no file", str(path))
        table = Table.read(path, hdu=name, mask_invalid=False)
        header = fits.getheader(path, name)
        for number, column in enumerate(table.colnames, 1):
            values = table[column]
            if values.dtype.kind == "S":
                table[column] = np.char.rstrip(np.char.decode(np.asarray(values), "ascii"))
            elif not values.dtype.isnative:
                unit, description = values.unit, values.description
                table[column] = values.astype(values.dtype.newbyteorder("="))
                table[column].unit, table[column].description = unit, description
            unit = _unit_in_comment(header.get(f"TCOMM{number}", ""))
            if unit and table[column].unit is None:
                table[column].unit = unit
        return table


def _unit_in_comment(comment: str) -> Any:
    """The unit of a column that FITS does not know, mil or degC, as its comment states it."""
    import astropy.units as u

    found = re.search(r"\((mil|degC)(\d?)(/\w+)?(?:, [^()]*)?\)$", comment)
    if found is None:
        return None
    name, power, per = found.groups()
    unit = u.Unit("25.4 um" if name == "mil" else "deg_C") ** int(power or 1)
    return unit / u.Unit(per[1:].replace("pixel", "pix")) if per else unit


def _image(hdus: Any) -> Any:
    """The first image with two axes."""
    for hdu in hdus:
        if hdu.is_image and hdu.header.get("NAXIS") == 2:
            return hdu
    raise SolaspectError(f"{hdus.filename()}: expected an image with two axes, found none", hdus.filename())


def _times(column: Any) -> Any:
    """Times of a column of text; those that are not known are masked."""
    import numpy as np
    from astropy.time import Time

    text: Any = np.asarray(np.ma.filled(np.ma.asarray(column, dtype=str), ""))
    known = np.char.str_len(text) > 0
    times = Time(np.where(known, np.char.rstrip(text, "Z"), "2000-01-01T00:00:00"), scale="utc", format="isot", precision=9)
    if not known.all():
        times[~known] = np.ma.masked
    return times


def _rows(path: Path) -> list[dict[str, str]]:
    """The rows of a log; one that the flight's end cut off is dropped."""
    with path.open(newline="") as file:
        return [row for row in csv.DictReader(file) if None not in row.values()]


def _table(rows: list[dict[str, str]], text: set[str]) -> Table:
    """A table of the columns that any row has."""
    from astropy.table import Column, MaskedColumn, Table

    table = Table()
    for heading in dict.fromkeys(name for row in rows for name in row):
        name, unit = _name_and_unit(heading)
        values = [row.get(heading, "") for row in rows]
        if name == "utc":
            table[name] = _times(values)
        elif name in text or not all(map(_is_number, values)):
            table[name] = Column(values, dtype=str)
        else:
            numbers = [float(value or "nan") for value in values]
            table[name] = MaskedColumn(numbers, mask=[not value for value in values], unit=unit)
    return table


def _is_number(text: str) -> bool:
    try:
        float(text or "nan")
    except ValueError:
        return False
    return True


def _name_and_unit(heading: str) -> tuple[str, str | None]:
    """Of "uptime_s [s]", or of a name that ends with its unit."""
    name, _, unit = heading.removesuffix("]").partition(" [")
    if unit:
        return name, UNITS.get(unit)
    endings = [ending for ending in UNITS if name.endswith(f"_{ending}")]
    return name, UNITS[max(endings, key=len)] if endings else None
