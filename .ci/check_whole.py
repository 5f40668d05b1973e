"""Checks that every file of a folder is complete: astropy reads all of it without a warning, and all checksums match."""

import pathlib
import sys

from astropy.io import fits

files = sorted(pathlib.Path(sys.argv[1]).rglob("*.fits"))
assert files, "expected FITS files, found none"
for path in files:
    with fits.open(path, disable_image_compression=True, checksum=True) as hdus:
        hdus.verify("exception")
        for hdu in hdus:
            assert "CHECKSUM" in hdu.header and "DATASUM" in hdu.header, (path, hdu.name)
    with fits.open(path) as hdus:
        assert (hdus["FRAME"].data == 7).all(), path
print(f"{len(files)} files: all whole")
