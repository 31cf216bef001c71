"""The view of what each rasterizer drew."""

import numpy as np
import pytest

import nanite_rs as nrs

SIZE = (320, 180)


def at(x: float, y: float, z: float) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    return pose


def shares(frame: nrs.Frame, node: nrs.MeshNode) -> np.ndarray:
    """Shares of orange and of blue in what is seen of an instance."""
    seen = frame.view("rasterizers")[frame.instance_id == node.instance_id].astype(int)
    assert len(seen) > 3_000
    assert (seen.max(axis=1) > 0).all()
    return np.array([(seen[:, 0] > seen[:, 2]).mean(), (seen[:, 2] > seen[:, 0]).mean()])


@pytest.fixture(scope="module")
def made():
    """A fine sphere on the left, a square of two triangles on the right."""
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32)
    square = nrs.NaniteMesh.from_arrays(corners, np.array([[0, 1, 2], [0, 2, 3]]))
    sphere = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=50_000))
    scene = nrs.Scene()
    return scene, scene.add(sphere, pose=at(-1.2, 0, 0)), scene.add(square, pose=at(1.2, 0, 0))


def test_fine_clusters_are_blue_and_large_triangles_orange(made) -> None:
    scene, sphere, square = made
    with nrs.Renderer(*SIZE, backend="cpu") as renderer:
        frame = renderer.render(
            scene, nrs.PerspectiveCamera(yfov=0.8, znear=0.1), at(0, 0, 4), pixel_error=0.2
        )
    assert frame.stats.drawn_small > 1_000
    orange, blue = shares(frame, sphere)
    assert orange + blue == 1.0
    assert blue > 0.95
    np.testing.assert_array_equal(shares(frame, square), [1.0, 0.0])
    picture = frame.view("rasterizers")
    assert (picture[frame.depth == 0.0] == 0).all()


def test_no_cluster_is_drawn_by_both(made) -> None:
    scene, *_ = made
    with nrs.Renderer(*SIZE, backend="cpu") as renderer:
        frame = renderer.render(scene, nrs.PerspectiveCamera(yfov=0.8, znear=0.1), at(0, 0, 4))
    seen = frame.depth > 0.0
    orange = frame.view("rasterizers")[seen].astype(int) @ [1, 0, -1] > 0
    clusters = np.stack(
        [frame.instance_id[seen].astype(np.int64), frame.cluster_id[seen].astype(np.int64)], axis=1
    )
    _, number = np.unique(clusters, axis=0, return_inverse=True)
    number = number.ravel()
    shares = np.bincount(number, orange) / np.bincount(number)
    assert set(shares) == {0.0, 1.0}
