"""Tests of the content of plots."""

import matplotlib.pyplot as plt
import numpy as np
import pytest

import solaspect


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


def test_a_fine_frame_shows_limb_disc_marks_and_plate(frame, tmp_path):
    solution = solaspect.solve(frame.array, time=frame.time)
    ax = solaspect.plot(frame.array, solution, instrument="demo")
    _, labels = ax.get_legend_handles_labels()
    assert {"limb points", "fitted disc", "marks", "plate"} <= set(labels)
    texts = {text.get_text() for text in ax.texts}
    assert {f"({i}, {j})" for i, j in (mark.id for mark in solution.marks)} <= texts
    [disc] = [line for line in ax.lines if line.get_label() == "fitted disc"]
    radii = np.hypot(*(disc.get_xydata() - solution.sun_px).T)
    assert np.allclose(radii, solution.sun_radius_px, rtol=1e-3)
    (left, right), (bottom, top) = ax.get_xlim(), ax.get_ylim()
    assert left < solution.sun_px[0] < right and top < solution.sun_px[1] < bottom, "y grows down the rows"
    ax.figure.savefig(tmp_path / "frame.png")
    assert (tmp_path / "frame.png").stat().st_size > 10_000


def test_a_frame_without_sun_is_shown_whole_with_the_reason():
    [night] = solaspect.simulate(frames=1, no_sun=True)
    solution = solaspect.solve(night.array)
    _, axes = plt.subplots()
    ax = solaspect.plot(night.array, solution, ax=axes)
    assert ax is axes and ax.get_xlim() == (-0.5, 1295.5) and ax.get_ylim() == (965.5, -0.5)
    assert str(solution.reason) in ax.get_title() and ax.get_legend() is None
