"""Checks an attitude of `solaspect navigate --fits --aem` or `refine --imu --aem`, read by astropy and ccsds-ndm, against attitude.csv."""

import csv
import sys
from pathlib import Path

import numpy as np
from astropy.io import fits
from astropy.table import Table
from ccsds_ndm.ndm_io import NdmIo

folder = Path(sys.argv[1])

with open(folder / "attitude.csv", newline="") as file:
    rows = list(csv.DictReader(file))
table = Table.read(folder / "attitude.fits", hdu="ATTITUDE")
assert len(table) == len(rows) > 0
# Like t_s, numpy does not count leap seconds.
epoch = np.datetime64(fits.getheader(folder / "attitude.fits")["DATEREF"], "ns")
with_attitude = [row for row in rows if row["q0"]]
for name in ("t_s", "q0", "q1", "q2", "q3", "sx_rad", "pxy_rad2"):
    written = np.array([float(row[name]) if row[name] else np.nan for row in rows])
    assert np.allclose(table[name], written, rtol=1e-9, atol=1e-15, equal_nan=True), name
assert [status.strip() for status in table["status"]] == [row["status"] for row in rows]

message = NdmIo().from_path(folder / "attitude.aem")
segments = message.body.segment
states = []
for segment in segments:
    meta = segment.metadata
    assert (meta.ref_frame_a, meta.ref_frame_b, meta.time_system.value) == ("ITRF2000", "SC_BODY_1", "UTC")
    states += segment.data.attitude_state
assert len(states) == len(with_attitude)
for state, row in list(zip(states, with_attitude))[:: max(1, len(states) // 200)]:
    seconds = (np.datetime64(state.quaternion_state.epoch.rstrip("Z"), "ns") - epoch) / np.timedelta64(1, "s")
    assert abs(seconds - float(row["t_s"])) < 2e-6, (seconds, row["t_s"])
    q = state.quaternion_state.quaternion
    written = [float(value) for value in (q.qc, q.q1, q.q2, q.q3)]
    assert np.allclose(written, [float(row[name]) for name in ("q0", "q1", "q2", "q3")], atol=1e-14)
print(f"attitude: {len(rows)} rows, {len(segments)} segments")
