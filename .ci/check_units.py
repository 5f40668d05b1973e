"""Checks that astropy reads every table and image of the FITS files under some folders without a warning, with units of the FITS standard.

    check_units.py FOLDER...
"""

import pathlib
import sys
import warnings

import astropy.units as u
from astropy.io import fits
from astropy.nddata import CCDData
from astropy.table import QTable, Table
from astropy.wcs import WCS

# Any warning about a unit, a header or a column is an error, whatever its category.
warnings.simplefilter("error")


def check_table(path, hdu):
    """Reads a table as Table and as QTable; returns the number of its units, which must be those of the standard."""
    Table.read(path, hdu=hdu.name)
    found = QTable.read(path, hdu=hdu.name)
    stated = {k: v for k, v in hdu.header.items() if k.startswith("TUNIT")}
    for unit in stated.values():
        u.Unit(unit, format="fits", parse_strict="raise")
    with_unit = [name for name in found.colnames if found[name].unit is not None]
    assert len(with_unit) == len(stated), (path, hdu.name, with_unit, stated)
    return len(stated)


def check_image(path, hdu, name):
    """Checks an image's unit, which must be one of the standard, and its world coordinates, if it has any."""
    if "BUNIT" in hdu.header:
        u.Unit(hdu.header["BUNIT"], format="fits", parse_strict="raise")
    WCS(hdu.header)
    CCDData.read(path, hdu=name, unit=None if "BUNIT" in hdu.header else "adu")


files = tables = images = units = 0
for folder in sys.argv[1:]:
    found = sorted(pathlib.Path(folder).rglob("*.fits"))
    assert found, f"{folder}: expected FITS files, found none"
    for path in found:
        files += 1
        with fits.open(path) as hdus:
            for index, hdu in enumerate(hdus):
                # In older versions of astropy a compressed image is also a table.
                if isinstance(hdu, fits.BinTableHDU) and not isinstance(hdu, fits.CompImageHDU):
                    units += check_table(path, hdu)
                    tables += 1
                elif hdu.data is not None:
                    check_image(path, hdu, index)
                    images += 1
print(f"{files} files: {tables} tables with {units} units, {images} images: no warning")
