"""Converts the white-light Sun in sunpy's test data, a JPEG 2000 by SDO/HMI, to a FITS file with the truth of its header.

    pip download sunpy==7.0.5 --no-deps
    python continuum.py sunpy-7.0.5-*.whl continuum.fits

Needs numpy, astropy and Pillow with JPEG 2000.
"""

import io
import sys
import zipfile
from xml.etree import ElementTree

import numpy as np
from astropy.io import fits
from PIL import Image

PICTURE = "sunpy/data/test/2023_01_31__03_39_23_200__SDO_HMI_HMI_continuum.jp2"
NUMBERS = ["CRPIX1", "CRPIX2", "CRVAL1", "CRVAL2", "CDELT1", "CDELT2", "CROTA2", "RSUN_OBS", "DSUN_OBS", "WAVELNTH"]
TEXTS = ["CUNIT1", "CUNIT2", "CTYPE1", "CTYPE2", "DATE-OBS", "TELESCOP", "INSTRUME", "CONTENT"]


def own_header(jp2):
    """The FITS keywords in the picture's XML."""
    start, end = jp2.index(b"<meta>"), jp2.index(b"</meta>") + len(b"</meta>")
    keywords = ElementTree.fromstring(jp2[start:end]).find("fits")
    return {keyword.tag.upper(): keyword.text for keyword in keywords}


def main(wheel, out):
    jp2 = zipfile.ZipFile(wheel).read(PICTURE)
    # The first row is the uppermost in the picture, but the lowest in a FITS image.
    pixels = np.flipud(np.asarray(Image.open(io.BytesIO(jp2))))
    stated = own_header(jp2)
    header = fits.Header()
    for name in NUMBERS:
        header[name] = float(stated[name])
    for name in TEXTS:
        header[name] = stated[name]
    header["ORIGIN"] = ("sunpy 7.0.5", "test data")
    header["COMMENT"] = "Courtesy of NASA/SDO and the AIA, EVE, and HMI science teams."
    hdu = fits.CompImageHDU(pixels, header, compression_type="RICE_1")
    hdu.writeto(out, overwrite=True, checksum=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
