"""Every table and image of every FITS file below some folders is read by astropy without a warning, with the units that FITS knows.

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

# What is missing in a unit, a header or a column is an error here, whatever category it has.
warnings.simplefilter("error")


def check_table(path, hdu):
    """As Table and as QTable; units are those of the standard, and all others stand in the columns' comments."""
    Table.read(path, hdu=hdu.name)
    found = QTable.read(path, hdu=hdu.name)
    stated = {k: v for k, v in hdu.header.items() if k.startswith("TUNIT")}
    for unit in stated.values():
        u.Unit(unit, format="fits", parse_strict="raise")
    with_unit = [name for name in found.colnames if found[name].unit is not None]
    assert len(with_unit) == len(stated), (path, hdu.name, with_unit, stated)
    return len(stated)


def check_image(path, hdu, name):
    """Its unit, which is one of the standard, and its world coordinates, where it has any."""
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
                # In older astropy a compressed image is a table, too.
                if isinstance(hdu, fits.BinTableHDU) and not isinstance(hdu, fits.CompImageHDU):
                    units += check_table(path, hdu)
                    tables += 1
                elif hdu.data is not None:
                    check_image(path, hdu, index)
                    images += 1
print(f"{files} files: {tables} tables with {units} units, {images} images: no warning")
