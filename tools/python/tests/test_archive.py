"""Tests of archives as tables, times, arrays and maps, and of refinement and calibration as functions."""

import _thread
import csv
import threading

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table
from astropy.time import Time

import solaspect

FEW_BYTES = 100


def test_the_solution_log_is_a_table_with_times_and_units(archive):
    log = archive.solutions()
    [path] = archive.directory.glob("solutions_*.csv")
    rows = list(csv.DictReader(path.read_text().splitlines()))
    assert isinstance(log, Table) and len(log) == len(rows)
    assert log.colnames == list(rows[0])
    assert isinstance(log["utc"], Time)
    assert [f"{time}Z" for time in Time(log["utc"], precision=3).isot] == [row["utc"] for row in rows]
    assert log["sun_x_px"].unit == u.pix and log["offset_azimuth_deg"].unit == u.deg
    assert (1 * log["sun_plate_x_mil"].unit).to_value("mm") == pytest.approx(0.0254)
    assert log["scale_mil_per_px"].unit == 25.4 * u.um / u.pix
    for name in ("sun_x_px", "offset_azimuth_deg", "solve_us"):
        assert [row[name] == "" for row in rows] == log[name].mask.tolist()
        known = [float(row[name]) for row in rows if row[name]]
        assert known == log[name].compressed().tolist() and known
    assert [row["quality"] for row in rows] == list(log["quality"])


def test_the_housekeeping_is_a_table(archive):
    housekeeping = archive.housekeeping()
    assert len(housekeeping) > 0 and isinstance(housekeeping["utc"], Time)


def test_a_row_that_is_cut_off_is_dropped(archive, tmp_path):
    [path] = archive.directory.glob("solutions_*.csv")
    lines = path.read_text().splitlines(keepends=True)
    (tmp_path / path.name).write_text("".join(lines[:4]) + lines[4][:40])
    assert len(solaspect.open_archive(tmp_path).solutions()) == 3


def test_logs_of_two_starts_are_one_table(archive, tmp_path):
    [path] = archive.directory.glob("solutions_*.csv")
    header, *rows = path.read_text().splitlines(keepends=True)
    (tmp_path / "solutions_1.csv").write_text(header + rows[0])
    (tmp_path / "solutions_2.csv").write_text("".join([header, *rows[1:3]]))
    (tmp_path / "solutions_3.csv").write_text(header)
    log = solaspect.open_archive(tmp_path).solutions()
    assert len(log) == 3 and log["frame"].tolist() == archive.solutions()["frame"][:3].tolist()


def test_frames_are_arrays_that_solve_as_in_flight(archive):
    files = archive.frames()
    assert files == sorted(files) and all(path.suffix == ".fits" for path in files)
    assert archive.frames("roll") and not set(archive.frames("roll")) & set(files)
    instrument = solaspect.Instrument.load(next(archive.directory.glob("instrument_*.toml")))
    path = next(path for path in files if archive.header(path)["QUALITY"] == "fine")
    header = archive.header(path)
    solution = solaspect.solve(archive.array(path), instrument=instrument, time=header["DATE-AVG"] + "Z")
    # In flight the previous frame was the prior, so results agree only within the noise.
    assert np.hypot(solution.sun_px[0] - header["SUNPX-X"], solution.sun_px[1] - header["SUNPX-Y"]) < 0.1


def test_a_frame_is_a_map_of_the_sun(archive):
    path = next(path for path in archive.frames() if archive.header(path)["QUALITY"] == "fine")
    frame = archive.map(path)
    assert np.array_equal(frame.data, archive.array(path))
    x, y = frame.wcs.world_to_pixel_values(0, 0)
    header = archive.header(path)
    assert np.hypot(x - header["SUNPX-X"], y - header["SUNPX-Y"]) < 0.01
    assert archive.map(path.relative_to(archive.directory)).date == frame.date


def test_a_refined_flight_is_tables(archive, refined):
    aspect = refined.aspect()
    assert len(aspect) == len(archive.frames()) == refined.summary["files"]
    assert isinstance(aspect["UTC"], Time) and not np.any(aspect["UTC"].mask)
    fine = aspect["QUALITY"] == "fine"
    assert fine.any() and np.isfinite(aspect["BORESIGHT_HPLN_ARCSEC"][fine]).all()
    assert aspect["OFFSET_AZ_DEG"].unit == u.deg
    assert len(refined.smoothed()) > len(aspect)


def test_a_summary_of_an_earlier_version_is_read_under_the_new_names(tmp_path):
    (tmp_path / "aspect.fits").touch()
    (tmp_path / "summary.json").write_text('{"odd": {"off the path": 2}, "second_look": 3, "witnesses": null, "mapping": {"sigmas_raised": 1.2}}')
    summary = solaspect.open_refined(tmp_path).summary
    assert summary == {"flagged": {"off the path": 2}, "second_pass": 3, "cameras_against_gyros": None, "mapping": {"inflation": 1.2}}


def test_refine_takes_its_options(archive, tmp_path):
    times = archive.solutions()["utc"]
    some = solaspect.refine(archive.directory, tmp_path, since=times[2], until=times[6].isot + "Z", jobs=1)
    assert 4 <= len(some.aspect()) <= 5
    assert some.summary["files"] == len(some.aspect())


def test_an_interrupted_refinement_ends_and_goes_on(archive, archive_directory, tmp_path):
    ended = threading.Event()

    def interrupt():
        """Interrupts the main thread, as Ctrl-C does, when the journal has a frame."""
        while not ended.wait(0.001):
            journals = [path for path in tmp_path.glob("*.journal") if not path.name.startswith("cameras-")]
            if any(path.stat().st_size > FEW_BYTES for path in journals):
                return _thread.interrupt_main()

    thread = threading.Thread(target=interrupt)
    thread.start()
    try:
        with pytest.raises(KeyboardInterrupt):
            solaspect.refine(archive_directory, tmp_path, jobs=1)
    finally:
        ended.set()
        thread.join()
    assert not (tmp_path / "aspect.fits").exists()
    assert len(solaspect.refine(archive_directory, tmp_path).aspect()) == len(archive.frames())


def test_what_is_not_there_is_refused(tmp_path):
    with pytest.raises(solaspect.SolaspectError, match="expected the folder of an archive") as caught:
        solaspect.open_archive(tmp_path / "none")
    assert caught.value.file == str(tmp_path / "none")
    with pytest.raises(solaspect.SolaspectError, match="solutions_"):
        solaspect.open_archive(tmp_path).solutions()
    with pytest.raises(solaspect.SolaspectError, match="aspect.fits"):
        solaspect.open_refined(tmp_path)
    with pytest.raises(solaspect.SolaspectError, match="none"):
        solaspect.refine(tmp_path / "none", tmp_path / "out")
    with pytest.raises(ValueError, match="--jobs"):
        solaspect.refine(tmp_path, tmp_path / "out", jobs=0)
    with pytest.raises(ValueError, match="^time: "):
        solaspect.refine(tmp_path, tmp_path / "out", since="2013-09-21")


PLACE = (34.49, -104.2218, 38405.0)


def test_a_drift_scan_gives_the_mounting(tmp_path):
    for number, frame in enumerate(solaspect.simulate(frames=12, rate=0.02, drift=True, place=PLACE)):
        header = fits.Header({"DATE-AVG": frame.time.replace(tzinfo=None).isoformat()})
        fits.writeto(tmp_path / f"{number:03}.fits", frame.array, header)
    new = solaspect.calibrate_mounting(tmp_path, tmp_path / "new.toml", drift=True, place=PLACE)
    assert new.name == "demo"
    assert abs(new.clocking_deg - solaspect.Instrument.load("demo").clocking_deg) < 0.5
    changes = solaspect.compare("demo", new)
    assert changes["from"] == changes["to"] == "demo" and changes["rotation_deg"]["edge_arcsec"] == 0


def test_frames_that_give_no_calibration_are_refused(tmp_path, frame):
    fits.writeto(tmp_path / "one.fits", frame.array, fits.Header({"DATE-AVG": "2013-09-21T18:00:00"}))
    with pytest.raises(solaspect.SolaspectError, match="marks"):
        solaspect.calibrate_plate(tmp_path, tmp_path / "new.toml")
    with pytest.raises(solaspect.SolaspectError, match="none.fits"):
        solaspect.calibrate_plate([tmp_path / "none.fits"], tmp_path / "new.toml")
    assert not (tmp_path / "new.toml").exists()
