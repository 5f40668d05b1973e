"""Tests of the pointing of a refined flight at any time."""

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np
import pytest
import sunpy.map
from astropy.io import fits
from astropy.time import Time

import solaspect


def test_the_pointing_at_the_tables_times_is_the_tables(refined):
    table = refined.pointing()
    found = refined.at(Time(table["UNIX_S"].value, format="unix", scale="utc"))
    for name, column, unit in (
        ("hpln", "HPLN", u.arcsec),
        ("north_angle", "NORTH_ANGLE", u.deg),
        ("azimuth", "AZIMUTH", u.deg),
        ("roll", "ROLL", u.deg),
    ):
        # astropy keeps times to 1 us, in which the telescope moves by 0.001 arcsec.
        near = np.abs(getattr(found, name) - table[column].quantity) < 1e-3 * unit
        assert np.array_equal(near, np.isfinite(table[column])), name
    assert np.array_equal(found.valid, table["VALID"])
    assert list(found.invalid) == list(table["INVALID"])
    assert list(found.source) == list(table["SOURCE"])


def test_any_time_of_any_shape_and_scale_has_a_pointing(refined):
    first, last = refined.span
    middle = first + 0.4 * (last - first)
    one, same = refined.at(middle), refined.at(middle.tt)
    assert one.hpln.shape == () and abs(one.hpln - same.hpln) < 1e-3 * u.arcsec
    many = refined.at(middle + np.linspace(0, 0.2, 6).reshape(2, 3) * u.s)
    assert many.hpln.shape == (2, 3) and many.random.shape == (2, 3, 3, 3)
    assert many.coord.observer.radius.to_value("AU").all()
    assert many.sigma.unit == u.arcsec
    before = refined.at(first - 1 * u.hour)
    assert np.isnan(before.hpln) and not before.valid and before.invalid == "extrapolated"
    assert not refined.at(middle, most_sigma=1 * u.marcsec).valid


def test_the_coordinate_is_seen_from_the_balloon(refined):
    first, last = refined.span
    pointing = refined.at(first + 0.3 * (last - first))
    assert pointing.coord.frame.name == "helioprojective"
    assert pointing.location.height > 30 * u.km
    assert 140e6 * u.km < pointing.observer.transform_to("heliographic_stonyhurst").radius < 160e6 * u.km


def test_tables_are_in_the_machines_bytes_with_text_and_units(refined):
    aspect = refined.aspect()
    assert aspect["QUALITY"].dtype.kind == "U" and (aspect["QUALITY"] == "fine").any()
    assert aspect["SUN_X_MIL"].unit == u.Unit("25.4 um") and aspect["TEMPERATURE_C"].unit == u.deg_C
    assert refined.smoothed()["SPEED_X_MIL_PER_S"].unit == u.Unit("25.4 um / s")
    for table in ("smoothed", "pointing"):
        frame = refined.to_pandas(table)
        assert len(frame) and frame.iloc[:3].notna().any().any()
    with pytest.raises(ValueError, match="expected one of"):
        refined.to_pandas("none")
    with pytest.raises(solaspect.SolaspectError, match="attitude.fits"):
        refined.attitude()


def test_a_map_rotates_and_a_path_is_drawn(archive, refined):
    fine = refined.aspect()["FILE"][0]
    turned = archive.map(fine).rotate(10 * u.deg)
    assert isinstance(turned, sunpy.map.GenericMap)
    ax = refined.plot()
    assert {"limb", "boresight", "target"} <= set(ax.get_legend_handles_labels()[1])
    [limb] = [line for line in ax.lines if line.get_label() == "limb"]
    assert np.allclose(np.hypot(*limb.get_xydata().T), archive.header(fine)["RSUN_OBS"], atol=0.1)


def test_the_pointings_figure_counts_the_time_near_the_target(refined):
    figure = refined.plot_pointing()
    table = refined.pointing()
    valid = np.asarray(table["VALID"])
    away = np.hypot(table["HPLN"] - table.meta["TARGETX"], table["HPLT"] - table.meta["TARGETY"])[valid]
    texts = [text.get_text() for text in figure.axes[3].get_legend().get_texts()]
    assert [text.split(",")[0] for text in texts] == [f"within {limit} arcsec: {np.mean(away <= limit):.1%}" for limit in (20, 60)]
    plt.close("all")


def test_sunpys_time_series_read_the_pointing(refined):
    pytest.importorskip("sunpy.timeseries")
    import sunpy.timeseries

    series = sunpy.timeseries.TimeSeries(refined.directory / "aspect.fits")
    table = refined.pointing()
    assert isinstance(series, solaspect.timeseries.PointingTimeSeries)
    assert np.array_equal(series.quantity("HPLN"), table["HPLN"].quantity, equal_nan=True)
    assert series.units["AZIMUTH"] == u.deg and series.units["VAR_UP"] == u.arcsec**2
    since = (Time(series.time) - Time(table["UNIX_S"].value, format="unix")).to_value("us")
    assert np.abs(since).max() < 1
    assert series.plot().get_lines()
    half = series.truncate(*(refined.span[0] + np.array([0, 0.5]) * (refined.span[1] - refined.span[0])).isot)
    assert 0.4 < len(half.to_dataframe()) / len(table) < 0.6


def test_photons_are_put_on_the_sun_where_the_pointing_says(refined, tmp_path):
    first, last = refined.span
    midnight = Time(int(first.mjd), format="mjd", scale="utc")
    times = first + np.linspace(0.1, 0.9, 50) * (last - first)
    columns = [
        fits.Column("TIME", "D", unit="s", array=(times - midnight).to_value("s")),
        fits.Column("X", "D", array=np.zeros(50)),
        fits.Column("Y", "D", array=np.zeros(50)),
    ]
    events = fits.BinTableHDU.from_columns(columns, name="EVENTS")
    events.header["MJDREF"], events.header["TIMESYS"] = midnight.mjd, "UTC"
    events.writeto(tmp_path / "events.fits")
    detectors = tmp_path / "det.toml"
    detectors.write_text("[[detector]]\nscale_arcsec = 1.0\ncentre = [0, 0]\nrotation_deg = 0\n")
    photons = refined.events(tmp_path / "events.fits", tmp_path / "out.fits", detectors=detectors)
    pointing = refined.at(times)
    assert (photons["HP_VALID"] == pointing.valid).all() and pointing.valid.any()
    known = np.isfinite(pointing.hpln)
    assert np.abs(photons["HPX"].quantity - pointing.hpln)[known].max() < 1e-2 * u.arcsec
    with pytest.raises(solaspect.SolaspectError, match="none.fits"):
        refined.events(tmp_path / "none.fits", tmp_path / "out.fits", detectors=detectors)
