"""Tests of solutions from arrays, and of errors that name the invalid argument."""

import copy
import datetime
import pathlib
import pickle
import sys
import threading
import tracemalloc

import numpy as np
import pytest
from astropy.coordinates import EarthLocation
from astropy.io import fits
from astropy.time import Time

import solaspect

PLACE = (34.49, -104.2218, 38405.0)


def same(a, b):
    """Whether two solutions have the same numbers."""
    a, b = a.to_dict(), b.to_dict()
    a.pop("solve_us"), b.pop("solve_us")
    return a == b


def test_the_sun_is_where_it_is_in_truth(frame):
    solution = solaspect.solve(frame.array, time=frame.time, place=PLACE)
    assert solution.quality == "fine" and solution.reason is None
    assert np.hypot(*(solution.sun_px - frame.sun_px)) < 5 * solution.sun_px_sigma.max()
    assert np.hypot(*(solution.sun_plate_mil - frame.sun_plate_mil)) < 5 * solution.sun_plate_sigma_mil.max()
    assert abs(solution.sun_radius_px - frame.sun_radius_px) < 5 * solution.sun_radius_px_sigma
    truth = dict(zip(map(tuple, frame.mark_ids.tolist()), frame.marks_px))
    for mark in solution.marks:
        assert np.hypot(*(mark.px - truth[mark.id])) < 0.2
    assert solution.contradictions == []


def test_every_stage_has_its_product(frame):
    solution = solaspect.solve(frame.array, time=frame.time, place=PLACE)
    assert solution.time == frame.time
    levels = solution.levels
    assert levels.background_dn < levels.disc_dn and levels.noise_dn > 0
    assert solution.limb_px.shape == (len(solution.limb_sigma_px), 2) and len(solution.limb_px) > 40
    radii = np.hypot(*(solution.limb_px - solution.sun_px).T)
    assert np.abs(radii - solution.sun_radius_px).max() < 1
    assert solution.limb_blur_px > 0 and 0.5 < solution.limb_fraction <= 1
    assert len(solution.detections) >= len(solution.marks) >= 3
    for covariance, sigma in [
        (solution.sun_px_covariance, solution.sun_px_sigma),
        (solution.sun_plate_covariance_mil2, solution.sun_plate_sigma_mil),
    ]:
        assert np.allclose(covariance, covariance.T, rtol=0, atol=1e-12 * covariance.max())
        assert np.array_equal(np.sqrt(np.diag(covariance)), sigma)
    offset = solution.offset
    assert offset.covariance_deg2.shape == offset.calibration_covariance_deg2.shape == (2, 2)
    assert np.sqrt(np.trace(offset.covariance_deg2) / 2) == pytest.approx(offset.sigma_deg, rel=1e-12)
    assert repr(solution).startswith("Solution(fine, Sun at (") and "mil" in repr(solution)


def test_the_mapping_goes_both_ways_and_is_its_matrix(frame):
    mapping = solaspect.solve(frame.array).mapping
    px = np.array([[100.5, 200], [640, 480.25]])
    mil = mapping.to_plate(px)
    assert mil.shape == px.shape and mapping.to_plate(px[0]).shape == (2,)
    assert np.allclose(mapping.to_sensor(mil), px, rtol=0, atol=1e-9)
    homogeneous = np.column_stack([px, np.ones(2)]) @ mapping.matrix.T
    assert np.allclose(homogeneous[:, :2] / homogeneous[:, 2:], mil, rtol=0, atol=1e-9)
    with pytest.raises(ValueError, match="^px: .*last axis"):
        mapping.to_plate([1.0, 2.0, 3.0])


def test_a_frame_without_sun_is_a_solution_that_says_why():
    [night] = solaspect.simulate(frames=1, no_sun=True)
    assert night.sun_px is None and len(night.mark_ids) == 0
    solution = solaspect.solve(night.array, time=night.time, place=PLACE)
    assert solution.quality == "none" and solution.sun_px is solution.mapping is solution.offset is None
    assert solution.limb_px.shape == (0, 2) and solution.marks == []
    assert solution.reason.stage == "levels" or solution.reason.stage == "limb"
    assert str(solution.reason) in repr(solution)


@pytest.mark.parametrize("bits", [8, 12])
def test_any_layout_gives_the_same(bits):
    [frame] = solaspect.simulate(frames=1, bits=bits)
    expected = solaspect.solve(frame.array)
    wide = np.zeros((frame.array.shape[0], 2 * frame.array.shape[1]), frame.array.dtype)
    wide[:, ::2] = frame.array
    other_order = frame.array.astype(frame.array.dtype.newbyteorder())
    unaligned = np.frombuffer(b"\0" + frame.array.tobytes(), frame.array.dtype, offset=1).reshape(frame.array.shape)
    read_only = frame.array.copy()
    read_only.flags.writeable = False
    reversed_twice = frame.array[::-1][::-1]
    for array in (np.asfortranarray(frame.array), wide[:, ::2], reversed_twice, other_order, unaligned, read_only):
        assert same(solaspect.solve(array), expected)


@pytest.mark.parametrize("dtype", ["<i2", ">i2", ">u2", "<i4", ">i4", "<u4", ">u4", "<i8", ">u8"])
def test_whole_numbers_of_any_type_are_pixels(dtype):
    [frame] = solaspect.simulate(frames=1, bits=12)
    expected = solaspect.solve(frame.array)
    array = frame.array.astype(dtype)
    for array in (array, np.asfortranarray(array), np.repeat(array, 2, axis=1)[:, ::2]):
        assert same(solaspect.solve(array), expected)


def test_an_array_as_astropy_reads_it_is_solved_as_the_program_solves_its_file(tmp_path):
    """A frame without BZERO, as many cameras write it, is big-endian int16 in astropy."""
    [frame] = solaspect.simulate(frames=1, bits=12)
    path = tmp_path / "frame.fits"
    fits.writeto(path, frame.array.astype(">i2"))
    with fits.open(path) as hdus:
        array = hdus[0].data
        assert array.dtype.kind == "i" and not array.dtype.isnative
        assert same(solaspect.solve(array), solaspect.solve(frame.array))


def test_a_contiguous_array_is_not_copied(frame):
    def allocated(array):
        tracemalloc.start()
        solaspect.solve(array)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return peak

    assert allocated(np.asfortranarray(frame.array)) >= frame.array.nbytes
    assert allocated(frame.array) < frame.array.nbytes / 10


def test_the_gil_is_released(frame):
    """With a switch interval of 1000 s, another thread runs only while the solver has released the GIL."""
    seen = threading.Event()
    started = threading.Event()

    def solve():
        started.set()
        for _ in range(1000):
            solaspect.solve(frame.array)
            if seen.is_set():
                return

    before = sys.getswitchinterval()
    sys.setswitchinterval(1000.0)
    try:
        thread = threading.Thread(target=solve)
        thread.start()
        started.wait()
        ran = thread.is_alive()
        seen.set()
        thread.join()
    finally:
        sys.setswitchinterval(before)
    assert ran, "the solver's thread held the GIL until it had solved 1000 frames"


def test_threads_give_the_same(frame):
    from concurrent.futures import ThreadPoolExecutor

    expected = solaspect.solve(frame.array)
    with ThreadPoolExecutor(4) as pool:
        for solution in pool.map(solaspect.solve, [frame.array] * 8):
            assert same(solution, expected)


def test_a_time_is_one_instant_however_it_is_stated(frame):
    zone = datetime.timezone(datetime.timedelta(hours=-6))
    times = [
        "2013-09-21T18:00:00.25Z",
        "2013-09-21T12:00:00.250-06:00",
        datetime.datetime(2013, 9, 21, 12, 0, 0, 250_000, tzinfo=zone),
        Time("2013-09-21T18:00:00.25", scale="utc"),
        Time("2013-09-21T18:00:00.25", scale="utc").tai,
    ]
    for time in times:
        assert solaspect.solve(frame.array, time=time).time.isoformat() == "2013-09-21T18:00:00.250000+00:00"


def test_a_place_may_be_an_earth_location(frame):
    latitude, longitude, height = PLACE
    location = EarthLocation.from_geodetic(longitude, latitude, height)
    by_place, located = (solaspect.solve(frame.array, time=frame.time, place=place) for place in (PLACE, location))
    assert located.offset.azimuth_deg == pytest.approx(by_place.offset.azimuth_deg, abs=1e-9)


def test_the_target_moves_the_offset(frame):
    centre, west = (
        solaspect.solve(frame.array, time=frame.time, place=PLACE, target=target).offset for target in ((0, 0), (300, 0))
    )
    moved = np.hypot(west.cross_elevation_deg - centre.cross_elevation_deg, west.elevation_deg - centre.elevation_deg)
    # Coordinate differences at 1 deg from the target equal the true angle only to a few per cent.
    assert moved * 3600 == pytest.approx(300, rel=0.03)


def test_a_part_of_the_sensor_is_placed_by_its_corner(frame):
    x, y = (max(int(v) - 130, 0) for v in frame.sun_px)
    part = frame.array[y : y + 260, x : x + 260]
    whole, solution = solaspect.solve(frame.array), solaspect.solve(part, corner_px=(x, y))
    assert solution.quality == "fine"
    assert np.allclose(solution.sun_px + [x, y], whole.sun_px, atol=0.01)


FRAME = np.zeros((966, 1296), np.uint8)
NAIVE = datetime.datetime(2013, 9, 21, 18)


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"array": FRAME.tolist()}, TypeError, "^array: expected a numpy.ndarray of whole numbers, found list$"),
        ({"array": FRAME.astype(bool)}, TypeError, "^array: expected numbers of an integer or floating-point dtype, found dtype bool$"),
        ({"array": np.full(FRAME.shape, np.nan)}, ValueError, "^array: pixels: expected some pixel with a value, found none$"),
        ({"array": FRAME[0].astype(np.int16)}, ValueError, "^array: expected 2 dimensions .* found 1$"),
        ({"array": FRAME[:0].astype(np.int16)}, ValueError, "^array: expected a frame of at least one pixel"),
        ({"array": np.ma.masked_equal(FRAME, 0)}, TypeError, "^array: expected an array without a mask, found MaskedArray$"),
        ({"array": FRAME[0]}, ValueError, "^array: expected 2 dimensions .* found 1$"),
        ({"array": FRAME[None]}, ValueError, "^array: expected 2 dimensions .* found 3$"),
        ({"array": FRAME[:0]}, ValueError, "^array: expected a frame of at least one pixel"),
        ({"array": FRAME.T}, ValueError, '^array: size: expected 1296 x 966 px as of instrument "demo", found 966 x 1296; a part of the sensor is placed by CORNER-X and CORNER-Y'),
        ({"time": "2013-09-21T18:00:00"}, ValueError, "^time: expected a time with its zone"),
        ({"time": "yesterday"}, ValueError, "^time: expected a time with its zone"),
        ({"time": NAIVE}, ValueError, "^time: expected a datetime with its zone"),
        ({"time": Time(["2013-09-21"] * 2)}, ValueError, "^time: expected one time"),
        ({"time": 1.5e9}, TypeError, "^time: expected a str with its zone .* found float$"),
        ({"time": np.datetime64("2013-09-21")}, TypeError, "^time: expected a str"),
        ({"place": (91, 0, 0)}, ValueError, "^place: expected a latitude from -90 to 90 deg, found 91$"),
        ({"place": (34.49, -104.2)}, TypeError, "^place: expected .*latitude, longitude, height"),
        ({"place": "Fort Sumner"}, TypeError, "^place: expected"),
        ({"target": (1.0, float("nan"))}, ValueError, "^target: expected finite numbers$"),
        ({"target": 3}, TypeError, r"^target: expected \(x, y\) in arcsec"),
        ({"instrument": 3}, TypeError, "^instrument: expected an Instrument, .* found int$"),
        ({"prior": "none"}, TypeError, "^prior: expected the track of a Solution, found str$"),
        ({"saturation_dn": -1}, ValueError, "^saturation_dn: expected a whole number from 0 to 65535 DN, found -1$"),
        ({"saturation_dn": 70_000}, ValueError, "^saturation_dn: .* found 70000$"),
        ({"saturation_dn": "many"}, TypeError, "^saturation_dn: .* found 'many'$"),
        ({"corner_px": 3}, TypeError, r"^corner_px: expected \(column, row\)"),
        ({"corner_px": (-1, 0)}, ValueError, r"^corner_px: .* found \(-1, 0\)$"),
    ],
)
def test_what_cannot_be_is_refused_by_the_arguments_name(arguments, error, message):
    with pytest.raises(error, match=message):
        solaspect.solve(**{"array": FRAME, **arguments})


def test_an_instruments_file_is_refused_by_file_and_field(tmp_path):
    text = (pathlib.Path(__file__).parents[3] / "calibration/demo.toml").read_text()
    path = tmp_path / "bad.toml"
    path.write_text(text.replace("scale_mil_per_px", "scale_mil_per_pixel"))
    with pytest.raises(solaspect.SolaspectError, match="scale_mil_per_px") as caught:
        solaspect.Instrument.load(path)
    assert caught.value.file == str(path) and "scale_mil_per_pixel" in caught.value.field
    again = pickle.loads(pickle.dumps(caught.value))
    assert (str(again), again.file, again.field) == (str(caught.value), caught.value.file, caught.value.field)
    with pytest.raises(solaspect.SolaspectError, match="expected a file, or a built-in") as caught:
        solaspect.solve(FRAME, instrument=tmp_path / "missing.toml")
    assert caught.value.file == str(tmp_path / "missing.toml") and caught.value.field is None


def test_an_instrument_is_loaded_by_name_or_path():
    assert "demo" in solaspect.Instrument.builtin_names()
    path = pathlib.Path(__file__).parents[3] / "calibration/heroes-pyas-f.toml"
    for instrument in map(solaspect.Instrument.load, ["heroes-pyas-f", path, str(path)]):
        assert instrument.name == "heroes-pyas-f"
        assert instrument.shape == (966, 1296) and instrument.scale_mil_per_px > 5
        assert instrument.marks_mil.shape == instrument.mark_ids.shape == (225, 2)
        assert repr(instrument).startswith('Instrument("heroes-pyas-f", 1296 x 966 px')


def test_a_simulation_that_cannot_be_is_refused_by_its_option():
    with pytest.raises(ValueError, match="--noise"):
        solaspect.simulate(noise=-3)
    with pytest.raises(TypeError, match="unknown"):
        solaspect.simulate(unknown=1)
    with pytest.raises(ValueError, match="^time:"):
        solaspect.simulate(utc="2013-09-21")


def test_a_solution_pickles_whole(frame):
    solution = solaspect.solve(frame.array, time=frame.time, place=(34.5, -104.2, 38_000))
    again = pickle.loads(pickle.dumps(solution))
    assert again.to_dict() == solution.to_dict() and repr(again) == repr(solution)
    assert np.array_equal(again.limb_px, solution.limb_px) and len(again.detections) == len(solution.detections)
    assert np.array_equal(again.mapping.to_plate([[10.0, 20.0]]), solution.mapping.to_plate([[10.0, 20.0]]))
    # Also as the prior of the next frame, and for a frame without a Sun.
    prior = [solaspect.solve(frame.array, prior=one.track).to_dict() | {"solve_us": 0} for one in (solution, again)]
    assert prior[0] == prior[1]
    none = copy.deepcopy(solaspect.solve(np.zeros_like(frame.array)))
    assert none.quality == "none" and none.reason.code
    with pytest.raises(ValueError, match="pickle: expected one of solaspect"):
        solaspect.Solution(b"garbage")
