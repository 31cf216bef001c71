"""Every public name is documented, and every example in a docstring runs and prints what it says."""

from __future__ import annotations

import doctest
import importlib
import inspect
import pkgutil
import re

import numpy as np
import pytest

import nanite_rs as nrs

MODULES = sorted(
    m.name
    for m in pkgutil.iter_modules(nrs.__path__, "nanite_rs.")
    if not m.name.endswith(("_core", "__main__"))
)


def examples() -> list[doctest.DocTest]:
    finder = doctest.DocTestFinder(exclude_empty=True)
    found = {}
    for name in ["nanite_rs", *MODULES]:
        module = importlib.import_module(name)
        for test in finder.find(module, extraglobs={"nrs": nrs, "np": np}):
            if test.examples:
                found[test.name] = test
    return list(found.values())


@pytest.fixture(scope="module")
def frame() -> nrs.Frame:
    """What examples call `frame`."""
    scene = nrs.Scene(ambient_light=(0.1, 0.1, 0.1))
    scene.add(nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=2_000)))
    pose = np.eye(4)
    pose[2, 3] = 4.0
    with nrs.Renderer(128, 72) as renderer:
        return renderer.render(scene, nrs.PerspectiveCamera(yfov=0.8), pose)


@pytest.mark.parametrize("example", examples(), ids=lambda test: test.name)
def test_examples_run(example, frame, tmp_path, monkeypatch):
    if example.name.startswith("nanite_rs.plot"):
        pytest.importorskip("matplotlib")
    if example.name == "nanite_rs.viewer.view":
        pytest.importorskip("rendercanvas")
    monkeypatch.chdir(tmp_path)
    example.globs.setdefault("frame", frame)
    printed: list[str] = []
    flags = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS
    result = doctest.DocTestRunner(optionflags=flags).run(example, out=printed.append)
    assert result.failed == 0, "".join(printed)


def test_there_are_examples_for_the_main_names():
    names = {test.name for test in examples()}
    for name in (
        "mesh.NaniteMesh",
        "_geometry.Geometry.cut",
        "triangle_mesh.TriangleMesh",
        "decimation.decimate",
        "decimation.simplify",
        "cut.Cut",
        "report.BuildReport",
    ):
        assert f"nanite_rs.{name}" in names


def public_objects() -> list[tuple[str, object]]:
    found = []
    for name in nrs.__all__:
        value = getattr(nrs, name)
        if not (inspect.isclass(value) or inspect.isfunction(value)):
            continue
        found.append((name, value))
        if inspect.isclass(value):
            for attribute, member in vars(value).items():
                if not attribute.startswith("_") and (
                    callable(member) or isinstance(member, property | classmethod)
                ):
                    found.append((f"{name}.{attribute}", getattr(value, attribute)))
    return found


@pytest.mark.parametrize(("name", "value"), public_objects(), ids=lambda v: v if isinstance(v, str) else "")
def test_public_names_are_documented(name, value):
    text = inspect.getdoc(value)
    assert text, f"{name} has no docstring"
    assert len(text) > 4


@pytest.mark.parametrize(("name", "value"), public_objects(), ids=lambda v: v if isinstance(v, str) else "")
def test_docstrings_name_every_parameter(name, value):
    if not inspect.isfunction(value) and not inspect.ismethod(value):
        return
    text = inspect.getdoc(value) or ""
    parameters = [p for p in inspect.signature(value).parameters if p not in ("self", "cls")]
    if not parameters:
        return
    missing = [p for p in parameters if not re.search(rf"\b{p}\b", text)]
    assert not missing, f"{name}: {missing} not in its docstring"


def test_everything_public_is_exported_and_sorted():
    assert list(nrs.__all__) == sorted(nrs.__all__)
    for name in nrs.__all__:
        assert hasattr(nrs, name)
