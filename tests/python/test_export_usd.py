"""USD files, read again by Pixar's own library."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest

import nanite_rs as nrs
from test_export import PIXELS, source
from test_export_scene import scene

pxr = pytest.importorskip("pxr", reason="usd-core is not installed")
from pxr import Usd, UsdGeom, UsdShade, UsdValidation  # noqa: E402

ENDINGS = ("usda", "usdc", "usd", "usdz")

STAGES: list[Usd.Stage] = []
"""Prims do not keep theirs."""


def opened(path) -> Usd.Stage:
    stage = Usd.Stage.Open(str(path))
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    found = UsdValidation.ValidationContext(validators).Validate(stage)
    assert [f"{error.GetName()}: {error.GetMessage()}" for error in found] == []
    STAGES.append(stage)
    return stage


def meshes(stage: Usd.Stage) -> list[tuple[Any, np.ndarray]]:
    """All meshes as renderers see them, with their places."""
    cache = UsdGeom.XformCache()
    prims = stage.Traverse(Usd.TraverseInstanceProxies())
    return [
        (UsdGeom.Mesh(prim), np.array(cache.GetLocalToWorldTransform(prim)).T)
        for prim in prims
        if prim.IsA(UsdGeom.Mesh)
    ]


def written(item, path, **options) -> Usd.Stage:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        item.export(path, **options)
    return opened(path)


@pytest.mark.parametrize("ending", ENDINGS)
def test_surfaces_come_back(ending, tmp_path) -> None:
    cut = source().cut(error=0.0)
    found = meshes(written(cut, tmp_path / f"a.{ending}"))
    assert len(found) == 2
    assert sum(len(mesh.GetFaceVertexCountsAttr().Get()) for mesh, _ in found) == len(cut)
    numbers = cut.face_materials
    for k, (mesh, place) in enumerate(found):
        np.testing.assert_array_equal(place, np.eye(4))
        used, faces = np.unique(cut.faces[numbers == k], return_inverse=True)
        np.testing.assert_array_equal(mesh.GetPointsAttr().Get(), cut.vertices[used])
        np.testing.assert_array_equal(mesh.GetFaceVertexIndicesAttr().Get(), faces.reshape(-1))
        values = UsdGeom.PrimvarsAPI(mesh)
        np.testing.assert_array_equal(values.GetPrimvar("st").Get(), cut.uvs[0][used])
        np.testing.assert_array_equal(values.GetPrimvar("st1").Get(), cut.uvs[1][used])
        np.testing.assert_array_equal(values.GetPrimvar("heat").Get(), cut.channels["heat"][used])
        np.testing.assert_array_equal(values.GetPrimvar("part").Get(), cut.channels["part"][used])
        # The second look is flat.
        assert (mesh.GetNormalsAttr().Get() is None) == (k == 1)
        assert mesh.GetDoubleSidedAttr().Get() == (k == 1)
        if k == 0:
            np.testing.assert_array_equal(mesh.GetNormalsAttr().Get(), cut.normals[used])


def inputs(shader: Any) -> dict[str, Any]:
    return {i.GetBaseName(): i.Get() for i in shader.GetInputs()}


def test_looks_come_back(tmp_path) -> None:
    mesh = source(colors=None)
    found = meshes(written(mesh.cut(error=0.0), tmp_path / "a.usda"))
    first, second = mesh.materials
    shaders = []
    for own, _ in found:
        material, _ = UsdShade.MaterialBindingAPI(own.GetPrim()).ComputeBoundMaterial()
        shaders.append(material.ComputeSurfaceSource()[0])
    values = inputs(shaders[0])
    np.testing.assert_allclose(values["diffuseColor"], first.base_color[:3], rtol=1e-6)
    np.testing.assert_allclose(values["emissiveColor"], first.emissive, rtol=1e-6)
    assert values["metallic"] == first.metallic
    assert values["roughness"] == first.roughness
    assert inputs(shaders[1])["opacityThreshold"] == second.alpha_cutoff
    node, output, _ = shaders[0].GetInput("roughness").GetConnectedSource()
    texture = UsdShade.Shader(node.GetPrim())
    assert output == "g"
    assert inputs(texture)["sourceColorSpace"] == "raw"
    np.testing.assert_allclose(inputs(texture)["scale"], (1, first.roughness, first.metallic, 1), rtol=1e-6)
    image = nrs.Image.open(tmp_path / inputs(texture)["file"].path)
    np.testing.assert_array_equal(image.pixels, PIXELS)


def test_moved_textures_lie_where_they_lay(tmp_path) -> None:
    """Places on the image, of UVs: as UsdTransform2d is defined, and as we draw them."""
    mesh = source(colors=None)
    (own, _), _ = meshes(written(mesh.cut(error=0.0), tmp_path / "a.usda"))
    material, _ = UsdShade.MaterialBindingAPI(own.GetPrim()).ComputeBoundMaterial()
    node, _, _ = material.ComputeSurfaceSource()[0].GetInput("diffuseColor").GetConnectedSource()
    values = inputs(
        UsdShade.Shader(UsdShade.Shader(node.GetPrim()).GetInput("st").GetConnectedSource()[0].GetPrim())
    )
    angle = np.radians(values["rotation"])
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    uv = np.random.default_rng(3).uniform(-2, 2, (50, 2))
    theirs = (uv * np.array(values["scale"])) @ turn.T + np.array(values["translation"])
    rows = np.array(mesh.materials[0].base_color_texture._rows())
    ours = np.column_stack([uv, np.ones(50)]) @ rows.T
    np.testing.assert_allclose(theirs, ours * (1, -1) + (0, 1), atol=1e-6)


@pytest.mark.parametrize("ending", ["usdc", "usdz"])
def test_scenes_come_back(ending, tmp_path) -> None:
    ours = scene()
    stage = written(ours, tmp_path / f"a.{ending}")
    expected = []
    for node in ours.instances:
        if node.visible:
            rows = (
                node.mesh.vertices
                if isinstance(node.mesh, nrs.TriangleMesh)
                else node.mesh.cut(error=0.0).vertices
            )
            expected.append(rows @ node.pose[:3, :3].T + node.pose[:3, 3])
    theirs = np.concatenate(
        [
            np.array(mesh.GetPointsAttr().Get()) @ place[:3, :3].T + place[:3, 3]
            for mesh, place in meshes(stage)
        ]
    )
    joined = np.concatenate(expected)
    np.testing.assert_allclose(theirs.min(axis=0), joined.min(axis=0), atol=1e-5)
    np.testing.assert_allclose(theirs.max(axis=0), joined.max(axis=0), atol=1e-5)
    assert len(stage.GetPrototypes()) == 5
    instances = [prim for prim in stage.Traverse() if prim.IsInstance()]
    assert len(instances) == 7


def test_points_and_large_numbers(tmp_path) -> None:
    ours = nrs.Scene()
    places = np.random.default_rng(1).normal(size=(20, 3)) + 1e7
    ours.add(nrs.Points(places, colors=np.full((20, 3), 128, np.uint8)))
    ours.add(nrs.Lines(places))
    vertices, faces = nrs.shapes.icosphere(faces=80)
    ours.add(nrs.NaniteMesh.from_arrays(vertices.astype(np.float64) + 1e7, faces))
    stage = written(ours, tmp_path / "a.usdc")
    cache = UsdGeom.XformCache()
    for prim in stage.Traverse(Usd.TraverseInstanceProxies()):
        if prim.IsA(UsdGeom.PointBased):
            place = np.array(cache.GetLocalToWorldTransform(prim)).T
            rows = np.array(UsdGeom.PointBased(prim).GetPointsAttr().Get()) @ place[:3, :3].T + place[:3, 3]
            assert np.abs(rows - 1e7).max() < 10
            if prim.IsA(UsdGeom.Points):
                np.testing.assert_allclose(rows, places, atol=1e-6)


def test_without_the_library(tmp_path, monkeypatch) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "pxr", None)
    with pytest.raises(nrs.DependencyError, match=r"a\.usdz: usd-core is needed"):
        source().cut(target_faces=100).export(tmp_path / "a.usdz")
