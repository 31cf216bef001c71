"""Poses of data sets, which are rotations to a few digits, and cameras as OpenCV has them."""

import warnings

import numpy as np
import pytest

import nanite_rs as nrs

CAMERA = nrs.PerspectiveCamera(yfov=0.9)
AXES = {
    "1e-3": np.array([[0.0, 1e-3, -7e-4], [4e-4, 0.0, 8e-4], [-3e-4, 0.0, 0.0]]),
    "scale": np.eye(3) * 5e-3,
    "shear": np.array([[0.0, 9e-3, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]),
}


@pytest.fixture(scope="module")
def scene() -> nrs.Scene:
    scene = nrs.Scene(ambient_light=(1, 1, 1))
    scene.add(nrs.NaniteMesh.from_arrays(*nrs.shapes.displaced_icosphere(faces=5_000)))
    return scene


def turned() -> np.ndarray:
    return nrs.look_at((1.5, 2.0, 2.5), (0, 0, 0))


@pytest.mark.parametrize("error", AXES.values(), ids=AXES)
def test_what_is_nearly_a_rotation_is_seen_as_the_nearest(scene, error) -> None:
    exact, given = turned(), turned()
    given[:3, :3] = exact[:3, :3] @ (np.eye(3) + error)
    u, _, vt = np.linalg.svd(given[:3, :3])
    nearest = given.copy()
    nearest[:3, :3] = u @ vt
    with nrs.Renderer(48, 48, backend="cpu") as renderer:
        with pytest.warns(nrs.UsageWarning, match="off a rotation by .*; the nearest rotation is taken"):
            depth = renderer.render(scene, CAMERA, given).depth
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # said once
            renderer.render(scene, CAMERA, given)
            expected = renderer.render(scene, CAMERA, nearest).depth
    both = (depth > 0) & (expected > 0)
    assert both.mean() > 0.1
    assert np.abs(depth - expected)[both].max() < 1e-4
    mesh = scene.instances[0].mesh
    with pytest.warns(nrs.UsageWarning, match="off a rotation"):
        cut = mesh.cut(camera=CAMERA, pose=given, viewport=(48, 48))
    assert len(cut.faces) == len(mesh.cut(camera=CAMERA, pose=nearest, viewport=(48, 48)).faces)


@pytest.mark.parametrize("change", [lambda q: np.round(q, 4), np.float32, lambda q: q * (1 + 1e-6)])
def test_digits_of_files_go_without_a_word(scene, change) -> None:
    pose = turned()
    pose[:3, :3] = change(pose[:3, :3])
    with nrs.Renderer(32, 32, backend="cpu") as renderer, warnings.catch_warnings():
        warnings.simplefilter("error")
        renderer.render(scene, CAMERA, pose)


@pytest.mark.parametrize(
    ("change", "advice"),
    [
        (np.diag([1.1, 1.1, 1.1]), r"columns are 1\.1, 1\.1, 1\.1 long: divide"),
        (np.diag([1.0, 2.0, 1.0]), r"long: divide"),
        (
            np.array([[1, 0.3, 0], [0, 1, 0], [0, 0, 1]]),
            r"not at right angles; the nearest rotation is u @ vt",
        ),
    ],
)
def test_what_is_no_rotation_is_refused_with_advice_that_fits(scene, change, advice) -> None:
    pose = turned()
    pose[:3, :3] = pose[:3, :3] @ change
    mesh = scene.instances[0].mesh
    with nrs.Renderer(32, 32, backend="cpu") as renderer:
        with pytest.raises(nrs.ArgumentError, match=f"pose: .*rotation.*{advice}"):
            renderer.render(scene, CAMERA, pose)
        with pytest.raises(nrs.ArgumentError, match=r"views\[1\]: pose"):
            renderer.render_views(scene, [(CAMERA, turned()), (CAMERA, pose)])
    with pytest.raises(nrs.ArgumentError, match=f"pose: .*{advice}"):
        mesh.cut(camera=CAMERA, pose=pose, viewport=(32, 32))


def test_last_rows_are_read_with_tolerance(scene) -> None:
    pose = turned()
    pose[3] = 1e-9, -1e-12, 0.0, 1.0 - 1e-8
    with nrs.Renderer(32, 32, backend="cpu") as renderer:
        assert (renderer.render(scene, CAMERA, pose).depth > 0).any()
        pose[3, 0] = 0.1
        with pytest.raises(nrs.ArgumentError, match="last row"):
            renderer.render(scene, CAMERA, pose)


# --------------------------------------------------------------------------------------------------- OpenCV


def dots(count: int, rng: np.random.Generator) -> np.ndarray:
    """Places in front of an OpenCV camera at the origin."""
    return np.column_stack([rng.uniform(-0.8, 0.8, (count, 2)), rng.uniform(2.5, 4.0, count)])


def ball(radius: float) -> nrs.NaniteMesh:
    vertices, faces = nrs.shapes.icosphere(faces=320)
    return nrs.NaniteMesh.from_arrays(radius * vertices, faces)


@pytest.mark.parametrize("backend", ["cpu", "gpu"])
@pytest.mark.parametrize("skew", [0.0, 60.0, -35.0])
def test_places_are_those_of_opencv(skew, backend) -> None:
    """What projects to (x, y) by K [R | t] is drawn there: the middle of the first pixel is (0, 0)."""
    rng = np.random.default_rng(3)
    k = np.array([[300.0, skew, 151.3], [0.0, 280.0, 117.8], [0.0, 0.0, 1.0]])
    vector = np.array([0.3, -0.5, 0.2])
    pose = nrs.pose_from_opencv(vector, [0.1, -0.2, 0.3])
    seen = dots(6, rng)
    camera = nrs.IntrinsicsCamera.from_opencv(k, 320, 240)
    flip = np.diag([1.0, -1.0, -1.0])
    small, ids = ball(0.02), {}
    scene = nrs.Scene(ambient_light=(1, 1, 1))
    for place in seen:
        at = np.eye(4)
        at[:3, 3] = pose[:3, :3] @ flip @ place + pose[:3, 3]
        ids[scene.add(small, pose=at).instance_id] = place
    with nrs.Renderer(320, 240, backend=backend) as renderer:
        frame = renderer.render(scene, camera, pose)
    shown = 0
    for number, place in ids.items():
        x, y, w = k @ place
        rows, columns = np.nonzero(frame.instance_id == number)
        if 5 < x / w < 315 and 5 < y / w < 235:
            shown += 1
            assert abs(columns.mean() - x / w) < 0.35
            assert abs(rows.mean() - y / w) < 0.35
    assert shown >= 3
    # The matrix says the same.
    point = np.append(pose[:3, :3] @ flip @ seen[0] + pose[:3, 3], 1.0)
    clip = camera.projection_matrix(320, 240) @ np.linalg.inv(pose) @ point
    ndc = clip[:2] / clip[3]
    x, y, w = k @ seen[0]
    assert np.allclose(ndc, [2 * (x / w + 0.5) / 320 - 1, 1 - 2 * (y / w + 0.5) / 240])


def test_opencv_poses_are_those_of_the_matrix_world_to_camera() -> None:
    rng = np.random.default_rng(1)
    pose = nrs.look_at(rng.normal(size=3), rng.normal(size=3))
    to_camera = np.diag([1, -1, -1, 1]) @ np.linalg.inv(pose)
    for t in (to_camera[:3, 3], to_camera[:3, 3:]):
        assert np.allclose(nrs.pose_from_opencv(to_camera[:3, :3], t), pose)


def test_skewed_light_comes_from_where_it_is(scene) -> None:
    """A skewed camera shades what it sees as a straight one does at the place where that sees it."""
    lit = nrs.Scene()
    lit.add(scene.instances[0].mesh, material=nrs.Material(metallic=0.5, roughness=0.3))
    lit.add(nrs.PointLight(intensity=20.0), pose=nrs.look_at((2, 2, 3), (0, 0, 0)))
    pose = nrs.look_at((0, 0, 4), (0, 0, 0))
    straight = nrs.IntrinsicsCamera(120.0, 120.0, 64.0, 64.0)
    skewed = nrs.IntrinsicsCamera(120.0, 120.0, 64.0, 64.0, skew=120.0)
    with nrs.Renderer(128, 128, backend="cpu") as renderer:
        plain = renderer.render(lit, straight, pose, pixel_error=0).linear
        moved = renderer.render(lit, skewed, pose, pixel_error=0).linear
    for row in (40, 64, 80):
        shift = row + 0.5 - 64.0  # pixels to the right, and half of one
        by = int(np.floor(shift))
        columns = np.arange(45, 84)
        half = (moved[row, columns + by] + moved[row, columns + by + 1]) / 2
        seen = np.abs(half - plain[row, columns]).mean()
        assert seen < 0.02 * plain[row, columns].mean() + 1e-3


@pytest.mark.parametrize(
    ("k", "message"),
    [
        (np.eye(4), r"K: expected shape \(3, 3\), found \(4, 4\)"),
        ([[1, 0, 0], [0, 1, 0], [5, 5, 1]], "transposed, give K.T"),
        (np.zeros((3, 3)), "K: expected"),
        ([[np.nan] * 3] * 3, "K: must be finite"),
        ([[-5.0, 0, 10], [0, 5, 10], [0, 0, 1]], "fx: must be positive"),
    ],
)
def test_bad_matrices_are_named(k, message) -> None:
    with pytest.raises(nrs.ArgumentError, match=message):
        nrs.IntrinsicsCamera.from_opencv(k, 20, 20)


def test_a_matrix_of_another_size_is_noticed() -> None:
    with pytest.warns(nrs.UsageWarning, match="outside of a picture of 320 × 240"):
        nrs.IntrinsicsCamera.from_opencv([[800, 0, 640], [0, 800, 360], [0, 0, 1]], 320, 240)
    for bad in ("x", np.eye(2), np.eye(3) * 2, [[1, 0], [2]]):
        with pytest.raises(nrs.NaniteError, match=r"^R: "):
            nrs.pose_from_opencv(bad, [0, 0, 0])
    with pytest.raises(nrs.ArgumentError, match=r"^t: "):
        nrs.pose_from_opencv(np.eye(3), [0, 0])
