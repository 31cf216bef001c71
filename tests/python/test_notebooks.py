"""The notebooks run as they are and on a mesh of one's own, and are stored so that changes are easy to read."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import nanite_rs as nrs
from oracles import subjects

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
FACES = "20000"
NEEDED = ("nbclient", "nbformat", "ipykernel", "ipywidgets", "matplotlib", "fast_simplification", "shapely")

PICTURES = {
    "01_build": {"from-arrays", "levels", "cut-picture"},
    "02_lod_cuts": {"error", "error-once", "pixels", "pixels-once", "budget", "budget-once", "curve"},
    "03_streaming": {"pages", "flight-plots", "frames", "wait"},
    "04_render": {
        "setup",
        "first",
        "outputs",
        "views",
        "stats",
        "materials",
        "instances",
        "path",
    },
    "05_compare": {"plots", "break-even"},
    "06_nature": {"leaves", "levels", "crowd", "displace", "terrain", "imposter"},
}
"""Cells that show a picture, whatever the machine."""

PRINTED = {
    "01_build": ("levels-together", r"triangles in all levels: 3\.[2-5]\d times"),
    "02_lod_cuts": ("setup", r"NaniteMesh\((19|20),\d{3} faces"),
    "03_streaming": ("wait", "the same picture: True"),
    "04_render": ("instances", "625 instances"),
    "05_compare": ("table", r"nanite_rs, cut of a built mesh +\d,\d{3} +\d+\.\d +0\.\d{4}"),
    "06_nature": ("leaves", r"leaves +leaves \(mask, \d+% of its image is empty\)"),
}
"""A cell of each, and what it says."""


def execute(path: Path, folder: Path, **environment: str) -> dict[str, list[dict]]:
    """Run a notebook as `make notebooks` does, in a process of its own; outputs by the names of cells."""
    missing = [name for name in NEEDED if importlib.util.find_spec(name) is None]
    if missing:
        pytest.skip(f"notebooks need {', '.join(missing)}")
    own = {"PYTHONPATH": str(ROOT / "python"), "IPYTHONDIR": str(folder / "ipython")}
    settings = {"NANITE_NOTEBOOK_FACES": FACES, "MESH": "", "MESH_UP": "y"} | own | environment
    done = subprocess.run(
        [sys.executable, str(ROOT / "tools/run-notebooks.py"), "--timeout", "120", str(folder), str(path)],
        capture_output=True,
        text=True,
        env=os.environ | settings,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.fullmatch(rf"{path.name}: [\d.]+ s\n", done.stdout)
    cells = json.loads((folder / path.name).read_text(encoding="utf-8"))["cells"]
    return {cell["id"]: cell["outputs"] for cell in cells if cell["cell_type"] == "code"}


def text(outputs: list[dict]) -> str:
    """What a cell printed."""
    return "".join("".join(output["text"]) for output in outputs if output["output_type"] == "stream")


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_runs_and_shows_its_pictures(path, tmp_path) -> None:
    cells = execute(path, tmp_path)
    made = [output for outputs in cells.values() for output in outputs]
    # Sliders show errors of their functions and go on; warnings go to stderr.
    assert not [
        output for output in made if output["output_type"] == "error" or output.get("name") == "stderr"
    ]
    shown = {file.stem.rpartition("-")[0] for file in (tmp_path / path.stem).iterdir()}
    assert shown >= PICTURES[path.stem]
    assert shown <= set(cells)
    cell, pattern = PRINTED[path.stem]
    assert re.search(pattern, text(cells[cell]))


@pytest.mark.parametrize("path", NOTEBOOKS[:2], ids=lambda path: path.stem)
def test_nbconvert_runs_a_copy_elsewhere(path, tmp_path) -> None:
    """With nothing of the repository but the package: a notebook stands for itself, sliders included."""
    for name in (*NEEDED, "nbconvert"):
        pytest.importorskip(name)
    (tmp_path / path.name).write_text(path.read_text(encoding="utf-8"), encoding="utf-8")
    settings = {"NANITE_NOTEBOOK_FACES": FACES, "MESH": "", "IPYTHONDIR": str(tmp_path / "ipython")}
    settings |= {"PYTHONPATH": str(Path(nrs.__file__).parents[1])}
    inherited = {name: value for name, value in os.environ.items() if name != "MPLBACKEND"}
    command = [sys.executable, "-m", "nbconvert", "--execute", "--to", "notebook", "--output", "done.ipynb"]
    done = subprocess.run(
        [*command, path.name],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        env=inherited | settings,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    made = [
        c["outputs"] for c in json.loads((tmp_path / "done.ipynb").read_text())["cells"] if "outputs" in c
    ]
    pictures = [one for outputs in made for one in outputs if "image/png" in one.get("data", {})]
    assert len(pictures) >= len(PICTURES[path.stem])


def test_they_run_with_a_mesh_of_ones_own(tmp_path) -> None:
    mesh = subjects.built("part")
    mesh.cut(error=0.0).to_trimesh().export(tmp_path / "my own.ply")
    relative = os.path.relpath(tmp_path / "my own.ply")
    cells = execute(ROOT / "notebooks/01_build.ipynb", tmp_path, MESH=relative)
    assert f"NaniteMesh({len(mesh):,} faces" in text(cells["from-arrays"])
    assert len(nrs.NaniteMesh.open(tmp_path / "output/mesh.nanite")) == len(mesh)
    assert not (tmp_path / "output/knot.ply").exists()


def test_a_cell_that_fails_is_shown(tmp_path) -> None:
    nbformat = pytest.importorskip("nbformat")
    broken = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell("raise ValueError('on purpose')")])
    nbformat.write(broken, tmp_path / "broken.ipynb")
    with pytest.raises(AssertionError, match="on purpose"):
        execute(tmp_path / "broken.ipynb", tmp_path / "out")


def test_all_are_here() -> None:
    assert [path.stem for path in NOTEBOOKS] == sorted(PICTURES)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_its_form_is_stable(path) -> None:
    """Sorted keys, names instead of numbers, no outputs and no counts: a change shows as what was changed."""
    source = path.read_text(encoding="utf-8")
    notebook = json.loads(source)
    assert source == json.dumps(notebook, indent=1, ensure_ascii=False, sort_keys=True) + "\n"
    assert (notebook["nbformat"], notebook["nbformat_minor"]) == (4, 5)
    assert notebook["metadata"] == {
        "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
        "language_info": {"name": "python"},
    }
    names = [cell["id"] for cell in notebook["cells"]]
    assert len(set(names)) == len(names)
    for cell in notebook["cells"]:
        assert re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)*", cell["id"])
        assert cell["metadata"] == {}
        assert "".join(cell["source"]).splitlines(keepends=True) == cell["source"]
        assert not cell["source"][-1].endswith("\n")
        if cell["cell_type"] == "code":
            assert (cell["outputs"], cell["execution_count"]) == ([], None)
    assert not re.search(r"(?<![\w.])/(work|root|home|tmp)/", source)
    assert len(source) < 40_000


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_links_lead_somewhere(path) -> None:
    for target in re.findall(r"\]\(([^)]+)\)", path.read_text(encoding="utf-8")):
        assert (path.parent / target).is_file(), target
