"""How far pixels have moved, against points that are projected here; wireframes and edges over pictures."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import nanite_rs as nrs

SIZE = 120, 90
CAMERAS = {
    "pinhole": nrs.PerspectiveCamera(yfov=0.9, znear=0.1),
    "parallel": nrs.OrthographicCamera(2.4, 1.8, znear=0.1, zfar=50.0),
}
every_camera = pytest.mark.parametrize("camera", CAMERAS)


def pose_at(t):
    return nrs.look_at((np.sin(t), 0.4 + t, 4.0 - t), (0.1 * t, 0, 0))


def placed(t):
    out = nrs.look_at((0.3 * t, 0.2, 0.1), (0.3 * t + 1.0, t, 0.4))
    out[:3, :3] *= 1.0 + 0.2 * t
    return out


def project(camera, pose, points):
    """Pixels of points of the world."""
    width, height = SIZE
    matrix = CAMERAS[camera].projection_matrix(width, height)
    local = (points - pose[:3, 3]) @ pose[:3, :3]
    scale = np.array([matrix[0, 0] * width, -matrix[1, 1] * height]) / 2.0
    per_unit = scale / -local[:, 2:] if camera == "pinhole" else scale
    return local[:, :2] * per_unit + np.array([width, height]) / 2.0


def unproject(camera, pose, frame):
    """Points of the world that pixels show."""
    width, height = SIZE
    matrix = CAMERAS[camera].projection_matrix(width, height)
    scale = np.array([matrix[0, 0] * width, -matrix[1, 1] * height]) / 2.0
    rows, columns = np.nonzero(frame.depth > 0)
    depth = frame.depth[rows, columns].astype(np.float64)[:, None]
    away = (np.stack([columns, rows], axis=1) + 0.5 - np.array([width, height]) / 2.0) / scale
    local = np.concatenate([away * depth if camera == "pinhole" else away, -depth], axis=1)
    return local @ pose[:3, :3].T + pose[:3, 3]


@every_camera
@pytest.mark.parametrize("virtual", [False, True])
def test_cameras_and_instances_move(camera, virtual, backend):
    vertices, faces = nrs.shapes.torus_knot(faces=4_000)
    mesh = (
        nrs.NaniteMesh.from_arrays(vertices, faces, progress=False)
        if virtual
        else nrs.TriangleMesh(vertices, faces)
    )
    scene = nrs.Scene(ambient_light=(1, 1, 1))
    node = scene.add(mesh, pose=placed(0.0))
    with nrs.Renderer(*SIZE, backend=backend) as renderer:
        first = renderer.render(scene, CAMERAS[camera], pose_at(0.0), motion=True)
        assert not first.motion.any()
        still = renderer.render(scene, CAMERAS[camera], pose_at(0.0), motion=True)
        assert not still.motion.any()
        node.pose = placed(0.3)
        renderer.render(scene, CAMERAS[camera], pose_at(0.7))  # which takes no note
        frame = renderer.render(scene, CAMERAS[camera], pose_at(0.2), motion=True)
    points = unproject(camera, pose_at(0.2), frame)
    before = (points - placed(0.3)[:3, 3]) @ np.linalg.inv(placed(0.3)[:3, :3]).T
    before = before @ placed(0.0)[:3, :3].T + placed(0.0)[:3, 3]
    covered = frame.depth > 0
    now = np.argwhere(covered)[:, ::-1] + 0.5
    wanted = now - project(camera, pose_at(0.0), before)
    assert np.abs(wanted).max() > 3.0
    assert covered.sum() > 1200
    # As far as depths of float32 and snapped corners let points be known.
    off = np.abs(frame.motion[covered] - wanted).max(axis=1)
    assert np.quantile(off, 0.99) < 0.02
    assert off.max() < 0.2
    assert not frame.motion[~covered].any()


@every_camera
def test_vertices_move(camera, backend):
    rng = np.random.default_rng(0)
    vertices, faces = nrs.shapes.icosphere(faces=320)
    vertices = np.asarray(vertices, np.float64)
    body = nrs.TriangleMesh(vertices, faces)
    scene = nrs.Scene(ambient_light=(1, 1, 1))
    scene.add(body)
    moved = vertices + rng.normal(scale=0.05, size=vertices.shape)
    pose = pose_at(0.0)
    with nrs.Renderer(*SIZE, backend=backend) as renderer:
        renderer.render(scene, CAMERAS[camera], pose, motion=True)
        body.update(moved)
        frame = renderer.render(scene, CAMERAS[camera], pose, motion=True)
        again = renderer.render(scene, CAMERAS[camera], pose, motion=True)
    assert not again.motion.any()
    covered = frame.face_id >= 0
    points = unproject(camera, pose, frame)
    corners = moved[faces[frame.face_id[covered]]]
    # Barycentric coordinates in the triangle that is shown.
    a, b, c = np.moveaxis(corners, 1, 0)
    u, v, w = b - a, c - a, points - a
    uu, uv, vv = (u * u).sum(1), (u * v).sum(1), (v * v).sum(1)
    wu, wv = (w * u).sum(1), (w * v).sum(1)
    beta = (vv * wu - uv * wv) / (uu * vv - uv * uv)
    gamma = (uu * wv - uv * wu) / (uu * vv - uv * uv)
    share = np.stack([1.0 - beta - gamma, beta, gamma], axis=1)
    was = (share[..., None] * vertices[faces[frame.face_id[covered]]]).sum(axis=1)
    wanted = np.argwhere(covered)[:, ::-1] + 0.5 - project(camera, pose, was)
    off = np.abs(frame.motion[covered] - wanted).max(axis=1)
    assert np.abs(wanted).max() > 1.0
    assert np.quantile(off, 0.98) < 0.03
    assert off.max() < 0.5


def test_points_and_lines_move(backend):
    rng = np.random.default_rng(1)
    positions = rng.uniform(-1, 1, (200, 3))
    scene = nrs.Scene()
    cloud = nrs.Points(positions, radius=1.0)
    scene.add(cloud)
    pose = pose_at(0.0)
    with nrs.Renderer(*SIZE, backend=backend) as renderer:
        renderer.render(scene, CAMERAS["pinhole"], pose, motion=True)
        moved = positions + rng.normal(scale=0.1, size=positions.shape)
        cloud.update(moved)
        frame = renderer.render(scene, CAMERAS["pinhole"], pose, motion=True)
    covered = frame.face_id >= 0
    row = frame.face_id[covered]
    wanted = (project("pinhole", pose, moved) - project("pinhole", pose, positions))[row]
    np.testing.assert_allclose(frame.motion[covered], wanted, atol=2e-3)


def test_what_comes_and_goes(backend):
    scene = nrs.Scene(ambient_light=(1, 1, 1))
    ball = nrs.TriangleMesh(*nrs.shapes.icosphere(faces=320))
    left = scene.add(ball, pose=nrs.look_at((-1.2, 0, 0), (-1.2, 0, -1)))
    camera, pose = CAMERAS["parallel"], nrs.look_at((0, 0, 5), (0, 0, 0))
    with nrs.Renderer(*SIZE, backend=backend) as renderer:
        renderer.render(scene, camera, pose, motion=True)
        left.remove()
        other = scene.add(ball, pose=nrs.look_at((1.2, 0, 0), (1.2, 0, -1)))
        assert other.instance_id == 0  # in the same slot
        pose = nrs.look_at((0.1, 0, 5), (0.1, 0, 0))
        frame = renderer.render(scene, camera, pose, motion=True)
        shown = frame.depth > 0
        # As if it had stood there: the camera alone moved, by 0.1 of 4.8.
        np.testing.assert_allclose(
            frame.motion[shown], [[-0.1 / 4.8 * SIZE[0], 0.0]] * shown.sum(), atol=1e-3
        )
        elsewhere = nrs.Scene(ambient_light=(1, 1, 1))
        elsewhere.add(ball)
        assert not renderer.render(elsewhere, camera, pose, motion=True).motion.any()
        with pytest.raises(nrs.ArgumentError, match="motion: the frame was rendered without"):
            renderer.render(scene, camera, pose).motion  # noqa: B018
        copied = pickle.loads(pickle.dumps(frame))
        np.testing.assert_array_equal(copied.motion, frame.motion)


def test_views_have_motions_of_their_own():
    scene = nrs.Scene(ambient_light=(1, 1, 1))
    node = scene.add(nrs.TriangleMesh(*nrs.shapes.icosphere(faces=320)))
    camera = CAMERAS["pinhole"]
    poses = [pose_at(0.0), pose_at(0.5)]
    moved = [pose_at(0.1), pose_at(0.4)]
    with nrs.Renderer(*SIZE, backend="cpu") as renderer:
        for at in (poses, moved):
            views = renderer.render_views(scene, [(camera, pose) for pose in at], motion=True)
            node.pose = placed(0.1)
    node.pose = np.eye(4)
    for k in range(2):
        node.pose = np.eye(4)
        with nrs.Renderer(*SIZE, backend="cpu") as renderer:
            renderer.render(scene, camera, poses[k], motion=True)
            node.pose = placed(0.1)
            alone = renderer.render(scene, camera, moved[k], motion=True)
        np.testing.assert_array_equal(alone.motion, views[k].motion)


@every_camera
def test_edges_are_where_triangles_meet(camera, backend):
    vertices, faces = nrs.shapes.icosphere(faces=80)
    scene = nrs.Scene(ambient_light=(1, 1, 1))
    scene.add(nrs.TriangleMesh(vertices, faces))
    pose = nrs.look_at((0.4, 0.3, 3.0), (0, 0, 0))
    with nrs.Renderer(*SIZE, backend=backend) as renderer:
        frame = renderer.render(scene, CAMERAS[camera], pose)
        wire = frame.view("wireframe")
        plain, drawn = frame.view("triangles"), frame.view("triangles", edges=(0.0, 1.0, 0.0))
    corners = project(camera, pose, np.asarray(vertices, np.float64))[faces]
    covered = frame.face_id >= 0
    pixels = np.argwhere(covered)[:, ::-1] + 0.5
    own = corners[frame.face_id[covered]]
    away = np.full(len(pixels), np.inf)
    for k in range(3):
        a, b = own[:, k], own[:, (k + 1) % 3]
        d = b - a
        across = np.abs(d[:, 0] * (pixels - a)[:, 1] - d[:, 1] * (pixels - a)[:, 0]) / np.hypot(*d.T)
        away = np.minimum(away, across)
    # An edge fades over a pixel.
    share = np.clip(1.0 - away, 0.0, 1.0)[:, None]
    for picture, under, color in ((drawn, plain, (0, 255, 0)), (wire, None, (20, 24, 32))):
        found = picture[covered].astype(float)
        if under is not None:
            wanted = under[covered] + share * (np.array(color) - under[covered])
            assert np.quantile(np.abs(found - wanted), 0.99) < 12
        assert (np.abs(found - color)[away < 0.02] < 12).all()
        assert (found[away > 1.1].max(axis=1) > 60).all()
    assert (away < 0.5).sum() > 300
    assert (away > 1.1).sum() > 300
    assert (drawn[covered][away > 1.1] == plain[covered][away > 1.1]).all()
    assert not wire[~covered].any()
    np.testing.assert_array_equal(
        frame.view("shaded", edges=True)[covered][away > 1.6], frame.color[covered][away > 1.6]
    )
    with pytest.raises(nrs.ArgumentError, match="edges"):
        frame.view("shaded", edges=(2.0, 0.0, 0.0))


def test_points_have_no_edges():
    scene = nrs.Scene()
    scene.add(nrs.Points(np.random.default_rng(0).uniform(-1, 1, (50, 3)), colors=(1.0, 0, 0), radius=4.0))
    with nrs.Renderer(*SIZE, backend="cpu") as renderer:
        frame = renderer.render(scene, CAMERAS["pinhole"], pose_at(0.0))
    np.testing.assert_array_equal(frame.view("shaded", edges=True), frame.color)
