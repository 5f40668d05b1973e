"""Tests of images of the Sun made from photons."""

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table
from astropy.time import Time

import solaspect

PIXEL = 5 * u.arcsec
DETECTOR = """[[detector]]
scale_arcsec = 1.0
centre = [0, 0]
rotation_deg = 0
field = [[-9000, 9000], [-9000, 9000]]
"""


@pytest.fixture(scope="module")
def radius(archive):
    """The Sun's radius in the frames' headers."""
    headers = (archive.header(path) for path in archive.frames())
    return next(header["RSUN_OBS"] for header in headers if "RSUN_OBS" in header)


def on_detector(x, y, pointing):
    """Helioprojective positions in the tangent plane at the boresight, arcsec to the telescope's right and up."""

    def direction(x, y):
        return np.array([np.cos(y) * np.cos(x), np.cos(y) * np.sin(x), np.sin(y)])

    towards, boresight = direction(x, y), direction(pointing.hpln, pointing.hplt)
    west = np.cross(np.array([[0.0], [0.0], [1.0]]), boresight, axis=0)
    west /= np.linalg.norm(west, axis=0)
    north = np.cross(boresight, west, axis=0)
    plane = np.stack([(towards * axis).sum(axis=0) / (towards * boresight).sum(axis=0) for axis in (west, north)], axis=1)
    return np.einsum("nji,nj->ni", pointing.rotation_matrix(), plane).T * u.rad.to(u.arcsec)


@pytest.fixture(scope="module")
def photons(refined, radius, tmp_path_factory):
    """A million photons of a uniform disc, and their detector."""
    random = np.random.default_rng(5)
    count = 1_000_000
    table = refined.pointing()
    valid = np.asarray(table["UNIX_S"])[np.asarray(table["VALID"])]
    times = random.choice(valid, count) + random.uniform(-0.01, 0.01, count)
    pointing = refined.at(Time(times, format="unix", scale="utc"))
    distance, angle = radius * np.sqrt(random.uniform(0, 1, count)), random.uniform(0, 2 * np.pi, count)
    right, up = on_detector(distance * np.cos(angle) * u.arcsec, distance * np.sin(angle) * u.arcsec, pointing)
    known = np.isfinite(right)
    table = Table({"TIME": pointing.time.unix[known] * u.s, "PI": np.arange(count)[known] % 100, "X": right[known], "Y": up[known]})
    table.meta = {"EXTNAME": "EVENTS", "MJDREF": 40587, "TIMESYS": "UTC"}
    folder = tmp_path_factory.mktemp("photons")
    table.write(folder / "events.fits")
    (folder / "detectors.toml").write_text(DETECTOR)
    return folder


@pytest.fixture
def image(refined, photons):
    def make(**options):
        return solaspect.image(photons / "events.fits", refined, detectors=photons / "detectors.toml", pixel=PIXEL, **options)

    return make


def test_sunpys_limb_lies_on_the_limb(image, radius):
    counts, seconds = image(layer="counts"), image(layer="exposure").data
    assert abs(counts.rsun_obs.to_value("arcsec") - radius) < 0.1
    figure = plt.figure()
    ax = figure.add_subplot(projection=counts)
    counts.plot(axes=ax)
    limb, _ = counts.draw_limb(axes=ax)
    figure.canvas.draw()
    drawn = ax.transData.inverted().transform_path(limb.get_transform().transform_path(limb.get_path())).to_polygons()[0]
    plt.close(figure)
    centre = np.array([counts.reference_pixel.x.value, counts.reference_pixel.y.value])
    assert abs(counts.reference_coordinate.Tx) < 1e-6 * u.arcsec
    from_centre = drawn - centre
    y, x = np.indices(counts.data.shape)
    pixels = np.hypot(x - centre[0], y - centre[1])
    turn = np.arctan2(y - centre[1], x - centre[0])

    def brightness(where):
        return counts.data[where].sum() / seconds[where].sum()

    level = brightness(pixels < 0.9 * radius / 5)
    for sector in np.linspace(-np.pi, np.pi, 24, endpoint=False):
        inside = (turn >= sector) & (turn < sector + np.pi / 12)
        low, high = (radius + np.array([-50, 50])) / 5
        ring = inside & (pixels >= low) & (pixels < high)
        # The brightness of a ring over that of the disc is the fraction of the ring's area inside the disc.
        edge = np.sqrt(low**2 + brightness(ring) / level * (high**2 - low**2))
        angles = np.arctan2(*from_centre.T[::-1])
        near = (angles >= sector) & (angles < sector + np.pi / 12)
        assert near.any() and abs(np.hypot(*from_centre[near].T).mean() - edge) < 1, np.degrees(sector)


def test_layers_are_those_of_the_file(image, tmp_path):
    counts = image(out=tmp_path / "kept.fits", energy=("PI", 10, 29))
    with fits.open(tmp_path / "kept.fits", checksum=True) as hdus:
        assert [hdu.name for hdu in hdus] == ["COUNTS", "EXPOSURE", "INVALID"]
        assert np.array_equal(counts.data, hdus["COUNTS"].data)
        # A fifth of a million photons has these energies; those at the ends of the valid times may be invalid.
        assert 150_000 < counts.data.sum() <= 200_000
        seconds = hdus["EXPOSURE"].data
    rate = image(layer="rate", energy=("PI", 10, 29))
    assert np.isnan(rate.data[seconds == 0]).all() and rate.unit == u.ct / u.s
    assert np.allclose(rate.data[seconds > 0], (counts.data / np.where(seconds > 0, seconds, 1))[seconds > 0])
    assert counts.rotation_matrix.tolist() == [[1, 0], [0, 1]] and counts.unit == u.ct
    assert counts.observer_coordinate.radius > 0.9 * u.AU and counts.exposure_time > 0 * u.s
    with pytest.raises(ValueError, match="layer: expected one of counts"):
        image(layer="photons")
    with pytest.raises(solaspect.SolaspectError, match="column ENERGY"):
        image(energy=("ENERGY", 1, 2))
