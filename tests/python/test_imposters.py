"""Imposters: what the views show, against rays, areas and renders, and what is mixed, kept and refused."""

from __future__ import annotations

import concurrent.futures
import copy
import json
import multiprocessing
import pickle
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

import nanite_rs as nrs
from nanite_rs import _colors, cli
from nanite_rs._imposters import octahedron, texels
from oracles.rays import Rays

LAYERS = ("base_color", "normal", "depth", "orm")
RED = nrs.Material(base_color=(0.6, 0.1, 0.2), roughness=0.25, metallic=0.75)
vectors = st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda v: np.linalg.norm(v) > 1e-3)


def same(one: nrs.Imposter, other: nrs.Imposter) -> bool:
    return all(np.array_equal(one.layer(name), other.layer(name)) for name in LAYERS)


def alpha(imposter: nrs.Imposter) -> np.ndarray:
    return imposter.layer("base_color")[..., 3] / 255.0


def areas(imposter: nrs.Imposter) -> np.ndarray:
    """What views cover, in units of the mesh."""
    return alpha(imposter).sum(axis=(2, 3)) * (2.0 * imposter.radius / imposter.size) ** 2


def samples_of(imposter: nrs.Imposter, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Origins and directions of rays through the sixteen samples of each texel, row by row."""
    pose = imposter.pose(direction)
    side = imposter.size * 4
    at = (2.0 * (np.arange(side) + 0.5) / side - 1.0) * imposter.radius
    x, y = np.meshgrid(at, -at)
    origins = pose[:3, 3] + x[..., None] * pose[:3, 0] + y[..., None] * pose[:3, 1]
    return origins.reshape(-1, 3), np.broadcast_to(-pose[:3, 2], (side * side, 3))


def blocks(samples: np.ndarray, size: int) -> np.ndarray:
    """(size, size, 16) of samples row by row."""
    return samples.reshape(size, 4, size, 4).swapaxes(1, 2).reshape(size, size, 16)


def node_of(mesh: object, **more: object) -> nrs.Scene:
    scene = nrs.Scene()
    scene.add(mesh, **more)
    return scene


@pytest.fixture(scope="module")
def bumpy() -> tuple[np.ndarray, np.ndarray]:
    vertices, faces = nrs.shapes.displaced_icosphere(faces=8_000)
    return (vertices * [1.0, 0.6, 0.8] + [3.0, -1.0, 0.5]).astype(np.float32), faces


@pytest.fixture(scope="module")
def baked(bumpy) -> nrs.Imposter:
    mesh = nrs.NaniteMesh.from_arrays(*bumpy, materials=replace(RED, smooth=False))
    return nrs.bake_imposter(mesh, views=6, size=32)


# ------------------------------------------------------------------------------------------ the map


@given(vectors)
def test_directions_come_back(vector) -> None:
    direction = np.array([vector]) / np.linalg.norm(vector)
    for full in (True, False):
        place = octahedron.encode(direction, full=full)
        assert np.abs(place).max() <= 1.0 + 1e-12
        want = direction.copy()
        if not full:
            want[:, 2] = np.maximum(want[:, 2], 0.0)
            if np.linalg.norm(want) < 1e-6:
                continue
            want /= np.linalg.norm(want)
        assert np.allclose(octahedron.decode(place, full=full), want, atol=1e-9)
        # Nearest places of the octahedron, |x| + |y| + |z| = 1, are on the ray.
        at = octahedron.decode(place, full=full)
        assert np.allclose(octahedron.encode(at * 7.0, full=full), place, atol=1e-9) or full


@given(vectors, st.integers(3, 17), st.booleans())
def test_three_views_are_around_a_direction(vector, views, full) -> None:
    direction = np.array(vector) / np.linalg.norm(vector)
    found = octahedron.nearest(direction, views, full=full)
    weights = np.array([weight for _, _, weight in found])
    assert weights.min() >= -1e-12
    assert np.isclose(weights.sum(), 1.0)
    places = np.array([(column, row) for row, column, _ in found]) / (views - 1) * 2 - 1
    assert np.allclose(weights @ places, octahedron.encode(direction[None], full=full)[0], atol=1e-9)
    assert {max(row, column) < views for row, column, _ in found} == {True}


@pytest.mark.parametrize("full", [True, False])
@pytest.mark.parametrize("up", ["y", "z"])
def test_directions_of_the_grid(full, up) -> None:
    ball = nrs.TriangleMesh(*nrs.shapes.icosphere(faces=80))
    imposter = nrs.bake_imposter(ball, views=5, size=4, full_sphere=full, up=up)
    directions = imposter.directions
    above = {"y": 1, "z": 2}[up]
    assert np.allclose(np.linalg.norm(directions, axis=-1), 1.0)
    assert np.allclose(directions[2, 2], np.eye(3)[above])
    lowest = directions[..., above].min()
    assert np.isclose(lowest, -1.0 if full else 0.0)
    if full:  # spread over the sphere: the mean is its middle, and the corners are one direction
        assert np.allclose(directions[0, 0], directions[-1, -1])
    border = directions[[0, -1]].reshape(-1, 3)
    assert full or np.allclose(border[:, above], 0.0)
    for row, column in np.ndindex(5, 5):
        near = octahedron.nearest(octahedron.AXES[up] @ directions[row, column], 5, full=full)
        at = max(near, key=lambda view: view[2])
        assert np.isclose(at[2], 1.0)
        assert np.allclose(directions[at[0], at[1]], directions[row, column])


# -------------------------------------------------------------------------------------------- views


@pytest.mark.parametrize("place", [(0, 0), (2, 3), (5, 2), (1, 1)])
def test_a_view_is_an_orthographic_picture(bumpy, baked, place) -> None:
    mesh = nrs.NaniteMesh.from_arrays(*bumpy, materials=replace(RED, smooth=False))
    direction = baked.directions[place]
    with nrs.Renderer(128, 128, backend="cpu") as renderer:
        frame = renderer.render(
            node_of(mesh), baked.camera, baked.pose(direction), pixel_error=0.0, shading="gltf"
        )
    covered = blocks((frame.depth > 0).ravel(), 32)
    # Scaled to the unit sphere, a sample at an edge may fall on its other side.
    assert np.abs(alpha(baked)[place] - covered.mean(axis=-1)).max() <= 1 / 16 + 1 / 255
    whole = covered.all(axis=-1) & (baked.layer("base_color")[place][..., 3] == 255)
    assert whole.sum() > 200
    depth = blocks(frame.depth.ravel().astype(np.float64), 32).mean(axis=-1) / baked.radius - 1.0
    error = np.abs(baked.layer("depth")[place] * (2 / 65_535) - depth)[whole]
    assert np.quantile(error, 0.98) <= 1 / 65_535 + 1e-5
    normal = frame.shading_normal.reshape(32, 4, 32, 4, 3).mean(axis=(1, 3))
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
    error = np.abs(baked.layer("normal")[place] / 127.5 - 1.0 - normal)[whole]
    assert np.quantile(error, 0.98) <= 0.5 / 127.5 + 1e-4
    color = np.rint(255 * _colors.to_srgb(np.array(RED.base_color[:3])))
    assert np.array_equal(baked.layer("base_color")[place][..., :3], np.broadcast_to(color, (32, 32, 3)))
    orm = baked.layer("orm")[place][whole] / 255.0
    assert np.allclose(orm, (1.0, 0.25, 0.75), atol=0.5 / 255)


@pytest.fixture(scope="module")
def rough() -> tuple[tuple[np.ndarray, np.ndarray], nrs.Imposter]:
    """Faces of several texels."""
    mesh = nrs.shapes.displaced_icosphere(faces=500)
    solid = nrs.TriangleMesh(*mesh, materials=replace(RED, smooth=False))
    return mesh, nrs.bake_imposter(solid, views=6, size=64)


@pytest.mark.parametrize("place", [(0, 2), (3, 3), (4, 1)])
def test_depths_and_normals_are_those_that_rays_find(rough, place) -> None:
    (vertices, faces), baked = rough
    direction = baked.directions[place]
    hit, distance = Rays(vertices, faces).first(*samples_of(baked, direction))
    covered = blocks(hit >= 0, 64)
    assert np.abs(alpha(baked)[place] - covered.mean(axis=-1)).max() <= 1 / 16 + 1 / 255
    inner = covered.all(axis=-1)
    want = blocks(distance, 64).mean(axis=-1) / baked.radius - 1.0
    error = np.abs(baked.layer("depth")[place] * (2 / 65_535) - want)[inner]
    assert np.quantile(error, 0.95) < 1e-4
    # Where all samples of a texel hit one face, its normal.
    numbers = blocks(hit, 64)
    one = inner & (numbers == numbers[..., :1]).all(axis=-1)
    assert one.sum() > 200
    found = baked.layer("normal")[place][one] / 127.5 - 1.0
    assert np.abs(np.linalg.norm(found, axis=-1) - 1.0).max() < 0.01
    normals = trimesh.Trimesh(vertices, faces, process=False).face_normals[numbers[one][:, 0]]
    error = np.abs(found - normals).max(axis=-1)
    assert np.quantile(error, 0.99) <= 0.5 / 127.5 + 1e-5  # rays along edges may hit either face
    assert ((found * direction).sum(axis=-1) > -0.02).all()


def test_silhouettes_of_a_ball_and_a_box() -> None:
    ball = nrs.bake_imposter(nrs.TriangleMesh(*nrs.shapes.icosphere(faces=20_000)), views=4, size=64)
    assert np.isclose(ball.radius, 1.0, rtol=1e-5)
    assert np.allclose(areas(ball), np.pi, rtol=3e-3)
    box = trimesh.creation.box((1.0, 2.0, 3.0))
    imposter = nrs.bake_imposter(
        nrs.TriangleMesh(box.vertices.astype(np.float32), box.faces), views=4, size=128, full_sphere=False
    )
    assert np.isclose(imposter.radius, np.sqrt(14.0) / 2.0, rtol=1e-5)
    # A box shows each side by its area times the cosine.
    want = np.abs(imposter.directions) @ [6.0, 3.0, 2.0]
    # Outlines, no longer than that of the sphere, are right to half a sample.
    sample = 2.0 * imposter.radius / (4 * 128)
    assert np.abs(areas(imposter) - want).max() < 2.0 * np.pi * imposter.radius * sample / 2.0


def test_empty_texels_go_on_as_their_neighbours() -> None:
    """Two halves of different colours: no texel shows anything that is not between them, and most the nearer."""
    vertices, faces = nrs.shapes.icosphere(faces=2_000)
    right = (vertices[faces].mean(axis=1)[:, 0] > 0).astype(np.int32)
    looks = [nrs.Material(base_color=(1, 0, 0)), nrs.Material(base_color=(0, 0, 1))]
    mesh = nrs.TriangleMesh(vertices, faces, face_materials=right, materials=looks)
    imposter = nrs.bake_imposter(mesh, views=3, size=32)
    color = imposter.layer("base_color")[1, 0].astype(int)  # from one side, x to the left or right
    assert abs(imposter.directions[1, 0] @ [1, 0, 0]) < 1e-6
    assert (color[..., 1] == 0).all()
    empty = color[..., 3] == 0
    assert empty.sum() > 100
    blue = color[..., 2] > color[..., 0]
    middle = slice(6, 26)
    columns = blue[middle][:, [0, 1, 2, -3, -2, -1]]
    assert (columns[:, :3] == columns[:1, :1]).all()
    assert (columns[:, 3:] != columns[:1, :1]).all()


@given(st.integers(0, 2**32 - 1), st.floats(0.0, 0.9))
@settings(max_examples=30)
def test_what_is_filled_in_lies_between_what_is_there(seed, share) -> None:
    rng = np.random.default_rng(seed)
    view = rng.random((16, 16, texels.CHANNELS)).astype(np.float32)
    view[..., texels.NORMAL] = (0.0, 0.0, 1.0)
    view[..., texels.ALPHA] *= rng.random((16, 16)) < share
    full = texels.filled(view)
    covered = view[..., texels.ALPHA] > 0
    assert np.array_equal(full[covered], view[covered])
    assert np.array_equal(full[..., texels.ALPHA], view[..., texels.ALPHA])
    if covered.any():
        low, high = view[covered].min(axis=0), view[covered].max(axis=0)
        others = [k for k in range(texels.CHANNELS) if k != texels.ALPHA]
        inside = (full >= low - 1e-5) & (full <= high + 1e-5)
        assert inside[..., others].all()
        # A ring takes the mean of its neighbours.
        for y, x in np.argwhere(~covered)[:8]:
            near = covered[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2]
            if near.any():
                values = view[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2, texels.DEPTH][near]
                assert np.isclose(full[y, x, texels.DEPTH], values.mean(), atol=1e-5)


@pytest.mark.parametrize("mode", ["mask", "blend"])
def test_holes_of_cards(mode) -> None:
    mask = np.full((8, 8, 4), 200, np.uint8)
    mask[:, :4, 3] = 0
    look = nrs.Material(
        base_color=(1, 1, 1),
        double_sided=True,
        alpha_mode=mode,
        base_color_texture=nrs.Texture(mask, filter="nearest"),
    )
    vertices = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32)
    uvs = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32)
    card = nrs.TriangleMesh(vertices, np.array([[0, 1, 2], [0, 2, 3]]), uvs=uvs, materials=look)
    imposter = nrs.bake_imposter(card, views=3, size=64)
    towards = np.abs(imposter.directions[..., 2])
    assert np.allclose(areas(imposter), 2.0 * towards, atol=0.04)
    facing = np.unravel_index(towards.argmax(), towards.shape)
    assert np.allclose(imposter.layer("base_color")[facing][..., :3], 200, atol=1)
    # One side of it: a hole where x is below 0.
    one_sided = nrs.bake_imposter(node_of(card, material=replace(look, double_sided=False)), views=3, size=32)
    behind = one_sided.directions[..., 2] < -0.5
    assert behind.any()
    assert (areas(one_sided)[behind] == 0.0).all()


def test_scenes_show_what_is_visible() -> None:
    ball = nrs.TriangleMesh(*nrs.shapes.icosphere(faces=5_000))
    scene = nrs.Scene()
    scene.add(ball, pose=np.diag([2.0, 2.0, 2.0, 1.0]), material=RED)
    far = scene.add(ball)
    far.pose = [[1, 0, 0, 10], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    both = nrs.bake_imposter(scene, views=3, size=32)
    assert np.allclose(both.center, (4.5, 0, 0))
    assert np.isclose(both.radius, 6.5, rtol=1e-2)
    far.visible = False
    one = nrs.bake_imposter(scene, views=3, size=64)
    assert np.allclose(one.center, 0.0, atol=1e-6)
    assert np.allclose(areas(one), np.pi * 4.0, rtol=5e-3)
    assert len(scene) == 2
    # The colours of vertices count.
    vertices, faces = nrs.shapes.icosphere(faces=500)
    colors = np.full((len(vertices), 3), (0.0, 1.0, 0.0))
    green = nrs.bake_imposter(nrs.TriangleMesh(vertices, faces, colors=colors), views=3, size=8)
    assert np.allclose(green.layer("base_color")[..., :3], (0, 255, 0))


def test_a_posed_body_is_baked_as_it_stands() -> None:
    vertices, faces = nrs.shapes.icosphere(faces=5_000)
    upper = np.clip(0.5 + vertices[:, 2], 0, 1)
    channels = {"weights": np.stack([1 - upper, upper], axis=1)}
    body = nrs.SkinnedMesh(nrs.NaniteMesh.from_arrays(vertices, faces, channels=channels))
    raised = np.eye(4)
    raised[2, 3] = 3.0
    body.pose([np.eye(4), raised])
    imposter = nrs.bake_imposter(body, views=3, size=64)
    cut = body.cut(error=0.0)
    solid = nrs.bake_imposter(nrs.TriangleMesh(cut.vertices, cut.faces), views=3, size=64)
    assert imposter.radius >= solid.radius * 0.999
    assert np.allclose(areas(imposter), areas(solid), rtol=0.02)


def test_units_and_place_do_not_matter(bumpy, baked) -> None:
    vertices, faces = bumpy
    look = replace(RED, smooth=False)
    for scale, offset in ((1e-20, 0.0), (1e18, 0.0), (1.0, 1_000.0)):
        moved = (vertices.astype(np.float64) * scale + offset).astype(np.float32)
        other = nrs.bake_imposter(nrs.TriangleMesh(moved, faces, materials=look), views=6, size=32)
        assert np.isclose(other.radius, baked.radius * scale, rtol=2e-3)
        assert np.mean(np.abs(alpha(other) - alpha(baked))) < 2e-3
        inner = (alpha(other) == 1) & (alpha(baked) == 1)
        depths = [one.layer("depth").astype(int) for one in (other, baked)]
        assert np.median(np.abs(depths[0] - depths[1])[inner]) < 100


def test_up_turns_the_map(bumpy) -> None:
    vertices, faces = bumpy
    upright = nrs.bake_imposter(nrs.TriangleMesh(vertices, faces), views=4, size=16, up="y")
    # X, Y and Z of a mesh whose Z is up are Z, X and Y of one whose Y is.
    turned = np.ascontiguousarray(vertices[:, [2, 0, 1]])
    other = nrs.bake_imposter(nrs.TriangleMesh(turned, faces), views=4, size=16, up="z")
    assert np.allclose(upright.directions[..., [2, 0, 1]], other.directions)
    assert np.mean(np.abs(alpha(upright) - alpha(other))) < 2e-3
    inner = (alpha(upright) == 1) & (alpha(other) == 1)
    depths = [one.layer("depth").astype(int)[inner] for one in (upright, other)]
    assert np.abs(depths[0] - depths[1]).mean() < 20


def test_the_same_input_gives_the_same_bytes(bumpy, baked) -> None:
    mesh = nrs.NaniteMesh.from_arrays(*bumpy, materials=replace(RED, smooth=False))
    assert same(nrs.bake_imposter(mesh, views=6, size=32), baked)
    for other in (pickle.loads(pickle.dumps(baked)), copy.copy(baked), copy.deepcopy(baked)):
        assert same(other, baked)
        assert other.radius == baked.radius
    layer = baked.layer("depth")
    layer[:] = 0
    assert baked.layer("depth").any()


# ----------------------------------------------------------------------------------------- pictures


@pytest.mark.parametrize("place", [(0, 0), (1, 4), (3, 2), (5, 5)])
def test_from_a_direction_of_the_grid_it_is_the_view(baked, place) -> None:
    picture = baked.picture(baked.camera, baked.pose(baked.directions[place]), 32, 32)
    color = baked.layer("base_color")[place]
    assert np.allclose(picture.alpha, color[..., 3] / 255.0, atol=1e-5)
    seen = color[..., 3] > 0
    assert np.array_equal(picture.alpha > 1e-4, seen)
    assert np.allclose(picture.base_color[seen], _colors.from_srgb(color[..., :3] / 255.0)[seen], atol=1e-5)
    # The camera is two radii away: the front plane is one.
    depth = (1.0 + baked.layer("depth")[place] * (2 / 65_535)) * baked.radius
    assert np.allclose(picture.depth[seen], depth[seen], rtol=1e-5)
    normal = baked.layer("normal")[place][seen] / 127.5 - 1.0
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    assert np.allclose(picture.normal[seen], normal, atol=1e-5)
    assert np.allclose(picture.orm[seen], baked.layer("orm")[place][seen] / 255.0, atol=1e-5)


@pytest.fixture(scope="module")
def box() -> tuple[nrs.TriangleMesh, nrs.Imposter]:
    solid = trimesh.creation.box((1.0, 1.6, 0.8))
    mesh = nrs.TriangleMesh(
        solid.vertices.astype(np.float32), solid.faces, materials=replace(RED, smooth=False)
    )
    return mesh, nrs.bake_imposter(mesh, views=12, size=64)


CAMERAS = {
    "orthographic": lambda imposter: (imposter.camera, 2.0),
    "perspective": lambda _: (nrs.PerspectiveCamera(yfov=0.5), 4.5),
    "intrinsics": lambda _: (nrs.IntrinsicsCamera(160.0, 150.0, 36.0, 30.0), 5.0),
}


@pytest.mark.parametrize("kind", CAMERAS)
def test_pictures_are_near_renders(box, kind) -> None:
    """From directions between views: silhouettes, depths and normals, and better with parallax."""
    mesh, imposter = box
    camera, away = CAMERAS[kind](imposter)
    rng = np.random.default_rng(3)
    wrong, apart = {0: [], 2: [], 8: []}, []
    with nrs.Renderer(256, 256, backend="cpu") as renderer:
        larger = camera
        if kind == "intrinsics":
            larger = nrs.IntrinsicsCamera(*(4.0 * value for value in (160.0, 150.0, 36.0, 30.0)))
        for direction in rng.normal(size=(6, 3)):
            pose = imposter.pose(direction)
            pose[:3, 3] = imposter.center + away * imposter.radius * pose[:3, 2]
            frame = renderer.render(node_of(mesh), larger, pose, pixel_error=0.0, shading="gltf")
            covered = (frame.depth > 0).reshape(64, 4, 64, 4)
            coverage = covered.mean(axis=(1, 3))
            for iterations, errors in wrong.items():
                picture = imposter.picture(camera, pose, 64, 64, iterations=iterations)
                errors.append(np.abs(picture.alpha - coverage).sum() / coverage.sum())
            inner = (picture.alpha > 0.99) & (coverage == 1.0)
            depth = frame.depth.reshape(64, 4, 64, 4).mean(axis=(1, 3))
            apart.append(np.median(np.abs(picture.depth - depth)[inner]) / imposter.radius)
            normal = frame.shading_normal.reshape(64, 4, 64, 4, 3).mean(axis=(1, 3))
            assert np.quantile((picture.normal * normal).sum(axis=-1)[inner], 0.3) > 0.99
            assert np.abs(np.linalg.norm(picture.normal[inner], axis=-1) - 1.0).max() < 1e-4
            none = picture.alpha == 0
            assert not any(layer[none].any() for layer in (picture.depth, picture.base_color, picture.orm))
    # Rays have come to rest on the surface; outlines are missed where a view cannot see them.
    assert np.mean(apart) < 0.002
    assert np.mean(wrong[8]) < 0.05
    assert np.mean(wrong[2]) < 0.7 * np.mean(wrong[0])


def test_small_pictures_are_means(baked) -> None:
    """From a direction of the grid: mip levels have the means of whole texels, colours by their coverage."""
    pose = baked.pose(baked.directions[1, 3])
    whole = alpha(baked)[1, 3]
    for count in (32, 16, 8, 4, 2, 1):
        picture = baked.picture(baked.camera, pose, count, count)
        times = 32 // count
        want = whole.reshape(count, times, count, times).mean(axis=(1, 3))
        assert np.allclose(picture.alpha, want, atol=1e-5)
        seen = want > 0
        assert np.allclose(picture.base_color[seen], RED.base_color[:3], atol=0.01)
    for count in (7, 24, 50):
        assert np.isclose(
            baked.picture(baked.camera, pose, count, count).alpha.mean(), whole.mean(), rtol=0.05
        )


def test_just_below_the_horizon_a_half_one_is_seen_from_the_horizon(bumpy) -> None:
    half = nrs.bake_imposter(nrs.TriangleMesh(*bumpy), views=6, size=16, full_sphere=False)
    full = nrs.bake_imposter(nrs.TriangleMesh(*bumpy), views=12, size=16)
    pictures = [one.picture(one.camera, one.pose((0.3, -0.05, 0.4)), 16, 16) for one in (half, full)]
    shown = [picture.alpha for picture in pictures]
    assert np.abs(shown[0] - shown[1]).sum() < 0.1 * shown[1].sum()
    below = half.picture(half.camera, half.pose((0.0, -1.0, 0.0)), 8, 8)
    assert all(np.isfinite(layer).all() for layer in vars(below).values())


# -------------------------------------------------------------------------------------------- files


def test_folders_come_back(baked, tmp_path) -> None:
    folder = tmp_path / "a" / "imposter"
    for _ in range(2):  # the second replaces the first
        baked.save(folder)
    assert sorted(path.name for path in folder.iterdir()) == sorted(
        ["imposter.json", *(f"{name}.png" for name in LAYERS)]
    )
    back = nrs.Imposter.open(str(folder))
    assert same(back, baked)
    assert (back.radius, back.up, back.full_sphere, back.nbytes) == (
        baked.radius,
        baked.up,
        baked.full_sphere,
        12 * 36 * 32 * 32,
    )
    assert np.array_equal(back.center, baked.center)
    assert repr(back) == repr(baked)
    # As any reader sees them.
    depth = np.asarray(Image.open(folder / "depth.png"))
    assert depth.astype(np.uint16).tobytes() == baked.atlas("depth").tobytes()
    color = np.asarray(Image.open(folder / "base_color.png"))
    assert np.array_equal(color[32 * 2 : 32 * 3, 32 * 4 : 32 * 5], baked.layer("base_color")[2, 4])
    said = json.loads((folder / "imposter.json").read_text())
    assert (said["views"], said["size"], said["up"]) == (6, 32, "y")
    assert set(said["conventions"]) >= set(LAYERS)


BROKEN = {
    "views": [2, 2.5, True, "6", None, 10**9],
    "size": [0, 24, -32, 16, 1 << 40],
    "full_sphere": [1, None],
    "up": ["x", 3, ["y"]],
    "center": [[0, 0], [0, 0, "0"], [0, 0, float("nan")], None],
    "radius": [0.0, -1.0, float("inf"), "1"],
    "files": [None, {}, {"base_color": "../x.png"}, {"base_color": 3}, {"base_color": ".."}],
    "version": [2, None],
    "format": ["another", None],
}


def test_broken_folders_are_errors(baked, tmp_path) -> None:
    with pytest.raises(nrs.MissingFileError, match=r"imposter\.json"):
        nrs.Imposter.open(tmp_path / "none")
    baked.save(tmp_path)
    path = tmp_path / "imposter.json"
    text = path.read_text()
    for name, values in BROKEN.items():
        for value in values:
            path.write_text(json.dumps(json.loads(text) | {name: value}))
            with pytest.raises(nrs.FormatError, match=r"imposter\.json|base_color\.png"):
                nrs.Imposter.open(tmp_path)
    for wrong in ("", "[]", "3", "{", text[:100], "[" * 100_000, '"\\ud800"'):
        path.write_text(wrong)
        with pytest.raises(nrs.FormatError, match=r"imposter\.json"):
            nrs.Imposter.open(tmp_path)
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(nrs.FormatError, match="no JSON"):
        nrs.Imposter.open(tmp_path)
    path.write_text(text)
    assert same(nrs.Imposter.open(tmp_path), baked)
    for name in LAYERS:
        place = tmp_path / f"{name}.png"
        data = place.read_bytes()
        for wrong in (
            b"",
            data[:100],
            data[: len(data) // 2],
            b"no picture",
            (tmp_path / "orm.png").read_bytes(),
        ):
            if wrong == data or (wrong == (tmp_path / "orm.png").read_bytes() and name == "normal"):
                continue
            place.write_bytes(wrong)
            with pytest.raises(nrs.FormatError, match=name):
                nrs.Imposter.open(tmp_path)
        place.unlink()
        with pytest.raises(nrs.MissingFileError, match=name):
            nrs.Imposter.open(tmp_path)
        place.write_bytes(data)
    with pytest.raises(nrs.FileError):
        baked.save(path)  # a file, not a folder
    with pytest.raises(nrs.FileError):
        baked.save("a\0b")


# --------------------------------------------------------------------------------------- bad input


def test_bad_input_is_refused(baked) -> None:
    ball = nrs.TriangleMesh(*nrs.shapes.icosphere(faces=80))
    for options, match in (
        ({"views": 2}, "views: must be 3 or more"),
        ({"views": 4.0}, "views: expected an integer"),
        ({"size": 2}, "size: must be 4 or more"),
        ({"size": 48}, "size: must be a power of two"),
        ({"size": 1024}, "size: 12 views of 1024 texels make images of 12288"),
        ({"full_sphere": 1}, "full_sphere: expected True or False"),
        ({"up": "x"}, "up: must be"),
        ({"backend": "tpu"}, "backend"),
    ):
        with pytest.raises(nrs.ArgumentError, match=match):
            nrs.bake_imposter(ball, **options)
    for wrong in ("ball.glb", None, np.zeros((3, 3))):
        with pytest.raises(nrs.DtypeError, match="mesh: expected a mesh or a Scene"):
            nrs.bake_imposter(wrong)
    with pytest.raises(nrs.MeshError, match="mesh: there is nothing to see"):
        nrs.bake_imposter(nrs.Scene())
    points = node_of(nrs.Points(np.zeros((3, 3), np.float32)))
    with pytest.raises(nrs.ArgumentError, match="mesh: imposters are of surfaces, not of Points"):
        nrs.bake_imposter(points)
    clear = nrs.Material(base_color=(1, 1, 1, 0.1), alpha_mode="mask")
    with pytest.raises(nrs.MeshError, match="mesh: no view shows anything"):
        nrs.bake_imposter(node_of(ball, material=clear), views=3, size=4)
    dot = nrs.TriangleMesh(np.ones((3, 3), np.float32), np.array([[0, 1, 2]]))
    with pytest.raises(nrs.MeshError, match="mesh: its radius is 0"):
        nrs.bake_imposter(dot)
    for wrong in ((0, 0, 0), (1, 2), (np.nan, 0, 1), "up", None):
        with pytest.raises(nrs.ArgumentError, match="direction"):
            baked.pose(wrong)
    assert np.isfinite(baked.pose((1e300, 1e300, 0))).all()
    camera, pose = baked.camera, baked.pose((0, 0, 1))
    with pytest.raises(nrs.DtypeError, match="camera"):
        baked.picture(pose, camera, 8, 8)
    for wrong in (np.eye(3), np.full((4, 4), np.nan), np.diag([2.0, 2.0, 2.0, 1.0])):
        with pytest.raises(nrs.ArgumentError, match="pose"):
            baked.picture(camera, wrong, 8, 8)
    inside = np.eye(4)
    inside[:3, 3] = baked.center
    with pytest.raises(nrs.ArgumentError, match="pose: 0 from the centre is inside"):
        baked.picture(nrs.PerspectiveCamera(yfov=0.8), inside, 8, 8)
    for options in ({"width": 0}, {"height": 10_000}, {"iterations": -1}, {"iterations": 1.5}):
        with pytest.raises(nrs.ArgumentError, match=next(iter(options))):
            baked.picture(camera, pose, **({"width": 8, "height": 8} | options))
    for call in (baked.layer, baked.atlas):
        with pytest.raises(nrs.ArgumentError, match="name: must be"):
            call("color")
    with pytest.raises(nrs.DtypeError, match="folder"):
        baked.save(3)
    with pytest.raises(nrs.DtypeError, match="folder"):
        nrs.Imposter.open(None)


# ----------------------------------------------------------------------------- processes, the shell


def work(imposter: nrs.Imposter) -> bytes:
    """What a child makes of one, and bakes."""
    mesh = nrs.TriangleMesh(*nrs.shapes.icosphere(faces=80))
    own = nrs.bake_imposter(mesh, views=3, size=8)
    picture = imposter.picture(imposter.camera, imposter.pose((1, 2, 3)), 16, 16)
    return own.layer("normal").tobytes() + picture.alpha.tobytes() + picture.depth.tobytes()


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_children_make_the_same(baked, method) -> None:
    if method not in multiprocessing.get_all_start_methods():
        pytest.skip(f"there is no {method} here")
    context = multiprocessing.get_context(method)
    with concurrent.futures.ProcessPoolExecutor(1, mp_context=context) as pool:
        assert pool.submit(work, baked).result(timeout=60) == work(baked)


def test_the_shell(tmp_path, capsys) -> None:
    folder = tmp_path / "knot"
    call = ["imposter", "shape:torus_knot:2000", "-o", str(folder), "--views", "4", "--size", "16"]
    assert cli.main([*call, "--half", "--up", "z"]) == 0
    assert "4 × 4 views of the upper half" in capsys.readouterr().out
    imposter = nrs.Imposter.open(folder)
    assert (imposter.views, imposter.size, imposter.full_sphere, imposter.up) == (4, 16, False, "z")
    assert cli.main([*call, "--size", "20"]) == 1
    assert "size: must be a power of two" in capsys.readouterr().err
    box = trimesh.creation.box()
    box.visual = trimesh.visual.TextureVisuals(
        uv=np.zeros((len(box.vertices), 2)),
        material=trimesh.visual.material.PBRMaterial(baseColorFactor=[255, 0, 0, 255]),
    )
    box.export(tmp_path / "box.glb")
    call = ["imposter", str(tmp_path / "box.glb"), "-o", str(tmp_path / "box"), "--views", "3", "--size", "8"]
    assert cli.main([*call, "--quiet"]) == 0
    assert capsys.readouterr().out == ""
    assert (nrs.Imposter.open(tmp_path / "box").layer("base_color")[..., :3] == (255, 0, 0)).all()
