"""A solved frame as a picture. matplotlib is needed: `pip install 'solaspect[plot]'`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from . import _native

if TYPE_CHECKING:
    import numpy.typing as npt
    from astropy.table import Table
    from matplotlib.axes import Axes

    from ._native import Instrument, Mapping, Solution
    from ._types import AnyInstrument

LIMB, DISC, MARK, CUT, UNREAD, PLATE = "yellow", "lime", "deepskyblue", "orange", "red", "magenta"
#: Length of the drawn axes of the plate, mil.
AXIS_MIL = 350.0
#: The limb, to a hundredth, whatever the day.
SUN_RADIUS_ARCSEC = 960.0
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


def plot_path(pointing: Table, ax: Axes | None = None) -> Axes:
    """Draw where on the Sun a telescope pointed: the table POINTING."""
    import matplotlib.pyplot as plt
    from matplotlib.patches import Circle

    if ax is None:
        _, ax = plt.subplots(figsize=(7, 7), layout="constrained")
    x, y = (np.asarray(pointing[name], dtype=float) for name in ("HPLN", "HPLT"))
    valid = np.asarray(pointing["VALID"], dtype=bool)
    for shown, colour, name in ((~valid, "0.7", "not valid"), (valid, "C0", "valid")):
        ax.plot(x[shown], y[shown], ".", ms=2, color=colour, label=name)
    ax.add_patch(Circle((0, 0), SUN_RADIUS_ARCSEC, fill=False, color="orange", label="the Sun's limb"))
    ax.set(xlabel="helioprojective longitude, arcsec", ylabel="helioprojective latitude, arcsec", aspect="equal")
    ax.legend(loc="upper right")
    return ax
