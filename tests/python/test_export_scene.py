"""``scene.export``: what is written shows what the scene shows, and what cannot be written is named."""

from __future__ import annotations

import json
import warnings

import numpy as np
import pytest
import trimesh

import nanite_rs as nrs
from test_export import psnr, source

RNG = np.random.default_rng(11)
LENS = nrs.PerspectiveCamera(yfov=0.9)


def at(x: float, y: float = 0.0, z: float = 0.0, linear=None) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = np.eye(3) if linear is None else linear
    pose[:3, 3] = x, y, z
    return pose


def shot(scene: nrs.Scene) -> np.ndarray:
    """A picture under the same light, whatever lights the scene has."""
    scene = nrs.Scene.__copy__(scene)
    for node in scene.lights:
        node.remove()
    scene.ambient_light = (0.3, 0.3, 0.3)
    eye = at(0.5, 0.0, 7.0)
    scene.add(nrs.DirectionalLight(intensity=3.0), pose=eye)
    with nrs.Renderer(160, 96, backend="cpu") as renderer:
        return renderer.render(scene, LENS, eye, pixel_error=0, shading="gltf").color


TURN = trimesh.transformations.euler_matrix(0.3, -0.5, 0.2)[:3, :3]
SKEW = np.array([[1.0, 0.4, 0.0], [0.0, 0.8, 0.3], [0.1, 0.0, 1.1]])


def scene() -> nrs.Scene:
    """Instances that are scaled, mirrored, skewed and look otherwise; a mesh without levels."""
    mesh = source()
    out = nrs.Scene()
    out.add(mesh, pose=at(-2.5, 0.8))
    out.add(mesh, pose=at(0.0, 0.8, linear=TURN @ np.diag([0.5, 0.8, 0.6])))
    out.add(mesh, pose=at(2.5, 0.8, linear=TURN @ np.diag([-0.7, 0.7, 0.7])))
    out.add(mesh, pose=at(-1.5, -1.2, linear=0.6 * SKEW))
    out.add(mesh, pose=at(1.0, -1.2, linear=0.6 * np.diag([-1.0, 1.0, 1.0]) @ SKEW))
    out.add(
        mesh, pose=at(3.0, -1.2, linear=0.5 * np.eye(3)), material=nrs.Material(base_color=(0.9, 0.2, 0.1))
    )
    vertices, faces = nrs.shapes.icosphere(faces=320)
    flat = nrs.Material(base_color=(0.2, 0.9, 0.3), smooth=False, metallic=0.0)
    out.add(nrs.TriangleMesh(0.4 * vertices, faces, materials=flat), pose=at(0.5, 2.0))
    out.add(mesh, pose=at(0.0, 0.0, 6.0)).visible = False
    return out


@pytest.mark.parametrize("ending", ["glb", "gltf"])
def test_gltf_shows_what_the_scene_shows(ending, tmp_path) -> None:
    ours = scene()
    with pytest.warns(UserWarning, match="not everything is kept: what is hidden$"):
        ours.export(tmp_path / f"a.{ending}")
    back = nrs.load_scene(tmp_path / f"a.{ending}")
    # A part for each look.
    assert len(back.scene) == 12
    assert psnr(shot(ours), shot(back.scene)) > 40
    if ending == "gltf":
        document = json.loads((tmp_path / "a.gltf").read_text())
        # Skewed ones have meshes of their own; others share one for each look.
        assert len(document["meshes"]) == 5
        assert len(document["images"]) == 2
    theirs = trimesh.load(tmp_path / f"a.{ending}")
    assert len(theirs.graph.nodes_geometry) >= 7
    np.testing.assert_allclose(theirs.bounds, box(ours), atol=1e-4)


def box(ours: nrs.Scene) -> np.ndarray:
    """Around the vertices themselves."""
    points = []
    for node in ours.instances:
        if node.visible:
            mesh = node.mesh
            rows = mesh.vertices if isinstance(mesh, nrs.TriangleMesh) else mesh.cut(error=0.0).vertices
            points.append(rows @ node.pose[:3, :3].T + node.pose[:3, 3])
    joined = np.concatenate(points)
    return np.stack([joined.min(axis=0), joined.max(axis=0)])


@pytest.mark.parametrize("ending", ["obj", "ply", "stl", "off"])
def test_other_formats_hold_one_surface(ending, tmp_path) -> None:
    ours = scene()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        ours.export(tmp_path / f"a.{ending}")
        theirs = trimesh.load(tmp_path / f"a.{ending}", force="mesh", process=False)
    assert len(theirs.faces) == sum(len(n.mesh) for n in ours.instances if n.visible)
    np.testing.assert_allclose(theirs.bounds, box(ours), atol=1e-4)
    # Mirrored ones are not inside out.
    parts = [n.mesh for n in ours.instances if n.visible]
    assert len(parts) == 7
    assert theirs.volume > 0.0


def test_obj_shows_what_the_scene_shows(tmp_path) -> None:
    """Of looks that OBJ can hold."""
    ours = nrs.Scene()
    vertices, faces = nrs.shapes.displaced_icosphere(faces=2_000)
    for k, color in enumerate([(1, 0, 0), (0, 1, 0), (0, 0, 1)]):
        look = nrs.Material(base_color=color, metallic=0.0, roughness=0.7)
        mesh = nrs.NaniteMesh.from_arrays(vertices, faces, materials=look)
        ours.add(mesh, pose=at(2.2 * k - 2.0, linear=TURN * (0.5 + 0.25 * k)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        ours.export(tmp_path / "a.obj")
    assert psnr(shot(ours), shot(nrs.load_scene(tmp_path / "a.obj").scene)) > 40


def test_an_error_is_one_in_the_world(tmp_path) -> None:
    mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.displaced_icosphere(faces=20_000))
    ours = nrs.Scene()
    ours.add(mesh)
    ours.add(mesh, pose=at(50.0, linear=10.0 * np.eye(3)))
    ours.export(tmp_path / "a.glb", error=0.05)
    small, large = (len(n.mesh) for n in nrs.load_scene(tmp_path / "a.glb").scene.instances)
    assert (small, large) == (len(mesh.cut(error=0.05)), len(mesh.cut(error=0.005)))
    ours.export(tmp_path / "b.glb", target_reduction=0.9)
    counts = [len(n.mesh) for n in nrs.load_scene(tmp_path / "b.glb").scene.instances]
    assert counts[0] == counts[1] == len(mesh.cut(target_reduction=0.9))


def test_lights_points_and_lines(tmp_path) -> None:
    ours = nrs.Scene(ambient_light=(0.1, 0.1, 0.1))
    places = RNG.normal(size=(50, 3))
    ours.add(nrs.Points(places, colors=RNG.integers(0, 255, (50, 3)).astype(np.uint8)), pose=at(1, 2, 3))
    ours.add(nrs.Lines(places + 1e6, colors=(0.5, 0.25, 1.0)))
    lamps = [
        nrs.DirectionalLight((1.0, 0.5, 0.25), 3.0, angle=0.01),
        nrs.PointLight((1.0, 1.0, 1.0), 20.0, 5.0),
        nrs.SpotLight((0.0, 1.0, 1.0), 7.0, innerConeAngle=0.2, outerConeAngle=0.4),
    ]
    for k, lamp in enumerate(lamps):
        ours.add(lamp, pose=at(k, k, k, linear=TURN))
    ours.add(nrs.PointLight()).visible = False
    with pytest.warns(UserWarning, match="ambient light; sizes of lights; sizes of points and lines$"):
        ours.export(tmp_path / "a.glb")
    back = nrs.load_scene(tmp_path / "a.glb").scene
    for node, lamp, k in zip(back.lights, lamps, range(3), strict=True):
        expected = nrs.DirectionalLight((1.0, 0.5, 0.25), 3.0) if k == 0 else lamp
        assert node.light == expected
        np.testing.assert_allclose(node.pose, at(k, k, k, linear=TURN), atol=1e-9)
    points, lines = (node.mesh for node in back.instances)
    poses = [node.pose for node in back.instances]
    for strokes, pose, where in (
        (points, poses[0], places + np.array([1, 2, 3])),
        (lines, poses[1], places + 1e6),
    ):
        found = strokes.positions @ pose[:3, :3].T + pose[:3, 3]
        np.testing.assert_allclose(found, where, atol=1e-5)
    np.testing.assert_array_equal(lines.segments, ours.instances[1].mesh.segments)


def test_what_cannot_be_written(tmp_path) -> None:
    ours = nrs.Scene()
    with pytest.raises(nrs.ArgumentError, match="the scene shows no mesh"):
        ours.export(tmp_path / "a.glb")
    ours.add(nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=80))).visible = False
    with pytest.raises(nrs.ArgumentError, match="the scene shows no mesh"):
        ours.export(tmp_path / "a.glb")
    ours.instances[0].visible = True
    with pytest.raises(nrs.ArgumentError, match="error or target_reduction"):
        ours.export(tmp_path / "a.glb", error=0.1, target_reduction=0.5)
    with pytest.raises(nrs.FormatError, match="cannot write that"):
        ours.export(tmp_path / "a.max")
    assert not list(tmp_path.iterdir())
    ours.environment = nrs.Environment(np.ones((4, 8, 3), np.float32))
    ours.add(nrs.PointLight())
    with pytest.warns(UserWarning, match="lights; the environment"):
        ours.export(tmp_path / "a.stl")
