"""Checks with independent programs that every mark of a plate's artwork has the position and size of the drawing, to 1 um.

    check_artwork.py PROGRAM FOLDER

Draws plates of crosses and of dots, dark and clear, in FOLDER with the program `solaspect`; reads the SVG by svgelements, the DXF by ezdxf and the
Gerber file by gerbonara; and compares with marks.csv and the instrument's file.
"""

import csv
import math
import pathlib
import random
import re
import subprocess
import sys

import ezdxf
import numpy as np
from ezdxf import units
from gerbonara import GerberFile
from gerbonara.graphic_objects import Flash, Region
from gerbonara.utils import MM
from svgelements import SVG, Arc, Group, Path

TOLERANCE_MM = 1e-3
DEMO = pathlib.Path(__file__).parent.parent / "calibration" / "demo.toml"
LENGTH_MM, WIDTH_MM, DIAMETER_MM = 2.2, 0.31, 1.3
SHAPES = {
    "crosses": ("cross", 0),
    "crosses-30": ("cross", 30),
    "crosses-77": ("cross", 77.25),
    "dots": ("dot", None),
}


def make_plate(folder, shape, angle_deg):
    """Writes marks.csv and an instrument's file; the marks are at random positions in a disc of 150 mm diameter."""
    folder.mkdir(parents=True)
    rng = random.Random(5)
    places = []
    while len(places) < 150:
        place = [rng.uniform(-75, 75), rng.uniform(-75, 75)]
        if math.hypot(*place) < 75 and all(math.dist(place, other) > 6 for other in places):
            places.append(place)
    with open(folder / "marks.csv", "w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["i", "j", "x_mm", "y_mm"])
        table.writerows([n, 0, f"{x:.7f}", f"{y:.7f}"] for n, (x, y) in enumerate(places))

    def entry(key, length_mm):
        return f'{key} = {{ value = {length_mm / 0.0254!r}, source = "check" }}\n'

    plate = f'[plate]\nmarks = "marks.csv"\nshape = "{shape}"\ndrawing_sigma_mil = {{ value = 1, source = "check" }}\n'
    if shape == "dot":
        plate += entry("dot_diameter_mil", DIAMETER_MM)
    else:
        plate += entry("arm_length_mil", LENGTH_MM) + entry("arm_width_mil", WIDTH_MM)
        plate += f'arm_angle_deg = {{ value = {angle_deg}, source = "check" }}\n'
    text, count = re.subn(r"\[plate\]\n(?:[^\[\n].*\n)+", plate, DEMO.read_text())
    assert count == 1
    (folder / "plate.toml").write_text(text)


def read_svg(path):
    """Corners of polygons, and centres and diameters of circles, mm, y upwards. At 25.4 px per inch a px is 1 mm on the printed page."""
    svg = SVG.parse(path, ppi=25.4)
    corner = svg.viewbox.x, svg.viewbox.y
    (group,) = (element for element in svg.elements() if isinstance(element, Group) and element.id == "marks")
    (marks,) = group
    assert marks.values["fill-rule"] == "evenodd"

    def from_plate(x, y):
        return x + corner[0], -(y + corner[1])

    for part in marks.as_subpaths():
        part = Path(part)
        if any(isinstance(segment, Arc) for segment in part):
            left, top, right, bottom = part.bbox()
            assert abs((right - left) - (bottom - top)) < TOLERANCE_MM
            yield from_plate((left + right) / 2, (top + bottom) / 2), right - left
        else:
            ends = [segment.end for segment in part if segment.end is not None]
            yield [from_plate(end.x, end.y) for end in ends[:-1]], None


def read_dxf(path):
    document = ezdxf.readfile(path)
    assert document.units == units.MM, document.units
    assert not document.audit().errors
    for layer in "GROUND", "MARKS":
        for entity in document.modelspace().query(f'*[layer=="{layer}"]'):
            if entity.dxftype() == "CIRCLE":
                yield entity.dxf.center.vec2, 2 * entity.dxf.radius
            else:
                assert entity.dxftype() == "LWPOLYLINE" and entity.closed
                yield list(entity.get_points("xy")), None


def read_gerber(path, count, clear):
    """Ground and marks, which are the first shapes of the file; in the clear tone the marks are cut from the ground."""
    shapes = [shape for shape in GerberFile.open(path).objects if isinstance(shape, Region | Flash)]
    shapes = shapes[: clear + count]
    dark = [shape.polarity_dark for shape in shapes]
    assert dark == [True] * clear + [not clear] * count, path
    for shape in shapes:
        assert shape.unit == MM
        if isinstance(shape, Flash):
            yield (shape.x, shape.y), shape.aperture.diameter
        else:
            assert shape.outline[0] == shape.outline[-1]
            yield shape.outline[:-1], None


def error_of_cross(corners, centre, angle_deg):
    """Largest distance of a corner of a cross from that of the drawing, mm."""
    tip, side = LENGTH_MM / 2, WIDTH_MM / 2
    expected = [(u * s, v * t) for u, v in ((tip, side), (side, tip), (side, side)) for s in (1, -1) for t in (1, -1)]
    turn = math.radians(angle_deg)
    rotation = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    expected = np.array(expected) @ rotation.T + centre
    assert len(corners) == len(expected)
    distances = np.linalg.norm(np.array(corners)[:, None] - expected[None], axis=2)
    return max(distances.min(axis=0).max(), distances.min(axis=1).max())


def check(path, shapes, marks, clear, angle_deg):
    """Compares the shapes of a file with the drawing; returns the largest difference of a position or size, mm."""
    shapes = list(shapes)
    if clear:
        ground, _ = shapes.pop(0)
        assert len(ground) == 4
        low, high = np.min(ground, axis=0), np.max(ground, axis=0)
        assert (low < marks.min(axis=0) - 2).all() and (high > marks.max(axis=0) + 2).all(), path
    assert len(shapes) == len(marks), (path, len(shapes))
    worst, found = 0, set()
    for points, diameter in shapes:
        centre = np.asarray(points, float).reshape(-1, 2).mean(axis=0)
        distances = np.linalg.norm(marks - centre, axis=1)
        mark = int(distances.argmin())
        found.add(mark)
        worst = max(worst, distances[mark])
        if diameter is None:
            worst = max(worst, error_of_cross(points, marks[mark], angle_deg))
        else:
            worst = max(worst, abs(diameter - DIAMETER_MM))
    assert found == set(range(len(marks))), path
    assert worst < TOLERANCE_MM, (path, worst)
    return worst


program, folder = sys.argv[1], pathlib.Path(sys.argv[2])
for name, (shape, angle_deg) in SHAPES.items():
    plate = folder / name
    make_plate(plate, shape, angle_deg)
    with open(plate / "marks.csv") as file:
        marks = np.array([[float(row["x_mm"]), float(row["y_mm"])] for row in csv.DictReader(file)])
    for clear in False, True:
        out = plate / ("clear" if clear else "dark")
        subprocess.run([program, "plate", "draw", plate / "plate.toml", "--out", out, *["--clear"] * clear], check=True, stdout=subprocess.DEVNULL)
        readers = {
            "plate.svg": read_svg(out / "plate.svg"),
            "plate.dxf": read_dxf(out / "plate.dxf"),
            "plate.gbr": read_gerber(out / "plate.gbr", len(marks), clear),
        }
        for file, shapes in readers.items():
            worst = check(out / file, shapes, marks, clear, angle_deg)
            print(f"{name}, {out.name}, {file}: {len(marks)} marks within {worst * 1e6:.1f} nm")
