#!/usr/bin/env python3
"""Makes the built-in table of Earth orientation of solaspect, or one for `sky.earth_orientation` of a configuration.

    python3 -m venv venv && venv/bin/pip install --upgrade astropy-iers-data
    venv/bin/python tools/iers/earth_orientation.py src/sky/earth_orientation.csv

Source: the IERS's finals2000A.all (Bulletin A: measured, then a year of predictions) and list of leap seconds, from the
package astropy-iers-data. A row every third day keeps the table small; the error of linear interpolation is below
1 ms (the script checks it). Every day of a leap second has its own row, because TAI - UTC holds from its row's 0h
UTC on.
"""

import sys
from pathlib import Path

import astropy_iers_data as iers

STEP_DAYS = 3
ALLOWED_MS = 1.0


def read_leap_seconds(path):
    """(First MJD, TAI - UTC in s) for each interval between leap seconds."""
    rows = [line.split() for line in Path(path).read_text().splitlines() if line.strip() and not line.startswith("#")]
    return [(int(float(row[0])), int(row[4])) for row in rows]


def read_finals(path):
    """(MJD, pole x and y in arcsec, UT1 - UTC in s, whether predicted), daily; ReadMe.finals2000A lists the columns.

    The columns are those of Bulletin A, since 1995 within 0.5 ms of Bulletin B and of the C04 series. Before 1990 the three
    differ by up to 6 ms (0.09 arcsec of azimuth), and Bulletin A is the smoothest.
    """
    rows = []
    for line in Path(path).read_text().splitlines():
        if line[58:68].strip() and line[18:27].strip():
            values = [float(line[a:b]) for a, b in [(7, 15), (18, 27), (37, 46), (58, 68)]]
            rows.append((int(values[0]), *values[1:], line[57] == "P"))
    return rows


def interpolated(rows, mjd):
    """UT1 - TAI at a time by linear interpolation, s."""
    after = next(n for n, row in enumerate(rows) if row[0] >= mjd)
    b = rows[after]
    a = rows[max(after - 1, 0)]
    if b[0] == mjd:
        return b[4] - b[1]
    part = (mjd - a[0]) / (b[0] - a[0])
    return (a[4] - a[1]) * (1 - part) + (b[4] - b[1]) * part


def main(target):
    leaps = read_leap_seconds(iers.IERS_LEAP_SECOND_FILE)
    daily = read_finals(iers.IERS_A_FILE)
    tai_utc = lambda mjd: max(leap for leap in leaps if leap[0] <= mjd)[1]
    first, last = daily[0][0], daily[-1][0]
    kept = {first, last} | set(range(first, last, STEP_DAYS)) | {mjd for mjd, _ in leaps if mjd > first}
    rows = [(mjd, tai_utc(mjd), x, y, ut1) for mjd, x, y, ut1, _ in daily if mjd in kept]

    worst_ms = 0.0
    for n in range(1, len(rows)):
        inside = [day for day in daily[rows[n - 1][0] - first : rows[n][0] - first]]
        for mjd, _, _, ut1, _ in inside:
            error = interpolated(rows[n - 1 : n + 1], mjd) - (ut1 - tai_utc(mjd))
            worst_ms = max(worst_ms, abs(error) * 1e3)
    if worst_ms > ALLOWED_MS:
        sys.exit(f"a row every {STEP_DAYS} days errs by {worst_ms:.2f} ms, expected at most {ALLOWED_MS} ms")

    predicted = next((mjd for mjd, *_, flag in daily if flag), None)
    lines = [
        f"# Earth orientation: IERS finals2000A.all and leap seconds, from astropy-iers-data {iers.__version__}.",
        f"# Predicted from MJD {predicted} on. Straight lines between rows err by up to {worst_ms:.2f} ms of UT1.",
        "# Made by tools/iers/earth_orientation.py. TAI - UTC holds from its row on.",
        "mjd_utc,tai_utc_s,x_arcsec,y_arcsec,ut1_utc_s",
    ]
    lines += [f"{mjd},{tai},{x:.4f},{y:.4f},{ut1:.5f}" for mjd, tai, x, y, ut1 in rows]
    Path(target).write_text("\n".join(lines) + "\n")
    print(f"{target}: {len(rows)} rows, MJD {first} to {last}, worst error {worst_ms:.3f} ms")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main(sys.argv[1])
