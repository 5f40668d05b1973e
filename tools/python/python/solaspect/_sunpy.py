"""Registers the pointing with sunpy's time series when these are imported: sunpy takes seconds to import, and is optional."""

from __future__ import annotations

import importlib.util
import sys
from importlib.abc import MetaPathFinder
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence
    from importlib.machinery import ModuleSpec
    from types import ModuleType

_SERIES = "sunpy.timeseries"


def register() -> None:
    """Register the series now or when sunpy's are imported."""
    if _SERIES in sys.modules:
        from . import timeseries  # noqa: F401
    else:
        sys.meta_path.insert(0, _AtImport())


class _AtImport(MetaPathFinder):
    """Import hook: registers the series after the module is imported."""

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        if name != _SERIES:
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(name)
        if spec is not None and spec.loader is not None:
            run = spec.loader.exec_module

            def run_both(module: ModuleType) -> None:
                run(module)
                from . import timeseries  # noqa: F401

            spec.loader.exec_module = run_both  # type: ignore[method-assign]
        return spec
