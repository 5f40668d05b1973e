"""Tests that the binding gives the program's results bit for bit."""

import csv
import datetime
import json
import subprocess

import numpy as np
import pytest
from astropy.io import fits
from conftest import REPOSITORY

import solaspect

FRAMES = sorted((REPOSITORY / "tests/data/frames").glob("*/*"))
PLACE = (34.49, -104.2218, 38405.0)


def mid_exposure(header):
    """The mid-exposure time: DATE-AVG, or DATE-OBS plus half of EXPTIME."""
    average = header.get("DATE-AVG")
    text = average or header["DATE-OBS"]
    utc = datetime.datetime.fromisoformat(text[:26]).replace(tzinfo=datetime.timezone.utc)
    return utc if average else utc + datetime.timedelta(seconds=header["EXPTIME"] / 2)


def read(path):
    """Pixels, time and corner of a frame, read by astropy."""
    with fits.open(path) as hdus:
        [image] = [hdu for hdu in hdus if hdu.is_image and hdu.header["NAXIS"] == 2]
        header = fits.Header(hdus[0].header, copy=True)
        header.update(image.header)
        corner = (header["CORNER-X"], header["CORNER-Y"]) if "CORNER-X" in header else None
        return image.data, mid_exposure(header), corner


@pytest.fixture(scope="session")
def answers(program):
    """The program's results for all frames, by file."""
    command = [program, "solve", "--format", "jsonl", "--place", ",".join(map(str, PLACE)), *FRAMES]
    lines = subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()
    return {answer.pop("file"): answer for answer in map(json.loads, lines)}


@pytest.mark.parametrize("dtype", [">i2", ">i4", ">f4", ">f8"])
def test_negative_and_floating_point_numbers_are_read_as_the_program_reads_them(program, tmp_path, dtype):
    [frame] = solaspect.simulate(frames=1, bits=12)
    array = frame.array.astype(dtype) - np.array(7, dtype)
    if array.dtype.kind == "f":
        array /= 8
        array[::50, ::50] = np.nan
    path = tmp_path / "frame.fits"
    fits.writeto(path, array)
    command = [program, "solve", "--format", "jsonl", path]
    answer = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    solution = solaspect.solve(array)
    assert solution.quality == answer["quality"] == "fine"
    assert list(solution.sun_px) == answer["sun_px"]


@pytest.mark.parametrize("path", FRAMES, ids=lambda path: f"{path.parent.name}/{path.name[:11]}")
def test_every_number_is_that_of_the_program(path, answers):
    array, time, corner = read(path)
    solution = solaspect.solve(array, time=time, place=PLACE, corner_px=corner)
    expected, found = answers[str(path)], solution.to_dict()
    for answer in (expected, found):
        assert answer.pop("solve_us") > 0
    assert found == expected
    # The attributes have the same values.
    assert solution.quality == expected["quality"]
    for name in ("sun_px", "sun_px_sigma", "sun_plate_mil", "sun_plate_sigma_mil"):
        value = getattr(solution, name)
        assert (value is None and expected[name] is None) or value.tolist() == expected[name]
    for name in ("sun_radius_px", "sun_radius_px_sigma"):
        assert getattr(solution, name) == expected[name]
    for mark, stated in zip(solution.marks, expected["marks"] or [], strict=True):
        assert [list(mark.id), mark.px.tolist(), mark.sigma_px] == list(stated.values())
    if expected["mapping"]:
        stated = expected["mapping"]
        kind = stated.pop("kind")
        mapping = solution.mapping
        assert kind == (mapping.kind if mapping.origin == "frame" else mapping.origin)
        assert {name: getattr(mapping, name) for name in stated} == stated
    if expected["offset_deg"]:
        assert {name: getattr(solution.offset, f"{name}_deg") for name in expected["offset_deg"]} == expected["offset_deg"]
    if expected["reason"]:
        assert {name: getattr(solution.reason, name) for name in expected["reason"]} == expected["reason"]


def test_the_frames_show_all_that_is_compared(answers):
    """Otherwise the comparison could be empty and pass."""
    assert {answer["quality"] for answer in answers.values()} == {"fine", "coarse", "none"}
    assert sum(answer["offset_deg"] is not None for answer in answers.values()) > 20


def test_tracked_frames_are_those_of_the_program(program, tmp_path):
    options = {"frames": 4, "seed": 5, "drift": True}
    command = [program, "simulate", "--frames=4", "--seed=5", "--drift", "--out", tmp_path]
    subprocess.run(command, check=True)
    files = sorted(tmp_path.glob("*.fits"))
    command = [program, "solve", "--track", "--format=jsonl", *files]
    lines = subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()
    prior = None
    for frame, path, line in zip(solaspect.simulate(**options), files, lines, strict=True):
        solution = solaspect.solve(fits.getdata(path), time=frame.time, prior=prior)
        prior = solution.track
        found, expected = solution.to_dict(), json.loads(line)
        for name in ("sun_px", "sun_plate_mil", "sun_plate_sigma_mil", "marks", "mapping"):
            assert found[name] == expected[name]
    assert solution.detections == [], "the last frame's marks were predicted by its prior"


@pytest.mark.parametrize("bits", [8, 12])
def test_simulated_frames_are_those_of_the_program(program, tmp_path, bits):
    command = [program, "simulate", "--frames=2", "--rotation=-33", f"--bits={bits}", "--out", tmp_path]
    subprocess.run(command, check=True)
    frames = solaspect.simulate(frames=2, rotation=-33, bits=bits)
    truth = list(csv.DictReader((tmp_path / "truth.csv").read_text().splitlines()))
    for number, (frame, row) in enumerate(zip(frames, truth, strict=True)):
        stored = fits.getdata(tmp_path / f"frame_{number:05}.fits")
        assert frame.array.dtype == stored.dtype == (np.uint8 if bits == 8 else np.uint16)
        assert np.array_equal(frame.array, stored)
        assert frame.time == mid_exposure(fits.getheader(tmp_path / f"frame_{number:05}.fits", "FRAME"))
        exact = [*frame.sun_px, *frame.sun_plate_mil, frame.sun_radius_px]
        assert np.allclose(exact, [float(value) for value in list(row.values())[1:]], rtol=0, atol=1e-6)
