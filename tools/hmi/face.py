"""Cuts out the disc of HMI's white-light picture as a PNG, which is the surface of the simulated Sun.

    python face.py tests/data/hmi/continuum.fits src/simulate/hmi.png

The pixels are unchanged; the first row is the lowest of the picture, as in the FITS file. Needs numpy, astropy and Pillow.
"""

import sys

from astropy.io import fits
from PIL import Image

# The Sun's centre is (255.5, 255.5) (first pixel 0), its radius 202.910 px; the cut-out is centred on the Sun.
FIRST, END = 50, 462


def main(picture, out):
    pixels = fits.open(picture)[1].data
    Image.fromarray(pixels[FIRST:END, FIRST:END]).save(out, optimize=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
