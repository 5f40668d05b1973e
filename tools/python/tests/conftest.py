"""Shared fixtures: the program, and a flight made by it."""

import os
import pathlib
import subprocess

import matplotlib
import pytest
from astropy.utils import iers

import solaspect

matplotlib.use("Agg")
# The Earth orientation data bundled with astropy cover the demo's date.
iers.conf.auto_download = False
REPOSITORY = pathlib.Path(__file__).parents[3]


@pytest.fixture(scope="session")
def program():
    """The program with which the binding is compared, of the same commit: SOLASPECT_PROGRAM, or the repository's release build."""
    path = pathlib.Path(os.environ.get("SOLASPECT_PROGRAM", REPOSITORY / "target/release/solaspect"))
    assert path.is_file(), f"{path}: build it with `cargo build --release`, or name one in SOLASPECT_PROGRAM"
    return path


@pytest.fixture(scope="session")
def archive_directory(program, tmp_path_factory):
    """The archive of a demo: SOLASPECT_ARCHIVE, or that of a new flight."""
    if "SOLASPECT_ARCHIVE" in os.environ:
        return pathlib.Path(os.environ["SOLASPECT_ARCHIVE"])
    directory = tmp_path_factory.mktemp("flight") / "archive"
    subprocess.run([program, "demo", "--duration", "8s", "--archive", directory], check=True, stdout=subprocess.DEVNULL)
    return directory


@pytest.fixture(scope="session")
def archive(archive_directory):
    return solaspect.open_archive(archive_directory)


@pytest.fixture(scope="session")
def refined(archive_directory, tmp_path_factory):
    return solaspect.refine(archive_directory, tmp_path_factory.mktemp("refined"))


@pytest.fixture(scope="session")
def frame():
    """A simulated frame of the demo instrument, with its truth."""
    return solaspect.simulate(frames=1, seed=3)[0]
