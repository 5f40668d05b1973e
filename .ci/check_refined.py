"""Checks the output of `solaspect refine` against its page, read by astropy without a warning: columns, units, comments, NaN, the
second table, the summary.

    check_refined.py OUT ARCHIVE
"""

import csv
import json
import pathlib
import re
import sys
import warnings

import astropy.units as u
import numpy as np
import sunpy.coordinates
from astropy.coordinates import AltAz, EarthLocation, SkyCoord
from astropy.io import fits
from astropy.table import QTable, Table
from astropy.time import Time
from astropy.utils import iers

PAGE = pathlib.Path(__file__).parent.parent / "docs" / "refine-reference.md"
MIL = u.def_unit("mil", 25.4 * u.um)
# Any warning of a reader is an error.
warnings.simplefilter("error")
# The Earth orientation data bundled with astropy cover the demo's date.
iers.conf.auto_download = False


def stated(name):
    """Columns of a table with units and meanings, from the page."""
    section = re.split(r"^##+ ", PAGE.read_text().split(f"### {name}\n")[1], flags=re.MULTILINE)[0]
    return re.findall(r"^\| `(\w+)` \| (.*?) \| (.*?) \|$", section, re.MULTILINE)


def in_fits(unit, meaning):
    """Expected unit and comment of a column in a FITS file: a unit that FITS does not define is part of the comment."""
    if not unit:
        return None, meaning
    try:
        return u.Unit(unit, format="fits"), meaning
    except ValueError:
        size = {"mil": ", 25.4 um"}.get(unit, ", mil = 25.4 um" if "mil" in unit else "")
        return None, f"{meaning} ({unit}{size})"


def table(path, name):
    """Reads a table, its texts without the blanks that fill them; asserts that its columns have the names, units and meanings of the page."""
    found, header = QTable.read(path, hdu=name), fits.getheader(path, name)
    assert all(Table.read(path, hdu=name)[c].unit == found[c].unit for c in found.colnames)
    columns = [(c, found[c].unit, header[f"TCOMM{n}"]) for n, c in enumerate(found.colnames, 1)]
    same = [(c, *in_fits(unit, meaning)) for c, unit, meaning in stated(name)]
    assert columns == same, (name, [pair for pair in zip(columns, same) if pair[0] != pair[1]])
    rows = Table(found)
    for column in rows.itercols():
        if column.dtype.kind == "S":
            rows[column.name] = np.char.rstrip(np.asarray(column).astype(str))
    return rows


def plain(column):
    """A column as floats, with NaN for missing values."""
    return np.ma.filled(np.ma.asarray(column, dtype=float), np.nan)


def frames_of(archive):
    return sorted(str(p.relative_to(archive)) for p in archive.rglob("*.fits"))


def check_roll(out, archive):
    """Checks the roll camera's table: it has every frame, with the roll of the frame and the smoothed one."""
    path = out / "roll.fits"
    with fits.open(path, checksum=True) as hdus:
        hdus.verify("exception")
    rows = table(path, "ROLL")
    assert sorted(rows["FILE"]) == [file for file in frames_of(archive) if "roll_" in file]
    own, smoothed = plain(rows["ROLL_DEG"]), plain(rows["SMOOTHED_ROLL_DEG"])
    assert np.isfinite(own).all() and np.abs(own - smoothed).max() < 0.1
    assert (plain(rows["SMOOTHED_ROLL_SIGMA_DEG"]) <= 1.01 * plain(rows["ROLL_SIGMA_DEG"])).all()
    assert np.nanmax(np.abs(plain(rows["FLIGHT_ROLL_DEG"]) - own)) < 0.1
    return len(rows)


def check_rows(rows, archive):
    assert sorted(rows["FILE"]) == [file for file in frames_of(archive) if "roll_" not in file]
    assert set(rows["QUALITY"]) <= {"fine", "coarse", "none"}
    placed = np.isfinite(plain(rows["SUN_X_MIL"]))
    assert (placed == (rows["QUALITY"] != "none")).all()
    for name in ("SUN_Y_MIL", "SIGMA_X_MIL", "SIGMA_Y_MIL", "COV_XY_MIL2"):
        assert (np.isfinite(plain(rows[name])) == placed).all(), name
    assert (plain(rows["SIGMA_X_MIL"])[placed] > 0).all()
    fine = rows["QUALITY"] == "fine"
    assert fine.any() and (rows["REASON"][~fine] != "").all()
    for name in ("POINTING_AZ_DEG", "BORESIGHT_HPLN_ARCSEC", "OFFSET_AZ_DEG", "FLIGHT_X_MIL"):
        assert np.isfinite(plain(rows[name])[fine]).all(), name
    for name in ("RADIUS_SIGMA_MIL", "CENTRE_SIGMA_X_PX", "CENTRE_SIGMA_Y_PX", "ROTATION_SIGMA_DEG", "SCALE_SIGMA_MIL_PER_PX"):
        assert (plain(rows[name])[fine] > 0).all(), name
    times = Time(list(rows["UTC"]), scale="utc")
    assert np.abs(times.unix - plain(rows["UNIX_S"])).max() < 1e-5
    away = plain(rows["SUN_X_MIL"] - rows["FLIGHT_X_MIL"])[fine] * MIL
    assert np.abs(away).max() < 0.2 * u.mm
    return int(fine.sum())


def check_smoothed(rows, smoothed):
    times = plain(smoothed["UNIX_S"])
    assert (np.diff(times) > 0).all() and np.isin(plain(rows["UNIX_S"]), times).all()
    known = np.isfinite(plain(smoothed["SUN_X_MIL"]))
    assert known.any() and (plain(smoothed["SIGMA_X_MIL"])[known] > 0).all()


def on_the_sun(times, azimuth, elevation, location):
    """Helioprojective coordinates, by sunpy, of horizontal directions; sunpy gets points at the distance of the Sun."""
    observer = SkyCoord(location.get_itrs(times))
    distance = observer.transform_to(sunpy.coordinates.HeliographicStonyhurst(obstime=times)).radius
    horizon = AltAz(obstime=times, location=location)
    towards = SkyCoord(azimuth, elevation, distance, frame=horizon)
    seen = towards.transform_to(sunpy.coordinates.Helioprojective(obstime=times, observer=observer))
    return np.array([seen.Tx.to_value(u.arcsec), seen.Ty.to_value(u.arcsec)])


def check_pointing(out):
    """Checks the pointing against sunpy, from its horizontal direction, and the times against astropy."""
    rows, header = table(out / "aspect.fits", "POINTING"), fits.getheader(out / "aspect.fits", "POINTING")
    assert header["TIMESYS"] == "UTC" and header["TIMEUNIT"] == "s"
    times = Time(header["MJDREF"], plain(rows["TIME"]) / 86400, format="mjd", scale="utc")
    assert np.abs((times - Time(header["DATEREF"], scale="utc")).to_value("s") - plain(rows["TIME"])).max() < 1e-6
    assert np.abs((times - Time(plain(rows["UNIX_S"]), format="unix", scale="utc")).to_value("s")).max() < 1e-6
    valid = np.asarray(rows["VALID"])
    assert valid.any() and ((rows["INVALID"] == "") == valid).all()
    # Use rows at whole seconds, for which pointing.fits has the Sun's direction.
    seconds = Table.read(out / "pointing.fits", hdu="SECONDS")
    known = np.isfinite(plain(rows["HPLN"])) & np.isin(plain(rows["UNIX_S"]), np.asarray(seconds["UNIX_S"], dtype=float))
    rows, times = rows[known], times[known]
    seconds = seconds[np.searchsorted(seconds["UNIX_S"], rows["UNIX_S"])]
    location = EarthLocation.from_geocentric(*(plain(seconds[axis]) * u.m for axis in "XYZ"))
    pointed = on_the_sun(times, rows["AZIMUTH"], rows["ELEVATION"], location)
    off = pointed - np.array([plain(rows["HPLN"]), plain(rows["HPLT"])])
    north, east, up = horizon_axes(location)
    sun = np.stack([plain(seconds[f"SUN_{axis}"]) for axis in "XYZ"])
    azimuth = np.degrees(np.arctan2((sun * east).sum(0), (sun * north).sum(0))) * u.deg
    elevation = np.degrees(np.arcsin((sun * up).sum(0))) * u.deg
    of_sun = on_the_sun(times, azimuth, elevation, location)
    print(f"POINTING: {np.abs(off).max():.3f} arcsec from sunpy, {np.abs(off - of_sun).max():.4f} beside the Sun's own")
    assert np.abs(off).max() < 0.3 and np.abs(off - of_sun).max() < 0.02
    return len(valid)


def horizon_axes(location):
    """Unit vectors north, east and up in Earth-fixed axes."""
    longitude, latitude = location.lon.rad, location.lat.rad
    up = np.stack([np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)])
    east = np.stack([-np.sin(longitude), np.cos(longitude), 0 * longitude])
    return np.cross(up, east, axis=0), east, up


def check_same(rows, out):
    """Checks that CSV and summary agree with the table."""
    with open(out / "aspect.csv", newline="") as file:
        lines = list(csv.DictReader(file))
    assert [line["FILE"] for line in lines] == list(rows["FILE"])
    written = np.array([float(line["SUN_X_MIL"] or "nan") for line in lines])
    assert np.array_equal(written, plain(rows["SUN_X_MIL"]), equal_nan=True)
    summary = json.loads((out / "summary.json").read_text())
    counts = [summary[quality] for quality in ("fine", "coarse", "none")]
    assert counts == [int((rows["QUALITY"] == q).sum()) for q in ("fine", "coarse", "none")]


def main(out, archive):
    path = out / "aspect.fits"
    with fits.open(path, checksum=True) as hdus:
        hdus.verify("exception")
        assert [hdu.name for hdu in hdus][1:] == ["ASPECT", "SMOOTHED", "POINTING"]
        assert all("DATASUM" in hdu.header for hdu in hdus)
    rows, smoothed = table(path, "ASPECT"), table(path, "SMOOTHED")
    fine = check_rows(rows, archive)
    check_smoothed(rows, smoothed)
    check_same(rows, out)
    check_pointing(out)
    rolls = check_roll(out, archive)
    page = (out / "report.html").read_text()
    assert "<svg" in page and not re.search(r"(src|href)=\"(?!data:)", page)
    print(f"{len(rows)} rows, {fine} of them fine, {len(smoothed)} moments of the path, {rolls} rolls: all good")


main(*map(pathlib.Path, sys.argv[1:3]))
