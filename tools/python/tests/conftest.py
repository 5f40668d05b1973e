"""What the tests share: the program, and a flight that it has made."""

import os
import pathlib
import subprocess

import matplotlib
import pytest
from astropy.utils import iers

import solaspect

matplotlib.use("Agg")
# What astropy brings along of the Earth's orientation reaches to the demonstration's day.
iers.conf.auto_download = False
REPOSITORY = pathlib.Path(__file__).parents[3]


@pytest.fixture(scope="session")
def program():
    """The program that the binding is held against, of the same commit: SOLASPECT_PROGRAM, else the repository's release build."""
    path = pathlib.Path(os.environ.get("SOLASPECT_PROGRAM", REPOSITORY / "target/release/solaspect"))
    assert path.is_file(), f"{path}: build it with `cargo build --release`, or name one in SOLASPECT_PROGRAM"
    return path


@pytest.fixture(scope="session")
def archive_directory(program, tmp_path_factory):
    """The archive of a demonstration: SOLASPECT_ARCHIVE, else one that is flown now."""
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
    """A simulated frame of the demo instrument, and the truth."""
    return solaspect.simulate(frames=1, seed=3)[0]
