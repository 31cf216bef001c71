"""Meshes that move on a device: the pictures are the CPU's, and no more is uploaded than where vertices are."""

from __future__ import annotations

import copy

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import nanite_rs as nrs
from oracles import camera, compare

LENS = nrs.PerspectiveCamera(yfov=0.9)
SIZE = (160, 120)


@pytest.fixture
def renderers():
    try:
        device = nrs.Renderer(*SIZE, backend="gpu")
    except nrs.BackendError as error:
        pytest.skip(str(error))
    with device, nrs.Renderer(*SIZE, backend="cpu") as host:
        yield device, host


def sphere(step: float, faces: int = 3_000) -> tuple[np.ndarray, np.ndarray]:
    points, triangles = nrs.shapes.icosphere(faces=faces)
    points = np.asarray(points, np.float64)
    return points * (
        1.0 + 0.3 * np.sin(3.0 * points[:, :1] + step) * np.cos(2.0 * points[:, 1:2] - step)
    ), triangles


def stage(*shapes) -> nrs.Scene:
    scene = nrs.Scene(ambient_light=(0.3, 0.3, 0.3))
    for k, shape in enumerate(shapes):
        scene.add(shape, pose=camera.at(1.4 * k - 1.0, 0.2 * k, -0.7 * k))
    scene.add(nrs.DirectionalLight(intensity=2.0), pose=camera.look_at((2, 3, 3), (0, 0, 0)))
    return scene


def alike(renderers, scene: nrs.Scene, **options) -> nrs.Frame:
    """The frame of the device, which shows what the CPU's does."""
    device, host = (r.render(scene, LENS, camera.at(0, 0.3, 5), **options) for r in renderers)
    for name in ("depth", "instance_id", "triangle_id"):
        assert (getattr(device, name) == getattr(host, name)).all(), name
    assert (device.depth > 0).sum() > 1_000
    assert compare.psnr(device.color, host.color) > 45
    return device


def arm(faces: int = 6_000) -> nrs.SkinnedMesh:
    points, triangles = nrs.shapes.displaced_icosphere(faces=faces)
    upper = np.clip(0.5 + points[:, 1], 0.0, 1.0)
    weights = np.stack([1.0 - upper, 0.5 * upper, 0.5 * upper], axis=1).astype(np.float32)
    return nrs.SkinnedMesh(nrs.NaniteMesh.from_arrays(points, triangles, channels={"weights": weights}))


def bent(by: float) -> np.ndarray:
    matrices = np.tile(np.eye(4), (3, 1, 1))
    matrices[1, :3, :3] = Rotation.from_rotvec([0.0, 0.3, by]).as_matrix()
    matrices[2, :3, :3] = Rotation.from_rotvec([by, 0.0, 0.2]).as_matrix() * (1.0 + 0.2 * by)
    matrices[2, :3, 3] = 0.2 * by, 0.1, 0.0
    return matrices


@pytest.mark.parametrize("shadows", [False, True])
def test_new_vertices(renderers, shadows: bool) -> None:
    points, triangles = sphere(0.0)
    body = nrs.TriangleMesh(points, triangles)
    still = nrs.NaniteMesh.from_arrays(*nrs.shapes.displaced_icosphere(faces=20_000))
    scene = stage(body, still)
    whole = alike(renderers, scene, shadows=shadows).stats.uploaded_mesh_bytes
    assert whole > 500_000
    for step in range(1, 6):
        body.update(sphere(float(step))[0])
        moved = alike(renderers, scene, shadows=shadows).stats.uploaded_mesh_bytes
        # A position and a normal for each vertex of each cluster, of which a few lie in several.
        assert 16 * len(points) <= moved < 40 * len(points)
        assert alike(renderers, scene, shadows=shadows).stats.uploaded_mesh_bytes == 0


@pytest.mark.parametrize("shadows", [False, True])
def test_new_poses(renderers, shadows: bool) -> None:
    body, other = arm(), arm(2_000)
    scene = stage(body, other)
    first = alike(renderers, scene, shadows=shadows)
    for step in range(1, 6):
        body.pose(bent(0.25 * step))
        frame = alike(renderers, scene, shadows=shadows)
        assert 0 < frame.stats.uploaded_mesh_bytes < 0.7 * first.stats.uploaded_mesh_bytes
    for error in (0.0, 4.0):
        alike(renderers, scene, shadows=shadows, pixel_error=error)


def test_shapes_that_are_seen_together_have_places_of_their_own(renderers) -> None:
    points, triangles = sphere(0.0)
    body = nrs.TriangleMesh(points, triangles)
    other = copy.copy(body)
    walker = arm()
    runner = nrs.SkinnedMesh(walker.rest)
    scene = stage(body, other, walker, runner)
    for step in range(1, 5):
        body.update(sphere(float(step))[0])
        if step % 2:
            other.update(sphere(-float(step))[0])
            runner.pose(bent(-0.2 * step))
        walker.pose(bent(0.2 * step))
        alike(renderers, scene)


def test_scenes_by_turns(renderers) -> None:
    points, triangles = sphere(0.0)
    body, walker = nrs.TriangleMesh(points, triangles), arm()
    scenes = stage(body, walker), stage(walker, nrs.TriangleMesh(*sphere(0.3)), body)
    kept = []
    for step in range(4):
        for scene in scenes:
            body.update(sphere(float(step))[0])
            walker.pose(bent(0.3 * step))
            frame = alike(renderers, scene)
            kept.append((frame, renderers[1].render(scene, LENS, camera.at(0, 0.3, 5)).normal))
    # A frame keeps what it showed, also where an array is made of it later.
    for frame, expected in kept:
        assert np.abs(frame.normal - expected)[frame.depth > 0].max() < 0.01


def test_many_meshes_that_move_upload_what_moved_alone(renderers) -> None:
    """Room for meshes that are gone is used again: nothing that stands still comes again."""
    device, _ = renderers
    still = nrs.NaniteMesh.from_arrays(*nrs.shapes.displaced_icosphere(faces=20_000))
    bodies = [nrs.TriangleMesh(*sphere(0.1 * k, 500)) for k in range(8)]
    scene = stage(still, *bodies)
    device.render(scene, LENS, camera.at(0, 0, 9))
    for step in range(30):
        for k, body in enumerate(bodies):
            body.update(sphere(step + 0.1 * k, 500)[0])
        moved = device.render(scene, LENS, camera.at(0, 0, 9)).stats.uploaded_mesh_bytes
        assert moved < 8 * 40 * 500
    alike(renderers, scene)


def mixed() -> nrs.Scene:
    """Levels of detail, glass before and behind, points, lines, and two bodies that meet."""
    rng = np.random.default_rng(3)
    scene = stage(
        nrs.TriangleMesh(*sphere(0.0)), nrs.NaniteMesh.from_arrays(*nrs.shapes.torus_knot(faces=20_000))
    )
    glass = nrs.Material(base_color=(0.3, 0.6, 0.9, 0.4), alpha_mode="blend", double_sided=True)
    ball = nrs.TriangleMesh(*sphere(1.0))
    for k in range(3):
        scene.add(ball, pose=camera.at(0.5 * k - 0.5, 0.1, 1.0 - 0.9 * k), material=glass)
    cloud = rng.normal(size=(2_000, 3)) * 0.8
    scene.add(nrs.Points(cloud, colors=rng.random((2_000, 3)).astype(np.float32), radius=1.5))
    scene.add(nrs.Lines(cloud[:200], np.arange(200).reshape(-1, 2), width=2.0))
    # On the same place as another one: what comes first in the scene wins.
    scene.add(nrs.TriangleMesh(*sphere(0.0)), pose=camera.at(-1.0, 0.0, 0.0))
    scene.add(nrs.Points(sphere(0.0)[0], radius=0.05, unit="world"), pose=camera.at(1.5, -0.8, 0.0))
    return scene


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"shadows": True},
        {"occlusion": False},
        {"transparent_ids": True},
        {"samples": 4},
        {"max_layers": 1},
    ],
    ids=lambda options: "-".join(options) or "plain",
)
def test_what_the_host_adds(renderers, options: dict) -> None:
    """Points, lines and glass are drawn over what the device drew, as if one of both had drawn all."""
    scene = mixed()
    frame = alike(renderers, scene, **options)
    assert 0 < frame.stats.layers <= options.get("max_layers", 8)
    assert frame.stats.uploaded_mesh_bytes > 0
    host = renderers[1].render(scene, LENS, camera.at(0, 0.3, 5), **options)
    for name in ("covered_pixels", "layers", "layers_left"):
        assert getattr(frame.stats, name) == getattr(host.stats, name), name
    again = alike(renderers, scene, **options)
    assert again.stats.uploaded_mesh_bytes == 0
    assert (again.color == frame.color).all()


def test_what_the_host_adds_to_depth_alone(renderers) -> None:
    scene = mixed()
    views = [
        nrs.View(LENS, camera.at(0, 0.3, 5), id=k, depth_only=True, outputs=outputs)
        for k, outputs in enumerate(([], ["depth"]))
    ]
    frames = [renderer.render_views(scene, views) for renderer in renderers]
    for device, host in zip(*frames, strict=True):
        assert (device.depth == host.depth).all()
        assert (device.depth > 0).sum() > 1_000


def test_what_is_hidden_from_the_device_comes_back(renderers) -> None:
    scene = mixed()
    nodes = list(scene.instances)
    alike(renderers, scene)
    for node in nodes:
        node.visible = False
        frames = [r.render(scene, LENS, camera.at(0, 0.3, 5)) for r in renderers]
        assert (frames[0].depth == frames[1].depth).all()
    for node in reversed(nodes):
        node.visible = True
        frames = [r.render(scene, LENS, camera.at(0, 0.3, 5)) for r in renderers]
        assert (frames[0].depth == frames[1].depth).all()
        assert (frames[0].instance_id == frames[1].instance_id).all()
