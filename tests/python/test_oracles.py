"""The peers held against each other and against arithmetic, before anything is held against them."""

import numpy as np
import pytest
import trimesh

from oracles import camera, compare, data, distance, picture, rays, topology

DIRECTIONS = [(0.3, 0.2, 1.0), (-1.0, 0.4, 0.25)]


def _bumpy(subdivisions: int = 6) -> data.Mesh:
    """A displaced icosphere: closed, curved, with many small triangles per pixel in places."""
    ball = trimesh.creation.icosphere(subdivisions)
    v = ball.vertices
    r = 1 + 0.1 * np.sin(9 * v[:, 0]) * np.sin(7 * v[:, 1] + 1) * np.sin(8 * v[:, 2] + 2)
    return data.Mesh("bumpy", (v * r[:, None]).astype(np.float32), np.asarray(ball.faces, np.int64))


@pytest.mark.parametrize("name", ["bumpy", "armadillo", "lucy", "horse"])
def test_pyrender_and_embree_see_the_same(name: str, tmp_path) -> None:
    mesh = _bumpy() if name == "bumpy" else data.scan(name)
    normals = topology.vertex_normals(mesh.vertices, mesh.faces)
    shot = picture.Picture(mesh.vertices, mesh.faces, normals)
    for direction in DIRECTIONS:
        view = camera.framing(mesh.used, direction)
        _, depth = shot.render(view)
        assert depth.shape == (720, 1280)
        x, y = camera.pixel_centers(np.ones_like(depth, bool))
        eye = view.pose[:3, 3]
        face, along = rays.Rays(mesh.vertices, mesh.faces, culled_from=eye).first(eye, view.directions(x, y))
        hit = (face >= 0).reshape(depth.shape)
        mask = depth > 0
        compare.save_difference(tmp_path / f"{name}.png", mask, hit)
        assert compare.outside_by_more_than_a_pixel(mask, hit) == 0
        assert np.count_nonzero(mask ^ hit) <= 1e-4 * mask.sum() + 2
        inside = compare.away_from_silhouettes(depth, 1 / view.focal) & hit
        relative = np.abs(depth - along.reshape(depth.shape))[inside] / depth[inside]
        assert np.quantile(relative, 0.999) < 2e-4
        assert np.median(relative) < 1e-5


def test_libigl_agrees_with_closed_forms() -> None:
    ball = trimesh.creation.icosphere(5)
    d = distance.to_surface(np.array([[0, 0, 3.0], [0, 0, 0]]), ball.vertices, ball.faces)
    assert abs(d[0] - 2) < 1e-3
    assert abs(d[1] - 1) < 1e-3
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    points = np.array([[0.5, 0.5, 0.25], [2, 0.5, 0], [-3, -4, 0]])
    np.testing.assert_allclose(distance.to_surface(points, square, faces), [0.25, 1, 5], atol=1e-12)
    grid = distance.samples(square, faces, 1000)
    assert np.abs(distance.to_surface(grid, square, faces)).max() < 1e-12


def test_camera_projects_back_what_it_unprojects() -> None:
    view = camera.framing(np.random.default_rng(0).normal((5.0, -2, 1), size=(50, 3)), (1, 2, 3))
    rng = np.random.default_rng(1)
    x, y, depth = rng.uniform(0, 1280, 100), rng.uniform(0, 720, 100), rng.uniform(0.1, 9, 100)
    np.testing.assert_allclose(
        np.stack(view.project(view.unproject(x, y, depth))), np.stack([x, y, depth]), rtol=1e-9
    )


def test_topology_counts_known_solids() -> None:
    box = trimesh.creation.box()
    torus = trimesh.creation.torus(2, 0.5)
    for solid, euler in ((box, 2), (torus, 0)):
        faces = topology.by_position(solid.vertices, solid.faces)
        assert topology.is_closed(faces)
        assert topology.euler_characteristic(faces) == euler
        assert topology.components(faces) == 1
    faces = topology.by_position(box.vertices, box.faces)
    assert not topology.is_closed(faces[1:])
    assert len(topology.border_half_edges(faces[1:])) == 3
    flipped = faces.copy()
    flipped[0] = flipped[0, ::-1]
    assert topology.unbalanced_edges(flipped) == 3
    assert topology.signed_volume(box.vertices, box.faces) == pytest.approx(1)
    # A soup with its own numbering is the same surface; one triangle turned over is not.
    soup = box.vertices[box.faces].reshape(-1, 3)
    order = np.arange(len(soup)).reshape(-1, 3)[:, [1, 2, 0]][::-1]
    assert topology.surface_difference((box.vertices, box.faces), (soup, order)) == (0, 0)
    order = order.copy()
    order[0] = order[0, ::-1]
    assert topology.surface_difference((box.vertices, box.faces), (soup, order)) == (1, 1)


def test_masks_one_pixel_apart_pass_and_two_do_not() -> None:
    a = np.zeros((20, 20), bool)
    a[5:15, 5:15] = True
    assert compare.outside_by_more_than_a_pixel(a, np.roll(a, 1, 0)) == 0
    assert compare.outside_by_more_than_a_pixel(a, np.roll(a, 2, 0)) == 20


def test_supersampled_average_of_a_constant_is_the_constant() -> None:
    image = np.full((8, 8, 3), 137, np.uint8)
    np.testing.assert_allclose(compare.average_linear(image, 4), 137, rtol=1e-12)
    assert compare.psnr(image, image) == float("inf")
    assert compare.psnr(image, image + 1) == pytest.approx(48.13, abs=0.01)


def test_supersampled_reference_resembles_the_single_sample(tmp_path) -> None:
    mesh = _bumpy()
    key = camera.look_at(np.array([2.0, 3, 4]), np.zeros(3))
    shot = picture.Picture(
        mesh.vertices,
        mesh.faces,
        topology.vertex_normals(mesh.vertices, mesh.faces),
        lights=(picture.Light("directional", key, 3.0),),
    )
    view = camera.framing(mesh.used, DIRECTIONS[0])
    single, depth = shot.render(view)
    fine, _ = shot.render(view.with_size(5120, 2880))
    reference = compare.average_linear(fine, 4)
    compare.save_difference(tmp_path / "reference.png", single, reference)
    inside = compare.away_from_silhouettes(depth, 1 / view.focal)
    assert inside.mean() > 0.1
    assert compare.psnr(single, reference, inside) > 40
