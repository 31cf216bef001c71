"""Khronos' own validator finds no error in what is written."""

from __future__ import annotations

import json
import shutil
import subprocess
import warnings
from pathlib import Path

import numpy as np
import pytest

import nanite_rs as nrs
from oracles import data
from test_export import source
from test_export_scene import at, scene

NODE = shutil.which("node")
#: Where `make test` puts it.
VALIDATOR = (
    Path(__file__).resolve().parents[2] / "target" / "gltf-validator" / "node_modules" / "gltf-validator"
)
pytestmark = pytest.mark.skipif(
    NODE is None or not VALIDATOR.exists(),
    reason="gltf-validator is not there; tools/gltf-validator fetches it",
)

SCRIPT = """
const [, validator, ...files] = process.argv, fs = require("fs"), path = require("path");
const read = (file) => new Uint8Array(fs.readFileSync(file));
const beside = (file) => (uri) => Promise.resolve(read(path.join(path.dirname(file), decodeURIComponent(uri))));
const check = (file) => require(validator).validateBytes(
    read(file), {uri: path.basename(file), externalResourceFunction: beside(file), maxIssues: 0});
const issues = (reports) => JSON.stringify(reports.map((report) => report.issues));
Promise.all(files.map(check)).then((reports) => console.log(issues(reports)));
"""
FAST = nrs.BuildOptions(quality="fast", error="quadric")


def faults(*files: Path) -> list[str]:
    """Errors of files, by the validator's names."""
    assert NODE is not None
    run = subprocess.run(
        [NODE, "-e", SCRIPT, str(VALIDATOR), *map(str, files)], check=True, capture_output=True, text=True
    )
    reports = json.loads(run.stdout)
    assert len(reports) == len(files)
    found = [message for report in reports for message in report["messages"] if message["severity"] == 0]
    assert (found == []) == (sum(report["numErrors"] for report in reports) == 0)
    return [f"{one['code']} at {one['pointer']}: {one['message']}" for one in found]


def test_it_finds_errors(tmp_path) -> None:
    source().cut(target_faces=100).export(tmp_path / "a.gltf")
    document = json.loads((tmp_path / "a.gltf").read_text())
    document["accessors"][0]["max"][0] += 1.0
    (tmp_path / "a.gltf").write_text(json.dumps(document))
    assert any(fault.startswith("ACCESSOR_MAX_MISMATCH") for fault in faults(tmp_path / "a.gltf"))


@pytest.mark.parametrize("ending", ["glb", "gltf"])
def test_cuts_levels_and_scenes(ending, tmp_path) -> None:
    ours = scene()
    for light in (nrs.PointLight(range=3.0), nrs.DirectionalLight(), nrs.SpotLight(innerConeAngle=0.1)):
        ours.add(light, pose=at(1, 2, 3))
    line = np.arange(15.0).reshape(5, 3)
    ours.add(nrs.Points(line))
    ours.add(nrs.Lines(line + 1e6, colors=np.full((5, 4), 200, np.uint8)))
    files = [tmp_path / f"{name}.{ending}" for name in ("cut", "levels", "scene", "bare")]
    source().cut(error=0.0).export(files[0])
    source().export(files[1], levels=[1.0, 0.3, 0.05])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        ours.export(files[2], error=0.01)
    nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=80)).cut(error=0.0).export(files[3])
    assert faults(*files) == []


@pytest.mark.parametrize("path", [pytest.param(p, id=p.stem) for p in data.folder_models("gltf")])
def test_real_files(path, tmp_path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        mesh = nrs.NaniteMesh.from_file(path, options=FAST, progress=False)
        mesh.cut(target_reduction=0.9).export(tmp_path / "cut.glb")
        mesh.export(tmp_path / "levels.glb", levels=[0.5, 0.1])
    assert faults(tmp_path / "cut.glb", tmp_path / "levels.glb") == []


@pytest.mark.parametrize("compression", ["quantized", "meshopt", "meshopt-khr"])
def test_compressed(compression, tmp_path) -> None:
    """Of codecs it knows the JSON around them alone."""
    ours = scene()
    ours.add(nrs.Points(np.arange(15.0).reshape(5, 3)))
    files = [tmp_path / f"{name}.glb" for name in ("cut", "levels", "scene")]
    source().cut(error=0.0).export(files[0], compression=compression)
    source().export(files[1], levels=[1.0, 0.3, 0.05], compression=compression, images="webp")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        ours.export(files[2], error=0.01, compression=compression)
    assert faults(*files) == []


@pytest.mark.parametrize("ending", ["glb", "gltf"])
def test_images_as_ktx2(ending, tmp_path) -> None:
    """It does not look into the images, nor knows the extension that has them."""
    source().export(tmp_path / f"a.{ending}", levels=[1.0, 0.3], images="ktx2")
    assert faults(tmp_path / f"a.{ending}") == []


@pytest.mark.parametrize("compression", [None, "quantized", "meshopt"])
def test_tiles(compression, tmp_path) -> None:
    source().to_3dtiles(tmp_path / "t", triangles=300, compression=compression)
    assert faults(*sorted((tmp_path / "t").rglob("*.glb"))) == []
