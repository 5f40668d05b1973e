"""Checks that astropy opens every file of an archive without a warning, with valid checksums and the expected content."""

import pathlib
import sys

from astropy.io import fits
from astropy.table import Table

files = sorted(pathlib.Path(sys.argv[1]).rglob("*.fits"))
assert files, "expected FITS files in the archive, found none"
fine = rolls = 0
for path in files:
    with fits.open(path, disable_image_compression=True, checksum=True) as hdus:
        hdus.verify("exception")
        for hdu in hdus:
            assert "CHECKSUM" in hdu.header and "DATASUM" in hdu.header, (path, hdu.name)
    with fits.open(path) as hdus:
        frame = hdus["FRAME"]
        header = frame.header
        if path.name.startswith("roll_"):
            assert frame.data.shape == (360, 640), path
            assert header["QUALITY"] == "fine" and abs(header["BODYROLL"]) < 5 and header["BODYRLSG"] > 0, path
            rolls += 1
            continue
        assert frame.data.shape == (966, 1296), path
        for keyword in ("DATE-OBS", "DATE-AVG", "EXPTIME", "FRAMENUM", "OBSGEO-X", "QUALITY"):
            assert keyword in header, (path, keyword)
        if header["QUALITY"] == "fine":
            fine += 1
            marks = Table(hdus["MARKS"].data)
            assert len(marks) >= 3 and header["NMARKS"] == len(marks), path
            x, y = round(header["SUNPX-X"]), round(header["SUNPX-Y"])
            about = frame.data[y - 20 : y + 20, x - 20 : x + 20]
            assert about.max() > 10 * frame.data.mean(), path
assert fine, "expected fine frames, found none"
assert rolls, "expected frames of the roll camera, found none"
print(f"{len(files)} files, {fine} of them fine frames of the Sun, {rolls} of the horizon: all good")
