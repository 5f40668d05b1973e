"""Three-axis aspect of a balloon gondola from its cameras, above all from the Sun on a fiducial plate.

Positions on the sensor are in px: (0, 0) is the centre of the first pixel, x grows along a row, y down the rows, so the pixel at
(x, y) is ``array[y, x]``. Positions on the plate are in mil (25.4 um) from its centre. Units stand at the end of each name.
"""

from ._native import (
    VERSION as __version__,
    Detection,
    Instrument,
    Levels,
    Mapping,
    Mark,
    Offset,
    Reason,
    SimulatedFrame,
    Solution,
    Track,
)
from . import _sunpy
from .archive import Archive, Refined, open_archive, open_refined
from .commands import calibrate_camera, calibrate_mounting, calibrate_plate, compare, refine, simulate
from .errors import SolaspectError
from .imaging import image
from .pointing import Pointing
from .plotting import plot
from .solving import solve

__all__ = [
    "Archive",
    "Detection",
    "Instrument",
    "Levels",
    "Mapping",
    "Mark",
    "Offset",
    "Pointing",
    "Reason",
    "Refined",
    "SimulatedFrame",
    "SolaspectError",
    "Solution",
    "Track",
    "__version__",
    "calibrate_camera",
    "calibrate_mounting",
    "calibrate_plate",
    "compare",
    "image",
    "open_archive",
    "open_refined",
    "plot",
    "refine",
    "simulate",
    "solve",
]

_sunpy.register()
