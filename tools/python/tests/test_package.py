"""Tests of docstrings, stubs and examples."""

import ast
import doctest
import importlib
import inspect
import pathlib
import pkgutil
import subprocess
import sys

import pytest

import solaspect
from solaspect import _native

STUB = ast.parse((pathlib.Path(solaspect.__file__).parent / "_native.pyi").read_text())
MODULES = ["solaspect"] + [f"solaspect.{module.name}" for module in pkgutil.iter_modules(solaspect.__path__)]


def names(nodes):
    return {node.name for node in nodes if isinstance(node, (ast.FunctionDef, ast.ClassDef))}


def public(thing):
    return {name for name in vars(thing) if not name.startswith("_")}


def test_the_stub_names_what_there_is():
    constants = {node.target.id for node in STUB.body if isinstance(node, ast.AnnAssign)}
    assert names(STUB.body) | constants == public(_native)
    for node in STUB.body:
        if isinstance(node, ast.ClassDef):
            assert names(node.body) == public(getattr(_native, node.name)), node.name


def test_everything_public_has_a_docstring():
    for name in solaspect.__all__:
        thing = getattr(solaspect, name)
        if name == "__version__":
            continue
        assert inspect.getdoc(thing), name
        if inspect.isclass(thing) and thing.__module__.startswith("solaspect"):
            for member in public(thing):
                if callable(getattr(thing, member)) or isinstance(inspect.getattr_static(thing, member), property):
                    assert inspect.getdoc(inspect.getattr_static(thing, member)), f"{name}.{member}"


def test_native_members_have_docstrings():
    for node in STUB.body:
        if isinstance(node, ast.ClassDef) and node.name not in ("Reason", "Levels"):
            thing = getattr(_native, node.name)
            for member in public(thing):
                assert inspect.getdoc(inspect.getattr_static(thing, member)), f"{node.name}.{member}"


@pytest.mark.parametrize("module", MODULES)
def test_examples_in_docstrings(module):
    assert doctest.testmod(importlib.import_module(module)).failed == 0


def test_there_are_examples():
    assert sum(len(doctest.DocTestFinder().find(function)[0].examples) for function in (solaspect.solve, solaspect.simulate)) > 5


def test_what_is_optional_is_imported_only_when_it_is_used():
    code = "import sys, solaspect; assert not {'astropy', 'sunpy', 'matplotlib'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)
