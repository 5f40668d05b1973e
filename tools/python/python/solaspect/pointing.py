"""Pointing of a refined flight at any time, with astropy's units and sunpy's coordinates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt
    from astropy.coordinates import EarthLocation, SkyCoord
    from astropy.time import Time
    from astropy.units import Quantity

    from ._native import PointingHistory

__all__ = ["Pointing", "pointing_at"]


@dataclass(frozen=True)
class Pointing:
    """Pointing at given times; each array has their shape. Unknown values are NaN.

    Attributes
    ----------
    time : Time
        The times that were asked for.
    hpln, hplt : Quantity
        Helioprojective longitude and latitude of the boresight, arcsec.
    north_angle : Quantity
        From the telescope's up to solar north, counter-clockwise as seen looking out, deg.
    azimuth, elevation : Quantity
        Of the boresight, from north through east and without refraction, deg.
    roll : Quantity
        About the boresight, right side low positive, deg.
    random, systematic : Quantity
        Covariances (..., 3, 3) of small turns that move the boresight to the telescope's right and up, and about it, arcsec^2: what changes
        from moment to moment, and what the calibration leaves.
    valid : array of bool
        Whether the pointing may be used.
    invalid : array of str
        Why not: gap, extrapolated, contradicted, slew or uncertain.
    source : array of str
        What it rests on: sun, gyros or both.
    location : EarthLocation
        Where the balloon was.
    """

    time: Time
    hpln: Quantity
    hplt: Quantity
    north_angle: Quantity
    azimuth: Quantity
    elevation: Quantity
    roll: Quantity
    random: Quantity
    systematic: Quantity
    valid: npt.NDArray[np.bool_]
    invalid: npt.NDArray[np.str_]
    source: npt.NDArray[np.str_]
    location: EarthLocation

    @property
    def sigma(self) -> Quantity:
        """1 sigma of the boresight per axis, random part, arcsec."""
        import numpy as np

        return np.sqrt((self.random[..., 0, 0] + self.random[..., 1, 1]) / 2)

    @property
    def coord(self) -> SkyCoord:
        """The boresight in sunpy's `Helioprojective`, seen from the balloon."""
        from astropy.coordinates import SkyCoord
        from sunpy.coordinates import Helioprojective

        # sunpy accepts only one-dimensional arrays of observers.
        shape = self.hpln.shape

        def row(values: Any) -> Any:
            return values.ravel() if len(shape) > 1 else values

        time = row(self.time)
        observer = SkyCoord(row(self.location).get_itrs(time))
        coord = SkyCoord(row(self.hpln), row(self.hplt), frame=Helioprojective(observer=observer, obstime=time))
        return coord.reshape(shape) if len(shape) > 1 else coord

    @property
    def observer(self) -> SkyCoord:
        """The balloon's position, as an observer of sunpy."""
        from astropy.coordinates import SkyCoord

        return SkyCoord(self.location.get_itrs(self.time))

    def rotation_matrix(self) -> npt.NDArray[np.float64]:
        """The PCij matrices (..., 2, 2) of images whose x is the telescope's right and y its up: what `make_fitswcs_header` takes."""
        import numpy as np

        angle = self.north_angle.to_value("rad")
        return np.moveaxis(np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]), (0, 1), (-2, -1))


def pointing_at(history: PointingHistory, times: Any, most_sigma: Any, fastest: Any) -> Pointing:
    """The pointing at `times`, an astropy `Time` of any shape and scale."""
    import astropy.units as u
    import numpy as np
    from astropy.coordinates import EarthLocation
    from astropy.time import Time

    time = Time(times)
    shape = time.shape
    # To the resolution of the states, a quarter of a microsecond.
    unix_s = np.atleast_1d(np.asarray(time.utc.unix, dtype=float)).ravel()
    found = history.at(
        unix_s,
        u.Quantity(most_sigma, u.arcsec).to_value(u.arcsec),
        u.Quantity(fastest, u.arcsec / u.s).to_value(u.arcsec / u.s),
    )

    def column(values: Any, *inner: int) -> Any:
        return np.asarray(values).reshape(shape + inner)

    position = column(found["position_m"], 3) * u.m
    return Pointing(
        time=time,
        hpln=column(found["hpln"]) * u.arcsec,
        hplt=column(found["hplt"]) * u.arcsec,
        north_angle=column(found["north_angle"]) * u.deg,
        azimuth=column(found["azimuth"]) * u.deg,
        elevation=column(found["elevation"]) * u.deg,
        roll=column(found["roll"]) * u.deg,
        random=column(found["random"], 3, 3) * u.arcsec**2,
        systematic=column(found["systematic"], 3, 3) * u.arcsec**2,
        valid=column(found["valid"]),
        invalid=column(found["invalid"]),
        source=column(found["source"]),
        location=EarthLocation.from_geocentric(*np.moveaxis(position, -1, 0)),
    )
