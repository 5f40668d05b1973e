"""Compares the sky keywords of every file of an archive with sunpy, astropy, solarnet-metadata and the pixels.

    check_headers.py ARCHIVE SUNSPOTS

ARCHIVE is that of a demo; SUNSPOTS has frames of various instruments and places, each with one spot, and
sunspots.csv with the spots' positions. Any warning is an error. This script measures the limb in the pixels; from the
solver it uses only the header.
"""

import csv
import logging
import pathlib
import re
import sys
import warnings

import astropy.units as u
import numpy as np
import sunpy.map
from astropy.coordinates import EarthLocation, SkyCoord
from astropy.io import fits
from astropy.time import Time
from astropy.utils import iers
from astropy.wcs import WCS
from scipy.ndimage import gaussian_filter1d, map_coordinates
from solarnet_metadata.validation import validate_file
from sunpy.coordinates import HeliographicStonyhurst, get_earth, sun
from sunpy.coordinates.utils import get_limb_coordinates

PAGE = pathlib.Path(__file__).parent.parent / "docs" / "keywords.md"
WORLD = ("WCSAXES", "CTYPE1", "CUNIT1", "CRPIX1", "CRVAL1", "CDELT1", "PC1_1", "CD1_1", "CROTA2")
# Optics of the demo: limb darkening at 630 nm; blur, with the width of a pixel added in quadrature.
LIMB_DARKENING, BLUR_PX = 0.56, np.hypot(0.9, 1 / 12**0.5)
# Largest accepted deviations. If the sensor cuts the disc, few marks are illuminated and the mapping is less accurate.
LIMB_PX, CUT_LIMB_PX, TURN_DEG, SPOT_ARCSEC = 0.1, 0.5, 0.02, 0.5
REACH_PX = 6.0
# A Sun that moves faster is smeared by more than a pixel during the exposure, so its limb is not sharp enough to measure.
SLEW_DEG_PER_S = 0.25


def accepted_remarks():
    """Regular expressions of the remarks that docs/keywords.md explains."""
    page = PAGE.read_text().split("## Accepted remarks of validators")[1]
    return [re.compile(r) for r in re.findall(r"^\| `(.+?)` \|", page, re.MULTILINE)]


def check_structure(path, accepted):
    """Checks conformity with FITS and SOLARNET; returns the header of the HDU with the pixels."""
    with fits.open(path, checksum=True, disable_image_compression=True) as hdus:
        hdus.verify("exception")
    remarks = validate_file(path)
    unexplained = [r for r in remarks if not any(a.search(r) for a in accepted)]
    assert not unexplained, (path, unexplained)
    with fits.open(path) as hdus:
        header = hdus["FRAME"].header
        names = [hdu.name for hdu in hdus]
        assert len(set(names)) == len(names), path
        assert header["FILENAME"] == path.name, path
    WCS(header)
    return header, remarks


def off_deg(a, b):
    return abs((a - b + 180) % 360 - 180)


def check_observer(path, header, frame):
    """Checks that the map's observer has the position that sunpy gives for the same place on Earth and time."""
    time = Time(header["DATE-AVG"])
    metres = [header[f"OBSGEO-{axis}"] * u.m for axis in "XYZ"]
    place = EarthLocation.from_geocentric(*metres)
    there = SkyCoord(place.get_itrs(time)).transform_to(HeliographicStonyhurst(obstime=time))
    observer = frame.observer_coordinate
    assert off_deg(observer.lon.deg, there.lon.deg) < 1e-4, (path, observer, there)
    assert off_deg(observer.lat.deg, there.lat.deg) < 1e-4, (path, observer, there)
    assert abs(observer.radius - there.radius) < 1e-6 * u.AU, (path, observer, there)
    # As seen from the Sun, the observer is at most 0.0025 deg from the Earth's centre.
    earth = get_earth(time)
    assert off_deg(observer.lat.deg, earth.lat.deg) < 0.003, path
    assert off_deg(observer.lat.deg, sun.B0(time).deg) < 0.003, path
    assert off_deg(header["CRLN_OBS"], sun.L0(time).deg) < 0.003, path
    assert abs(header["SOLAR_P0"] - sun.P(time).deg) < 0.01, path
    assert abs(header["NORTHANG"] - sun.orientation(place, time).deg) < 0.01, path
    radius = np.arcsin(frame.rsun_meters / observer.radius).to_value("arcsec")
    assert abs(header["RSUN_OBS"] - radius) < 0.001, path


def axes(azimuth, elevation):
    """A direction in the sky, and at it the tangents towards the zenith and clockwise from it; components north, east, up."""
    (sin_a, cos_a), (sin_e, cos_e) = ((np.sin(v), np.cos(v)) for v in np.radians([azimuth, elevation]))
    at = np.array([cos_e * cos_a, cos_e * sin_a, sin_e])
    return at, np.array([-sin_e * cos_a, -sin_e * sin_a, cos_e]), np.array([-sin_a, cos_a, 0.0])


def zenith_turn_deg(header, north):
    """Rotation of the direction to the zenith along the great circle from the Sun to the telescope's pointing, deg."""
    sun_at, up, clockwise = axes(header["SUN-AZ"], header["SUN-EL"])
    (sin_n, cos_n), (x, y) = (np.sin(north), np.cos(north)), np.radians([header["TARGETX"] / 3600, header["TARGETY"] / 3600])
    west, northward = clockwise * cos_n - up * sin_n, up * cos_n + clockwise * sin_n
    target = sun_at * np.cos(y) * np.cos(x) + west * np.cos(y) * np.sin(x) + northward * np.sin(y)
    azimuth = np.degrees(np.arctan2(target[1], target[0])) + header["OFFSETAZ"]
    elevation = np.degrees(np.arcsin(target[2])) + header["OFFSETEL"]
    boresight, up_there, clockwise_there = axes(azimuth, elevation)
    leaving = np.arctan2(boresight @ clockwise, boresight @ up)
    arriving = np.arctan2(-sun_at @ clockwise_there, -sun_at @ up_there)
    return np.degrees(arriving - leaving)


def check_orientation(path, header, frame):
    """Deviation of north and west in the picture from their directions by zenith, clocking, lens and mirrored camera, deg:
    the mean of both, because they are not perpendicular under a keystone.

    A point at bearing b from the Sun's centre, clockwise from the zenith, is projected on the plate in direction
    180 - b - clocking + roll, clockwise from +Y; in the camera x decreases with X, and the picture is rotated by MAPROT.
    If directions on the plate are at the telescope, the zenith is that of the telescope.
    """
    place = EarthLocation.from_geocentric(*[header[f"OBSGEO-{axis}"] * u.m for axis in "XYZ"])
    north = sun.orientation(place, Time(header["DATE-AVG"])).deg
    turn = np.radians(header["MAPROT"])
    angles = []
    zenith_turn, roll = 0.0, 0.0
    if header["PLATEDIR"] == "telescope":
        zenith_turn, roll = zenith_turn_deg(header, np.radians(north)), header["ROLLANG"]
    for bearing, (x, y) in ((north, (0, 300)), (north + 90, (300, 0))):
        direction = np.radians(180 - bearing - zenith_turn - header["CLOCKANG"] + roll)
        unturned = np.array([-np.sin(direction), np.cos(direction)])
        rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        expected = rotation @ unturned
        at = SkyCoord(x * u.arcsec, y * u.arcsec, frame=frame.coordinate_frame)
        seen = np.array(frame.wcs.world_to_pixel(at)) - (header["SUNPX-X"], header["SUNPX-Y"])
        angles.append(np.arctan2(expected[0] * seen[1] - expected[1] * seen[0], expected @ seen))
    return abs(np.degrees(np.mean(angles)))


def edge_level(radius_px):
    """Brightness at the true edge of a limb-darkened, blurred disc, as a fraction of that at its centre."""
    step = 0.02
    r = np.arange(radius_px - 20, radius_px + 20, step)
    cosine = np.sqrt(np.clip(1 - (r / radius_px) ** 2, 0, None))
    light = np.where(r < radius_px, 1 - LIMB_DARKENING * (1 - cosine), 0.0)
    return np.interp(radius_px, r, gaussian_filter1d(light, BLUR_PX / step))


def limb_deviation(data, centre, limb):
    """Distance of the edge outwards from `limb` at each of its points, px; the edge is the outermost crossing of its level."""
    outward = limb - centre
    radii = np.linalg.norm(outward, axis=1)
    outward /= radii[:, None]
    yx = np.indices(data.shape)
    distance = np.hypot(yx[1] - centre[0], yx[0] - centre[1])
    radius = radii.mean()
    background = np.median(data[(distance > 1.1 * radius) & (distance < 1.6 * radius)])
    # The bright part is the plate without marks; within 0.6 radii the mean brightness is 0.91 of that at the centre.
    inner = data[distance < 0.6 * radius]
    bright = np.median(inner[inner > 0.5 * np.percentile(inner, 90)]) - background
    mean_cosine = np.sqrt(1 - 0.18)
    level = background + edge_level(radius) * bright / (1 - LIMB_DARKENING * (1 - mean_cosine))
    steps = np.arange(-REACH_PX, REACH_PX, 0.05)
    places = limb[:, None, :] + outward[:, None, :] * steps[None, :, None]
    inside = np.all((places > 1) & (places < np.array(data.shape[::-1]) - 2), axis=(1, 2))
    deviation = np.full(len(limb), np.nan)
    light = map_coordinates(data.astype(float), places[..., ::-1].transpose(2, 0, 1), order=1)
    light = gaussian_filter1d(light, 0.3 / 0.05, axis=1)
    for n in np.flatnonzero(inside):
        above = np.flatnonzero(light[n] > level)
        if 0 < len(above) and above[-1] + 1 < len(steps):
            a, b = light[n][above[-1]], light[n][above[-1] + 1]
            deviation[n] = steps[above[-1]] + (a - level) / (a - b) * 0.05
    return deviation


def fit_circle(angle, deviation):
    """Deviation of the edge from the limb, px: of the radius, of the centre, and the largest of both together along the edge.

    Marks, scratches and noise are rejected as outliers.
    """
    seen = np.isfinite(deviation)
    for _ in range(8):
        columns = np.column_stack([np.ones(len(angle)), np.cos(angle), np.sin(angle)])
        circle, *_ = np.linalg.lstsq(columns[seen], deviation[seen], rcond=None)
        residual = deviation - columns @ circle
        spread = 1.4826 * np.median(np.abs(residual[seen]))
        seen = np.abs(residual) < 2.5 * spread
    worst = np.abs(columns[seen] @ circle).max()
    return circle[0], np.hypot(circle[1], circle[2]), worst


def check_limb(path, header, frame):
    """Checks that the limb drawn by sunpy is that in the pixels; returns the results of `fit_circle`, and whether the disc is whole."""
    limb = get_limb_coordinates(frame.observer_coordinate, frame.rsun_meters, resolution=720)
    limb = limb.transform_to(frame.coordinate_frame)
    points = np.column_stack(frame.wcs.world_to_pixel(limb))
    centre = points.mean(axis=0)
    radius_px = header["RSUN_OBS"] / header["CDELT1"]
    assert abs(np.linalg.norm(points - centre, axis=1).mean() - radius_px) < 0.01, path
    assert np.linalg.norm(centre - (header["SUNPX-X"], header["SUNPX-Y"])) < 0.01, path
    deviation = limb_deviation(frame.data, centre, points)
    angle = np.arctan2(*(points - centre).T[::-1])
    edge = np.array(frame.data.shape[::-1]) - 1 - REACH_PX
    whole = bool(np.all((points > REACH_PX) & (points < edge)))
    radius, off_centre, worst = fit_circle(angle, deviation)
    assert worst < (LIMB_PX if whole else CUT_LIMB_PX), (path, radius, off_centre, worst)
    return radius, off_centre, worst, whole


def speed_deg_per_s(header, others):
    """Speed of the Sun in the picture, from its position in the other frame nearest in time, deg/s."""

    def seconds(other):
        return (Time(other["DATE-AVG"]) - Time(header["DATE-AVG"])).sec

    others = [other for other in others if abs(seconds(other)) > 0]
    if not others:
        return 0.0
    near = min(others, key=lambda other: abs(seconds(other)))
    way_px = np.hypot(*(near[k] - header[k] for k in ("SUNPX-X", "SUNPX-Y")))
    return way_px * header["CDELT1"] / 3600 / abs(seconds(near))


def check_spots(folder):
    """Checks that sunpy finds each spot's pixels from its helioprojective position."""
    for row in csv.DictReader((folder / "sunspots.csv").read_text().splitlines()):
        (path,) = folder.rglob(f"{row['name']}_*.fits")
        frame = sunpy.map.Map(path)
        place = [float(row[k]) * u.arcsec for k in ("x_arcsec", "y_arcsec")]
        px = frame.wcs.world_to_pixel(SkyCoord(*place, frame=frame.coordinate_frame))
        off = np.hypot(px[0] - float(row["x_px"]), px[1] - float(row["y_px"]))
        off_arcsec = off * frame.scale[0].to_value("arcsec/pix")
        assert off_arcsec < SPOT_ARCSEC, (path, off_arcsec)
        x, y = (round(float(p)) for p in px)
        spot, about = frame.data[y - 1 : y + 2, x - 1 : x + 2], frame.data[y - 8 : y + 9, x - 8 : x + 9]
        assert spot.mean() < 0.75 * np.percentile(about, 80), (path, spot, about)
        check_observer(path, frame.fits_header, frame)
        print(f"sunspot {row['name']}: {off_arcsec:.3f} arcsec from its place")


def report_limbs(title, limbs):
    if not limbs:
        return
    print(f"limb in the pixels against sunpy's, {len(limbs)} {title} discs, median and worst:")
    for what, values in zip(("radius", "centre", "limb"), np.abs(np.array(limbs)).T):
        print(f"  {what}: {np.median(values):.3f}, {values.max():.3f} px")


def main(archive, spots):
    warnings.simplefilter("error")
    logging.getLogger("solarnet_metadata").setLevel(logging.ERROR)
    iers.conf.auto_download = False
    accepted = accepted_remarks()
    files = sorted(pathlib.Path(archive).rglob("*.fits"))
    assert files, "expected FITS files in the archive, found none"
    fine, turns, remarks = [], [], []
    for path in files:
        header, said = check_structure(path, accepted)
        remarks += said
        if header["QUALITY"] == "none" or path.name.startswith("roll_"):
            assert not any(keyword in header for keyword in WORLD), path
            continue
        assert not said, (path, said)
        frame = sunpy.map.Map(path)
        assert isinstance(frame, sunpy.map.GenericMap), path
        check_observer(path, header, frame)
        turns.append(check_orientation(path, header, frame))
        assert turns[-1] < TURN_DEG, (path, turns[-1])
        if header["QUALITY"] == "fine":
            fine.append((path, header, frame))
    headers = [header for _, header, _ in fine]
    slow = [f for f in fine if speed_deg_per_s(f[1], headers) < SLEW_DEG_PER_S]
    limbs = [check_limb(*f) for f in slow]
    check_spots(pathlib.Path(spots))
    print(f"{len(files)} files without a warning; {len(remarks)} remarks of solarnet-metadata, all explained")
    print(f"north and west: at most {max(turns):.4f} deg from where zenith, clocking and mapping put them")
    if len(slow) < len(fine):
        print(f"{len(fine) - len(slow)} discs that their motion smeared, whose limb is not measured")
    for title, chosen in (("whole", True), ("cut", False)):
        report_limbs(title, [limb[:3] for limb in limbs if limb[3] is chosen])
    assert any(limb[3] for limb in limbs), "expected whole discs, found none"


main(*sys.argv[1:])
