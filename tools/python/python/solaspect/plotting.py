"""Pictures of a solved frame and of the pointing on the Sun. matplotlib is needed: `pip install 'solaspect[plot]'`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from . import _native

if TYPE_CHECKING:
    import numpy.typing as npt
    from astropy.table import Table
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ._native import Instrument, Mapping, Solution
    from ._types import AnyInstrument

LIMB, DISC, MARK, CUT, UNREAD, PLATE = "yellow", "lime", "deepskyblue", "orange", "red", "magenta"
#: Length of the drawn axes of the plate, mil.
AXIS_MIL = 350.0
#: The picture reaches so many radii of the disc.
REACH = 1.15


def plot(
    array: npt.NDArray[np.integer[Any] | np.floating[Any]],
    solution: Solution,
    *,
    instrument: AnyInstrument | None = None,
    ax: Axes | None = None,
    whole: bool = False,
) -> Axes:
    """Draw a frame with what was found in it, in px.

    Limb points yellow, the fitted disc green, marks blue with their ids (orange if the limb cuts them), detections that are no mark red, the
    directions of the plate's axes at the Sun magenta. With the instrument, also magenta: the circle about the plate's centre through the
    outermost marks on its axes.

    Parameters
    ----------
    array, solution
        The frame, and what `solve` made of it.
    instrument
        For the plate's circle.
    ax
        Axes to draw on; new ones if not given.
    whole
        The whole frame, not the disc alone. A frame without a disc is shown whole.

    Returns
    -------
    matplotlib.axes.Axes
    """
    import matplotlib.pyplot as plt

    if ax is None:
        _, ax = plt.subplots(figsize=(8, 8), layout="constrained")
    levels = solution.levels
    low, high = (levels.background_dn, 1.5 * levels.disc_dn) if levels else (None, None)
    ax.imshow(array, cmap="gray", vmin=low, vmax=high, interpolation="nearest")
    limits = ax.get_xlim(), ax.get_ylim()
    disc = _found(solution)
    if disc is not None:
        if instrument is not None:
            _plate(ax, disc.mapping, _native.load(instrument))
        _disc(ax, disc)
    if len(solution.limb_px):
        ax.plot(*solution.limb_px.T, ".", color=LIMB, markersize=4, label="limb points")
    _marks(ax, solution)
    if disc is not None and not whole:
        (x, y), reach = disc.px, REACH * disc.radius_px
        limits = (x - reach, x + reach), (y + reach, y - reach)
    ax.set(xlim=limits[0], ylim=limits[1], xlabel="x (px)", ylabel="y (px)", title=_title(solution))
    if ax.get_legend_handles_labels()[0]:
        ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.08), ncols=3, fontsize="small", facecolor="dimgray", labelcolor="white")
    return ax


class _Disc(NamedTuple):
    mapping: Mapping
    px: npt.NDArray[np.float64]
    mil: npt.NDArray[np.float64]
    radius_px: float


def _found(solution: Solution) -> _Disc | None:
    mapping, px, mil, radius_px = solution.mapping, solution.sun_px, solution.sun_plate_mil, solution.sun_radius_px
    if mapping is None or px is None or mil is None or radius_px is None:
        return None
    return _Disc(mapping, px, mil, radius_px)


def _circle(mapping: Mapping, centre: npt.ArrayLike, radius_mil: float) -> npt.NDArray[np.float64]:
    """A circle of the plate on the sensor."""
    angles = np.linspace(0, 2 * np.pi, 361)
    points = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return mapping.to_sensor(np.asarray(centre) + radius_mil * points)


def _disc(ax: Axes, disc: _Disc) -> None:
    """The fitted disc, and the directions of the plate's axes at its centre."""
    limb = _circle(disc.mapping, disc.mil, disc.radius_px * disc.mapping.scale_mil_per_px)
    ax.plot(*limb.T, color=DISC, linewidth=1, label="fitted disc")
    ax.plot(*disc.px, "+", color=DISC, markersize=10)
    arrow = {"arrowstyle": "->", "color": PLATE}
    for name, axis in [("X", (AXIS_MIL, 0)), ("Y", (0, AXIS_MIL))]:
        x, y = disc.mapping.to_sensor(disc.mil + np.array(axis))
        ax.annotate("", (x, y), (disc.px[0], disc.px[1]), arrowprops=arrow)
        ax.annotate(name, (x, y), color=PLATE, clip_on=True)


def _plate(ax: Axes, mapping: Mapping, instrument: Instrument) -> None:
    edge_mil = np.abs(instrument.marks_mil[(instrument.mark_ids == 0).any(axis=1)]).max()
    ax.plot(*_circle(mapping, (0, 0), edge_mil).T, "--", color=PLATE, linewidth=1, label="plate")
    ax.plot(*mapping.to_sensor((0, 0)), "+", color=PLATE, markersize=10)


def _marks(ax: Axes, solution: Solution) -> None:
    from matplotlib.patheffects import withStroke

    ring: dict[str, Any] = {"marker": "o", "facecolors": "none", "s": 150}
    for lighting, colour, label in [("full", MARK, "marks"), ("cut", CUT, "cut by the limb")]:
        marks = [mark for mark in solution.marks if mark.lighting == lighting]
        if marks:
            ax.scatter(*np.array([mark.px for mark in marks]).T, edgecolors=colour, label=label, **ring)
        for mark in marks:
            text = ax.annotate(str(mark.id), tuple(mark.px), (8, 6), textcoords="offset points", color=colour, weight="bold", clip_on=True)
            text.set_path_effects([withStroke(linewidth=2, foreground="black")])
    read = np.array([mark.px for mark in solution.marks]).reshape(-1, 2)
    unread = [d.px for d in solution.detections if not (np.hypot(*(read - d.px).T) < 2).any()]
    if unread:
        ax.scatter(*np.array(unread).T, edgecolors=UNREAD, label="not identified", **ring)


def _title(solution: Solution) -> str:
    lines: list[str] = [solution.quality]
    if solution.sun_plate_mil is not None and solution.sun_plate_sigma_mil is not None:
        (x, y), (sx, sy) = solution.sun_plate_mil, solution.sun_plate_sigma_mil
        lines[0] += f": Sun at ({x:.2f} \N{PLUS-MINUS SIGN} {sx:.2f}, {y:.2f} \N{PLUS-MINUS SIGN} {sy:.2f}) mil"
    if solution.reason is not None:
        lines.append(str(solution.reason))
    return "\n".join(lines)


class SunPath(NamedTuple):
    """Pointing at equal steps of time."""

    #: s since 1970, UTC.
    unix_s: npt.NDArray[np.float64]
    #: To solar west and north, arcsec, (n, 2).
    places: npt.NDArray[np.float64]
    valid: npt.NDArray[np.bool_]
    #: Covariance in the same axes, arcsec^2, median: (2, 2).
    covariance: npt.NDArray[np.float64]
    #: Where the telescope should point; None where that moves.
    target: tuple[float, float] | None
    limb: npt.NDArray[np.float64]
    graticule: list[npt.NDArray[np.float64]]

    @property
    def step_s(self) -> float:
        return float(np.median(np.diff(self.unix_s))) if len(self.unix_s) > 1 else 0.0

    @property
    def away(self) -> npt.NDArray[np.float64]:
        """Distance of the valid pointings from the target, arcsec; without a target from their median."""
        middle = np.median(self.places[self.valid], axis=0) if self.target is None else self.target
        return np.hypot(*(self.places[self.valid] - middle).T)


def sun_path(pointing: Table, limb: npt.NDArray[np.float64], graticule: list[npt.NDArray[np.float64]]) -> SunPath:
    """The path of the table POINTING."""

    def column(name: str) -> npt.NDArray[np.float64]:
        return np.asarray(pointing[name], dtype=float)

    valid = np.asarray(pointing["VALID"], dtype=bool)
    angle = np.radians(column("NORTH_ANGLE"))
    right_up, right, up = column("COV_RIGHT_UP"), column("VAR_RIGHT"), column("VAR_UP")
    # Covariance along solar west and north, rotated from the telescope's axes.
    cos, sin = np.cos(angle), np.sin(angle)
    west = right * cos**2 + up * sin**2 + 2 * right_up * sin * cos
    north = right * sin**2 + up * cos**2 - 2 * right_up * sin * cos
    both = (up - right) * sin * cos + right_up * (cos**2 - sin**2)
    medians = [float(np.median(values[valid])) if valid.any() else np.nan for values in (west, both, north)]
    target = pointing.meta.get("TARGETX"), pointing.meta.get("TARGETY")
    return SunPath(
        unix_s=column("UNIX_S"),
        places=np.stack([column("HPLN"), column("HPLT")], axis=1),
        valid=valid,
        covariance=np.array([medians[:2], medians[1:]]),
        target=None if None in target else target,
        limb=limb,
        graticule=graticule,
    )


def plot_path(path: SunPath, ax: Axes | None = None) -> Axes:
    """Draw a path over the Sun: the disc with its heliographic grid, valid pointings coloured by time, others grey, and the target."""
    import matplotlib.dates
    import matplotlib.pyplot as plt

    if ax is None:
        _, ax = plt.subplots(figsize=(7.5, 6.5), layout="constrained")
    _sun(ax, path)
    x, y = path.places.T
    ax.plot(x[~path.valid], y[~path.valid], ".", ms=2, color="0.7", label="not valid", zorder=2)
    if path.valid.any():
        dots = ax.scatter(x[path.valid], y[path.valid], c=_dates(path.unix_s[path.valid]), s=4, cmap="viridis", label="boresight", zorder=3)
        bar = ax.figure.colorbar(dots, ax=ax, shrink=0.8, label="UTC")
        locator = matplotlib.dates.AutoDateLocator()
        bar.ax.yaxis.set_major_locator(locator)
        bar.ax.yaxis.set_major_formatter(matplotlib.dates.ConciseDateFormatter(locator))
    if path.target is not None:
        ax.plot(*path.target, "x", color="red", ms=9, mew=1.5, label="target", zorder=4)
    reach = 1.1 * np.abs(np.vstack([path.limb, path.places[path.valid]])).max()
    ax.set(xlim=(-reach, reach), ylim=(-reach, reach))
    ax.legend(loc="upper right", fontsize="small")
    return ax


def plot_pointing(path: SunPath) -> Figure:
    """Draw the path on the whole Sun, the path near the target with the ellipse of 1 sigma, the dwell time, and the distance
    from the target."""
    import matplotlib.pyplot as plt

    figure, ((whole, near), (dwell, away)) = plt.subplots(2, 2, figsize=(12, 10), layout="constrained")
    plot_path(path, whole)
    plot_path(path, near)
    if path.valid.any():
        _about(near, path)
        _ellipse(near, path)
        _dwell(dwell, path)
        _distances(away, path)
    whole.set_title("The boresight on the Sun")
    near.set_title("The same, about the path")
    dwell.set_title("Time for which the telescope pointed there")
    away.set_title("Distance from the target" if path.target is not None else "Distance from the median")
    return figure


def _dates(unix_s: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    import matplotlib.dates

    return np.asarray(matplotlib.dates.date2num((unix_s * 1e6).astype("datetime64[us]")))


def _sun(ax: Axes, path: SunPath) -> None:
    for line in path.graticule:
        ax.plot(*line.T, color="0.85", linewidth=0.6, zorder=1)
    ax.plot(*path.limb.T, color="orange", linewidth=1.2, label="limb", zorder=1)
    ax.set(xlabel="helioprojective longitude (arcsec)", ylabel="helioprojective latitude (arcsec)", aspect="equal")


def _about(ax: Axes, path: SunPath) -> None:
    """Limit the axes to the path and the target."""
    places = path.places[path.valid]
    if path.target is not None:
        places = np.vstack([places, path.target])
    low, high = places.min(axis=0), places.max(axis=0)
    (x, y), reach = (low + high) / 2, 0.6 * max(*(high - low), 1.0)
    ax.set(xlim=(x - reach, x + reach), ylim=(y - reach, y + reach))


def _ellipse(ax: Axes, path: SunPath) -> None:
    """1 sigma of the pointing, median, in the lower left corner."""
    from matplotlib.patches import Ellipse

    squares, axes = np.linalg.eigh(path.covariance)
    width, height = 2 * np.sqrt(np.maximum(squares[::-1], 0))
    angle = np.degrees(np.arctan2(axes[1, 1], axes[0, 1]))
    (left, right), (bottom, _) = ax.get_xlim(), ax.get_ylim()
    corner = left + 0.1 * (right - left), bottom + 0.1 * (right - left)
    ax.add_patch(Ellipse(corner, width, height, angle=angle, fill=False, color="red", linewidth=1))
    ax.annotate(f"1 sigma: {width / 2:.2f} x {height / 2:.2f} arcsec", corner, (10, -4), textcoords="offset points", fontsize="small")


def _dwell(ax: Axes, path: SunPath) -> None:
    _sun(ax, path)
    _about(ax, path)
    x, y = path.places[path.valid].T
    shown_arcsec = np.array([ax.get_xlim(), ax.get_ylim()], dtype=np.float64)
    cells = np.histogram2d(x, y, bins=60, range=shown_arcsec)[0] * path.step_s
    extent = (*ax.get_xlim(), *ax.get_ylim())
    shown = ax.imshow(np.where(cells > 0, cells, np.nan).T, origin="lower", extent=extent, cmap="YlGnBu", zorder=0)
    side = (extent[1] - extent[0]) / 60
    ax.figure.colorbar(shown, ax=ax, shrink=0.8, label=f"s in a square of {side:.3g} arcsec")


def _distances(ax: Axes, path: SunPath) -> None:
    away = path.away
    ax.hist(away, bins=50, weights=np.full(len(away), path.step_s), color="#9ec5de")
    for limit, colour in ((20.0, "C1"), (60.0, "C2")):
        within = np.mean(away <= limit)
        ax.axvline(limit, color=colour, linestyle="--", label=f"within {limit:.0f} arcsec: {within:.1%}, {within * len(away) * path.step_s:.0f} s")
    ax.set(xlabel="arcsec", ylabel="s")
    ax.legend(fontsize="small")
