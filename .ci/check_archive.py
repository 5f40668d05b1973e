"""Every file of an archive opens in astropy without a warning, with right checksums, and holds what it should."""

import pathlib
import sys

from astropy.io import fits
from astropy.table import Table

files = sorted(pathlib.Path(sys.argv[1]).rglob("*.fits"))
assert files, "expected FITS files in the archive, found none"
fine = 0
for path in files:
    with fits.open(path, disable_image_compression=True, checksum=True) as hdus:
        hdus.verify("exception")
        for hdu in hdus:
            assert "CHECKSUM" in hdu.header and "DATASUM" in hdu.header, (path, hdu.name)
    with fits.open(path) as hdus:
        frame = hdus["FRAME"]
        assert frame.data.shape == (966, 1296), path
        header = frame.header
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
print(f"{len(files)} files, {fine} of them fine: all good")
