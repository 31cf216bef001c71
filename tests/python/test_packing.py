"""Smaller glTF: what comes back is what was written, up to the rounding that is stated."""

from __future__ import annotations

import json

import numpy as np
import pytest

import nanite_rs as nrs
from nanite_rs._export_packing import POSITION_STEPS, Grid
from nanite_rs._flatten import flattened
from nanite_rs.io import read_asset
from oracles import tiles
from test_export import source

KINDS = ["quantized", "meshopt", "meshopt-khr"]
EXTENSIONS = {"meshopt": "EXT_meshopt_compression", "meshopt-khr": "KHR_meshopt_compression"}


@pytest.mark.parametrize("ending", ["glb", "gltf"])
@pytest.mark.parametrize("kind", KINDS)
def test_what_comes_back(kind, ending, tmp_path) -> None:
    mesh = source()
    cut = mesh.cut(target_faces=600)
    cut.export(tmp_path / f"small.{ending}", compression=kind)
    own = flattened(read_asset(str(tmp_path / f"small.{ending}")))
    assert len(own.faces) == len(cut)
    moved = Grid.around(cut.vertices).moved
    # Vertices of the file, by the nearest of the cut: steps are far smaller than edges.
    far = np.linalg.norm(own.vertices[:, None].astype(np.float64) - cut.vertices[None], axis=2)
    assert far.min(axis=1).max() <= moved * 1.01
    near = dict(cut.channels.items())
    # Where several vertices have one position, that with the same channels.
    apart = np.abs(own.channels["_heat"][:, None] - near["heat"][None])
    at = (far + apart).argmin(axis=1)
    assert np.array_equal(own.channels["_part"], near["part"][at])
    assert np.abs(own.channels["_heat"] - near["heat"][at]).max() == 0.0
    # Flat faces have no normals.
    length = np.linalg.norm(own.normals, axis=1)
    cosines = (own.normals * cut.normals[at]).sum(axis=1)[length > 0.0] / length[length > 0.0]
    assert len(cosines) > 100
    assert np.degrees(np.arccos(np.clip(cosines, -1, 1))).max() < 1.5
    # Faces are those of the cut, turned the same way; vertices of seams are told apart by their normals alone.
    at = far.argmin(axis=1)
    first = np.linalg.norm(cut.vertices[:, None] - cut.vertices[None], axis=2).argmin(axis=1)
    corners = np.sort(first[cut.faces], axis=1)
    assert {tuple(row) for row in np.sort(at[own.faces], axis=1).tolist()} == {
        tuple(r) for r in corners.tolist()
    }
    a, b, c = (own.vertices[own.faces[:, k]] for k in range(3))
    volume = np.einsum("ij,ij->", a, np.cross(b, c))
    d, e, f = (cut.vertices[cut.faces[:, k]] for k in range(3))
    assert volume == pytest.approx(np.einsum("ij,ij->", d, np.cross(e, f)), rel=1e-3)
    assert len(own.materials) == 2


@pytest.mark.parametrize("kind", KINDS)
def test_uvs_and_colours(kind, tmp_path) -> None:
    vertices, faces = nrs.shapes.displaced_icosphere(faces=2_000)
    uv = np.clip(vertices[:, :2] / 3 + 0.5, 0, 1).astype(np.float32)
    colors = (np.clip(np.abs(vertices), 0, 1) * 255).astype(np.uint8)
    mesh = nrs.NaniteMesh.from_arrays(vertices, faces, uvs=[uv, uv * 3], colors=colors)
    cut = mesh.cut(error=0.0)
    cut.export(tmp_path / "a.glb", compression=kind)
    cut.export(tmp_path / "b.glb")
    packed, plain = (flattened(read_asset(str(tmp_path / f"{name}.glb"))) for name in "ab")
    at = np.linalg.norm(packed.vertices[:, None] - plain.vertices[None], axis=2).argmin(axis=1)
    # Between 0 and 1 they have 16 bits, beyond that all.
    assert 0.0 < np.abs(packed.uvs[0] - plain.uvs[0][at]).max() <= 0.5 / 65_535 * 1.01
    assert np.abs(packed.uvs[1] - plain.uvs[1][at]).max() == 0.0
    assert np.array_equal(packed.colors, plain.colors[at])
    length = np.linalg.norm(packed.normals, axis=1) * np.linalg.norm(plain.normals[at], axis=1)
    assert ((packed.normals * plain.normals[at]).sum(axis=1) / length).min() > np.cos(np.radians(1.5))


def test_it_is_smaller(tmp_path) -> None:
    mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.displaced_icosphere(faces=100_000))
    cut = mesh.cut(error=0.0)
    sizes = {}
    for kind in (None, *KINDS):
        cut.export(tmp_path / "a.glb", compression=kind)
        sizes[kind] = (tmp_path / "a.glb").stat().st_size
    assert sizes["quantized"] < 0.8 * sizes[None]
    assert sizes["meshopt"] < 0.35 * sizes[None]
    assert sizes["meshopt-khr"] <= sizes["meshopt"] * 1.01


@pytest.mark.parametrize("kind", KINDS)
def test_what_the_document_says(kind, tmp_path) -> None:
    source().export(tmp_path / "a.gltf", levels=[1.0, 0.2], compression=kind)
    document = json.loads((tmp_path / "a.gltf").read_text())
    required = {"KHR_mesh_quantization", *([EXTENSIONS[kind]] if kind in EXTENSIONS else [])}
    assert set(document["extensionsRequired"]) == required <= set(document["extensionsUsed"])
    # What compression moves is in the errors.
    (shown,) = (document["nodes"][k] for k in document["scenes"][0]["nodes"])
    nodes = [shown, *(document["nodes"][k] for k in shown["extensions"]["MSFT_lod"]["ids"])]
    cuts = [source().cut(error=0.0), source().cut(target_reduction=0.8)]
    for node, cut in zip(nodes, cuts, strict=True):
        assert node["extras"]["error"] > cut.error
        step = np.ptp(cut.vertices, axis=0).max() / (POSITION_STEPS - 2)
        assert node["extras"]["error"] <= cut.error + 1.8 * step


@pytest.mark.parametrize("kind", KINDS)
def test_scenes_and_points(kind, tmp_path) -> None:
    scene, mesh = nrs.Scene(), source()
    pose = np.eye(4)
    pose[:3, 3] = 1.0, 2.0, 3.0
    scene.add(mesh, pose=pose)
    scene.add(nrs.Points(np.arange(30.0).reshape(10, 3)))
    with pytest.warns(nrs.NaniteWarning if hasattr(nrs, "NaniteWarning") else UserWarning):
        scene.export(tmp_path / "a.glb", compression=kind)
    asset = read_asset(str(tmp_path / "a.glb"))
    found = flattened(asset).vertices
    assert np.abs(found.min(axis=0) - (mesh.bounds[0] + (1, 2, 3))).max() < 1e-3


def test_mistakes(tmp_path) -> None:
    cut = source().cut(target_faces=100)
    with pytest.raises(nrs.ArgumentError, match="compression: expected None, 'quantized', 'meshopt'"):
        cut.export(tmp_path / "a.glb", compression="draco")
    with pytest.raises(nrs.ArgumentError, match=r"compression: glTF has it; \.obj files have none"):
        cut.export(tmp_path / "a.obj", compression="meshopt")


def test_tiles_have_what_cuts_have(tmp_path) -> None:
    """One tile of all: the same file as that of the cut but for where its grid is."""
    mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=1_280))
    report = mesh.to_3dtiles(tmp_path / "t", compression="meshopt", up="y")
    (tile,) = tiles.every(tiles.opened(report.path))
    mesh.cut(error=0.0).export(tmp_path / "a.glb", compression="meshopt")
    assert tile.file.stat().st_size == pytest.approx((tmp_path / "a.glb").stat().st_size, rel=0.15)
