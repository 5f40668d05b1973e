"""Runs the Python blocks of the pages in docs/python in order, with the archive of a flight."""

import os
import pathlib
import re
import shutil

import matplotlib.pyplot as plt
import pytest
from conftest import REPOSITORY

PAGES = sorted((REPOSITORY / "docs/python").glob("*.md"))
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def blocks(page):
    """Yields each block as compiled code with the line numbers of the page."""
    text = page.read_text()
    for block in BLOCK.finditer(text):
        lines_before = text[: block.start(1)].count("\n")
        yield compile("\n" * lines_before + block[1], str(page), "exec")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_page_runs(page, archive_directory, tmp_path, monkeypatch):
    os.symlink(archive_directory.resolve(), tmp_path / "flight")
    os.symlink(REPOSITORY / "tests/data/hmi/continuum.fits", tmp_path / "hmi.fits")
    monkeypatch.chdir(tmp_path)
    namespace = {"__name__": "__main__"}
    codes = list(blocks(page))
    assert codes, f"{page}: expected blocks of Python, found none"
    for code in codes:
        exec(code, namespace)
    plt.close("all")
    for figure in re.findall(r"^!\[.*\]\((gallery-.*\.png)\)$", page.read_text(), re.MULTILINE):
        assert (tmp_path / figure).stat().st_size > 10_000, figure
        if "SOLASPECT_GALLERY" in os.environ:
            # Keep the figure that the page shows.
            shutil.copy(tmp_path / figure, pathlib.Path(os.environ["SOLASPECT_GALLERY"]))


def test_there_are_pages():
    assert {page.stem for page in PAGES} == {"first-look", "jitter", "two-calibrations", "science-image", "gallery"}
