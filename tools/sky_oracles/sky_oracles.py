#!/usr/bin/env python3
"""Makes reference values of the sky by astropy and sunpy: tests/data/sky_random.csv and tests/data/rotation.csv.

    python3 -m venv venv && venv/bin/pip install sunpy astropy-iers-data
    venv/bin/python tools/sky_oracles/sky_oracles.py tests/data
"""

import sys
import warnings
from pathlib import Path

import astropy
import astropy.units as u
import astropy_iers_data
import numpy as np
import sunpy
from astropy.coordinates import ICRS, TETE, AltAz, EarthLocation, SkyCoord, get_body
from astropy.time import Time
from astropy.utils import iers
from sunpy.coordinates import Helioprojective, get_earth, propagate_with_solar_surface, sun

MOON_RADIUS_KM = 1737.4
SKY_COLUMNS = (
    "utc,lat_deg,lon_deg,height_m,sun_az_deg,sun_el_deg,sun_dist_au,sun_radius_arcsec,p_angle_deg,b0_deg,l0_deg,"
    "zenith_to_north_deg,moon_az_deg,moon_el_deg,moon_radius_arcsec,ut1_utc_s,moon_phase_angle_deg,moon_bright_limb_deg"
)
TARGETS = [  # days from the epoch, x and y there
    (0.0, 0, 0), (0.25, 300, -400), (1.0, -700, 200), (3.0, -600, -500),
    (-2.0, 500, 600), (0.5, -100, 850), (5.0, -800, -100), (2.0, 100, 300),
]


def instant(mjd):
    """A time whose written form is exact."""
    return Time(Time(mjd, format="mjd", scale="utc").isot, scale="utc")


def sky_row(t, lat, lon, height):
    place = EarthLocation.from_geodetic(lon * u.deg, lat * u.deg, height * u.m)
    up, of_date = AltAz(obstime=t, location=place), TETE(obstime=t, location=place)
    the_sun, moon = (get_body(name, t, location=place) for name in ("sun", "moon"))
    sun_up, moon_up = the_sun.transform_to(up), moon.transform_to(up)
    # The phase follows from barycentric positions, without aberration, and not from apparent directions.
    moon_at, sun_at = (body.transform_to(ICRS()).cartesian for body in (moon, the_sun))
    we_are_at = place.get_itrs(t).transform_to(ICRS()).cartesian
    to_sun, to_us = ((there - moon_at).xyz.to_value(u.km) for there in (sun_at, we_are_at))
    phase = np.arctan2(np.linalg.norm(np.cross(to_sun, to_us)), to_sun @ to_us)
    return [
        sun_up.az.deg, sun_up.alt.deg, sun_up.distance.to_value(u.au), sun.angular_radius(t).to_value(u.arcsec),
        sun.P(t).to_value(u.deg), sun.B0(t).to_value(u.deg), sun.L0(t).to_value(u.deg),
        sun.orientation(place, t).to_value(u.deg),
        moon_up.az.deg, moon_up.alt.deg,
        np.degrees(np.arcsin(MOON_RADIUS_KM / moon_up.distance.to_value(u.km))) * 3600,
        float(iers.earth_orientation_table.get().ut1_utc(t).to_value(u.s)),
        np.degrees(phase), moon.transform_to(of_date).position_angle(the_sun.transform_to(of_date)).to_value(u.deg),
    ]


def write_sky(path, rng):
    lines = [
        "# Sun, Moon and solar orientation for random instants and places, without refraction: "
        f"astropy {astropy.__version__} and sunpy {sunpy.__version__}.",
        SKY_COLUMNS,
    ]
    for _ in range(20):
        t = instant(rng.uniform(41_700, 61_700))
        lat = round(np.degrees(np.arcsin(rng.uniform(-1, 1))), 4)
        lon, height = round(rng.uniform(-180, 180), 4), round(rng.uniform(0, 40_000))
        values = ",".join(f"{value:.7f}" for value in sky_row(t, lat, lon, height))
        lines.append(f"{t.isot},{lat},{lon},{height},{values}")
    path.write_text("\n".join(lines) + "\n")


def write_rotation(path, rng):
    lines = [
        "# Where features of the Sun's surface are seen later, from the Earth's centre: "
        f"sunpy {sunpy.__version__}, propagate_with_solar_surface.",
        "epoch,utc,epoch_x_arcsec,epoch_y_arcsec,x_arcsec,y_arcsec",
    ]
    for days, x, y in TARGETS:
        epoch = instant(round(rng.uniform(52_000, 61_000), 3))
        t = epoch + days * u.day
        then = SkyCoord(x * u.arcsec, y * u.arcsec, frame=Helioprojective(observer=get_earth(epoch), obstime=epoch))
        with propagate_with_solar_surface():
            now = then.transform_to(Helioprojective(observer=get_earth(t), obstime=t))
        lines.append(f"{epoch.isot},{t.isot},{x},{y},{now.Tx.to_value(u.arcsec):.4f},{now.Ty.to_value(u.arcsec):.4f}")
    path.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    warnings.filterwarnings("ignore", message=".*dubious year.*")
    iers.conf.auto_download = False
    iers.earth_orientation_table.set(iers.IERS_A.open(astropy_iers_data.IERS_A_FILE))
    folder, seeded = Path(sys.argv[1]), np.random.default_rng(20130921)
    write_sky(folder / "sky_random.csv", seeded)
    write_rotation(folder / "rotation.csv", seeded)
