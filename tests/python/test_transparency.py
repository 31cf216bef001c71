"""Blended surfaces against compositing that is sorted here, and against all hits of rays of Embree."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import nanite_rs as nrs
from oracles import rays

SIZE = 64, 48
CAMERA = nrs.OrthographicCamera(2.0, 1.5)
POSE = nrs.look_at((0, 0, 10), (0, 0, 0))
RNG = np.random.default_rng(11)
QUAD = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32)
FACES = np.array([[0, 1, 2], [0, 2, 3]])


def pane(color, alpha, **options):
    return nrs.Material(
        base_color=(*color, alpha), metallic=0.0, double_sided=True, unlit=True, alpha_mode="blend", **options
    )


def over(behind, layers):
    """Colours of layers, from far to near, each with its alpha."""
    out = np.array(behind, np.float64)
    for color, alpha in layers:
        out = alpha * np.asarray(color) + (1.0 - alpha) * out
    return out


def random_panes(count):
    """Rectangles: corners, depth, colour, alpha."""
    panes = []
    for _ in range(count):
        low = RNG.uniform(-2, 1, 2)
        high = low + RNG.uniform(0.3, 2.5, 2)
        panes.append((low, high, float(RNG.integers(-4, 4)), RNG.random(3), float(RNG.uniform(0.1, 0.9))))
    return panes


def quad(low, high, z):
    x0, y0, x1, y1 = *low, *high
    return np.array([[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]], np.float32)


def centers():
    width, height = SIZE
    x = (np.arange(width) + 0.5) / width * 4.0 - 2.0
    y = 1.5 - (np.arange(height) + 0.5) / height * 3.0
    return np.meshgrid(x, y)


@pytest.mark.parametrize("kind", [nrs.TriangleMesh, nrs.NaniteMesh.from_arrays])
def test_panes_are_composited_by_depth_whatever_the_order(kind, backend):
    x, y = centers()
    panes = random_panes(7)
    # Depths that differ: what coincides is ordered by the scene.
    panes = [(low, high, z + 0.01 * k, color, alpha) for k, (low, high, z, color, alpha) in enumerate(panes)]
    wall = quad((-1.5, -1.0), (1.0, 1.2), -3.45)
    wanted = np.ones((*SIZE[::-1], 3))
    inside = (x > -1.5) & (x < 1.0) & (y > -1.0) & (y < 1.2)
    wanted[inside] = 0.2, 0.5, 0.3
    sure = np.ones(inside.shape, bool)
    for low, high, z, color, alpha in sorted(panes, key=lambda one: one[2]):
        there = (x > low[0]) & (x < high[0]) & (y > low[1]) & (y < high[1])
        there &= ~inside | (z > -3.45)
        wanted[there] = over(wanted[there], [(color, alpha)])
        for at, ends in ((x, (low[0], high[0])), (y, (low[1], high[1]))):
            sure &= np.abs(at[..., None] - np.array(ends)).min(-1) > 0.02
    options = {"progress": False} if kind is not nrs.TriangleMesh else {}
    pictures = []
    with nrs.Renderer(*SIZE, backend=backend) as renderer:
        for order in (range(7), range(6, -1, -1), RNG.permutation(7)):
            scene = nrs.Scene(bg_color=(1, 1, 1))
            for k in order:
                low, high, z, color, alpha = panes[k]
                scene.add(kind(quad(low, high, z), FACES, **options), material=pane(color, alpha))
            scene.add(
                kind(wall, FACES, **options),
                material=nrs.Material(base_color=(0.2, 0.5, 0.3), unlit=True, metallic=0.0),
            )
            frame = renderer.render(scene, CAMERA, POSE)
            pictures.append(frame)
            np.testing.assert_allclose(frame.linear[sure], wanted[sure], atol=2e-6)
            np.testing.assert_array_equal(frame.depth > 0, frame.instance_id >= 0)
            np.testing.assert_array_equal((frame.depth > 0)[sure], inside[sure])
            assert frame.stats.layers_left == 0 < frame.stats.layers <= 7
    for other in pictures[1:]:
        np.testing.assert_array_equal(other.color, pictures[0].color)


def test_what_coincides_all_counts():
    colors = [(1, 0, 0), (0, 1, 0), (0, 0, 1)]
    scene = nrs.Scene(bg_color=(1, 1, 1))
    for color in colors:
        scene.add(nrs.TriangleMesh(3 * QUAD, FACES), material=pane(color, 0.5))
    with nrs.Renderer(*SIZE, backend="cpu") as renderer:
        frame = renderer.render(scene, CAMERA, POSE)
        # Those that were added first are the nearest.
        np.testing.assert_allclose(
            frame.linear[24, 32], over((1, 1, 1), [(c, 0.5) for c in colors[::-1]]), atol=1e-6
        )
        assert (frame.stats.layers, frame.stats.layers_left) == (3, 0)
        # Nearer ones only; the rest is counted.
        few = renderer.render(scene, CAMERA, POSE, max_layers=2)
        np.testing.assert_allclose(
            few.linear[24, 32], over((1, 1, 1), [(c, 0.5) for c in colors[1::-1]]), atol=1e-6
        )
        assert (few.stats.layers, few.stats.layers_left) == (2, SIZE[0] * SIZE[1])
        none = renderer.render(scene, CAMERA, POSE, max_layers=0)
        assert (none.color == 255).all()
        for bad in (-1, 257, 1.5):
            with pytest.raises(nrs.ArgumentError, match=r"^max_layers: "):
                renderer.render(scene, CAMERA, POSE, max_layers=bad)


def test_alpha_of_textures_and_vertices_counts():
    alphas = np.array([[0, 64], [128, 255]], np.uint8)
    pixels = np.dstack([np.full((2, 2, 3), 255, np.uint8), alphas])
    texture = nrs.Texture(pixels, filter="nearest", mipmaps=None)
    uvs = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
    colors = np.array([[255, 255, 255, 51]] * 4, np.uint8)
    for carried, part in (({}, 1.0), ({"colors": colors}, 0.2)):
        scene = nrs.Scene(bg_color=(0, 0, 0))
        mesh = nrs.TriangleMesh(QUAD * np.array([2, 1.5, 1], np.float32), FACES, uvs=uvs, **carried)
        scene.add(mesh, material=pane((1, 1, 1), 0.5, base_color_texture=texture))
        with nrs.Renderer(*SIZE, backend="cpu") as renderer:
            frame = renderer.render(scene, CAMERA, POSE)
        found = frame.linear[12::24, 16::32, 0]
        np.testing.assert_allclose(found, 0.5 * part * alphas / 255.0, atol=1e-6)
        np.testing.assert_allclose(
            frame.rgba[12::24, 16::32, 3] / 255.0, 0.5 * part * alphas / 255.0, atol=3e-3
        )


def surfaces(vertices, faces, origins, directions):
    """How many surfaces each ray meets."""
    oracle = rays.Rays(vertices, faces)
    hits, start = np.zeros(len(origins), int), np.zeros(len(origins))
    for _ in range(100):
        face, distance = oracle.first(origins + start[:, None] * directions, directions)
        hits += face >= 0
        start += np.where(face >= 0, distance + 1e-4, 0.0)
        if not (face >= 0).any():
            break
    return hits


@pytest.mark.parametrize("samples", [1, 4])
def test_real_shapes_are_as_rays_find_them(samples):
    """A knot of glass before another: alpha to the number of surfaces that a ray meets."""
    vertices, faces = nrs.shapes.torus_knot(faces=6_000)
    alpha = 0.3
    scene = nrs.Scene(bg_color=(0, 0, 0))
    scene.add(nrs.TriangleMesh(vertices, faces), material=pane((1, 1, 1), alpha))
    pose = nrs.look_at((0.4, 0.3, 6.0), (0, 0, 0))
    lens = nrs.PerspectiveCamera(yfov=0.7)
    with nrs.Renderer(160, 120, backend="cpu") as renderer:
        frame = renderer.render(scene, lens, pose, max_layers=32, samples=samples)
    high, wide = 120, 160
    y, x = np.mgrid[:high, :wide] + 0.5
    focal = 0.5 * high / np.tan(0.35)
    to = np.stack([(x - wide / 2) / focal, (high / 2 - y) / focal, -np.ones_like(x)], -1) @ pose[:3, :3].T
    to = to.reshape(-1, 3)
    hits = surfaces(vertices, faces, np.broadcast_to(pose[:3, 3], to.shape), to).reshape(high, wide)
    wanted = 1.0 - (1.0 - alpha) ** hits
    # Away from outlines, where a ray beside finds another number.
    steady = np.ones_like(hits, bool)
    for axis in (0, 1):
        for step in (-1, 1):
            steady &= np.roll(hits, step, axis) == hits
    assert hits.max() >= 4
    assert (steady & (hits > 0)).sum() > 900
    off = np.abs(frame.linear[..., 0] - wanted)[steady]
    assert (off > 1.0 / 255.0).mean() < 0.002
    assert frame.stats.layers >= 4


def test_light_and_shadow_fall_on_glass_and_none_from_it():
    floor = np.array([[-3, -1, -3], [3, -1, -3], [3, -1, 3], [-3, -1, 3]], np.float32)
    scene = nrs.Scene(ambient_light=(0.1, 0.1, 0.1), bg_color=(0, 0, 0))
    scene.add(nrs.TriangleMesh(floor, FACES[:, ::-1]), material=nrs.Material(double_sided=True))
    lifted = np.array([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]], np.float32)
    glass = scene.add(nrs.TriangleMesh(lifted, FACES[:, ::-1]))
    scene.add(nrs.DirectionalLight(intensity=3.0), pose=nrs.look_at((0.2, 4, 0.1), (0, 0, 0)))
    look = {"base_color": (0.9, 0.9, 0.9, 0.4), "double_sided": True}
    pose = nrs.look_at((0, 5, 5), (0, 0, 0))
    lens = nrs.PerspectiveCamera(yfov=0.8)

    def drawn(mode, shadows):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", nrs.UsageWarning)
            glass.material = nrs.Material(**look, alpha_mode=mode)
        with nrs.Renderer(96, 72, backend="cpu") as renderer:
            return renderer.render(scene, lens, pose, shadows=shadows)

    for kind in ("virtual", "cascaded"):
        np.testing.assert_allclose(drawn("blend", kind).linear, drawn("blend", False).linear, atol=1e-6)
        assert np.abs(drawn("opaque", kind).linear - drawn("opaque", False).linear).max() > 0.1
        # Something opaque above throws its shadow on both.
        above = scene.add(nrs.TriangleMesh(lifted * 0.4 + np.array([0, 1, 0], np.float32), FACES[:, ::-1]))
        lit, dark = drawn("blend", False).linear, drawn("blend", kind).linear
        above.remove()
        assert (lit - dark).max() > 0.1
    # One renderer knows when a look changes.
    with nrs.Renderer(96, 72, backend="cpu") as renderer:
        for mode in ("blend", "opaque", "blend"):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", nrs.UsageWarning)
                glass.material = nrs.Material(**look, alpha_mode=mode)
            kept = renderer.render(scene, lens, pose, shadows=True)
            np.testing.assert_array_equal(kept.color, drawn(mode, True).color)


def test_opaque_alpha_is_warned_of_once():
    mesh = nrs.TriangleMesh(QUAD, FACES)
    scene = nrs.Scene()
    look = nrs.Material(base_color=(1, 1, 1, 0.5))
    with pytest.warns(nrs.UsageWarning, match=r"^material\[1\]: alpha 0.5 counts for nothing") as caught:
        scene.add(mesh, material=[nrs.Material(), look])
    assert caught[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene.add(mesh, material=look)
        nrs.Scene().add(mesh, material=pane((1, 1, 1), 0.5))


def test_scenes_know_what_is_seen_through(backend):
    """Whatever was shown, hidden, painted, moved or removed meanwhile, a picture is that of a scene made so."""
    mesh = nrs.TriangleMesh(2 * QUAD, FACES)
    tinted = nrs.TriangleMesh(2 * QUAD, FACES, colors=np.full((4, 4), 128, np.uint8))
    glass = pane((1, 0, 0), 0.5)
    scene = nrs.Scene(bg_color=(0, 0, 1))
    nodes = [scene.add(mesh, material=glass), scene.add(tinted, material=pane((0, 1, 0), 1.0))]
    opaque = nrs.Material(base_color=(1, 1, 0), unlit=True, double_sided=True)

    def shown():
        with nrs.Renderer(16, 16, backend=backend) as renderer, warnings.catch_warnings():
            warnings.simplefilter("ignore", nrs.UsageWarning)
            color = renderer.render(scene, CAMERA, POSE, transfer="linear").linear[8, 8]
        return pytest.approx(color.tolist(), abs=1e-3)

    both = over((0, 0, 1), [((0, 128 / 255, 0), 128 / 255), ((1, 0, 0), 0.5)]).tolist()
    assert shown() == both
    nodes[0].visible = False
    mesh.update(2 * QUAD)
    assert shown() == over((0, 0, 1), [((0, 128 / 255, 0), 128 / 255)]).tolist()
    nodes[1].material = opaque
    assert shown() == [128 / 255, 128 / 255, 0.0]
    nodes[1].remove()
    assert shown() == [0.0, 0.0, 1.0]
    nodes[0].visible = True
    nodes[0].material = opaque
    nodes[0].material = glass
    assert shown() == [0.5, 0.0, 0.5]
    nodes[0].remove()
    assert shown() == [0.0, 0.0, 1.0]


def test_ids_of_what_is_blended(backend):
    """As if the nearest surface were opaque."""
    rng = np.random.default_rng(3)
    scenes = [nrs.Scene(ambient_light=(1, 1, 1)) for _ in range(2)]
    vertices, faces = nrs.shapes.torus_knot(faces=3_000)
    knot = nrs.NaniteMesh.from_arrays(vertices, faces, progress=False)
    for k in range(6):
        pose = nrs.look_at(rng.uniform(-1, 1, 3), rng.uniform(2, 3, 3))
        for solid, scene in enumerate(scenes):
            look = nrs.Material(
                base_color=(0.3, 0.6, 0.2, 0.4), alpha_mode="opaque" if solid or k < 2 else "blend"
            )
            scene.add(knot, pose=pose, material=look)
    camera, pose = nrs.PerspectiveCamera(yfov=0.9), nrs.look_at((0, 0, 5), (0, 0, 0))
    with nrs.Renderer(*SIZE, backend=backend) as renderer, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        plain = renderer.render(scenes[0], camera, pose)
        frame = renderer.render(scenes[0], camera, pose, transparent_ids=True, samples=1)
        solid = renderer.render(scenes[1], camera, pose)
        many = renderer.render(scenes[0], camera, pose, transparent_ids=True, samples=4)
        with pytest.raises(nrs.ArgumentError, match="transparent_ids"):
            renderer.render(scenes[0], camera, pose, transparent_ids=True, depth_only=True)
    np.testing.assert_array_equal(frame.color, plain.color)
    np.testing.assert_array_equal(frame.rgba, plain.rgba)
    for name in ("depth", "instance_id", "cluster_id", "triangle_id", "normal"):
        np.testing.assert_array_equal(getattr(frame, name), getattr(solid, name), name)
        np.testing.assert_array_equal(getattr(many, name), getattr(solid, name), name)
    assert (plain.instance_id != frame.instance_id).mean() > 0.05
    assert frame.stats.covered_pixels == (frame.depth > 0).sum()
    np.testing.assert_array_equal(frame.overdraw, solid.overdraw)


def test_layers_end_where_nothing_lies_behind():
    """Small glass in a large picture: all of its layers are found, in whatever tiles they lie."""
    rng = np.random.default_rng(5)
    scene = nrs.Scene(ambient_light=(1, 1, 1))
    vertices, faces = nrs.shapes.icosphere(faces=80)
    balls = []
    for _ in range(40):
        center, radius = rng.uniform(-1.5, 1.5, 3), rng.uniform(0.1, 0.6)
        balls.append((center, radius))
        scene.add(
            nrs.TriangleMesh(vertices * radius + center, faces),
            material=nrs.Material(
                base_color=(1.0, 1.0, 1.0, 0.25), alpha_mode="blend", unlit=True, double_sided=True
            ),
        )
    size = 320, 240
    camera, pose = nrs.OrthographicCamera(2.4, 1.8, znear=0.1, zfar=20.0), nrs.look_at((0, 0, 9), (0, 0, 0))
    scene.bg_color = (0.0, 0.0, 0.0)
    with nrs.Renderer(*size, backend="cpu") as renderer:
        frame = renderer.render(scene, camera, pose, max_layers=64)
        counts = [renderer.render(scene, camera, pose, max_layers=n).stats for n in (3, 64)]
    light = frame.linear[..., 0]
    # Each layer lets three quarters through: so many there are.
    layers = np.log(1.0 - light) / np.log(0.75)
    x, y = np.meshgrid(
        (np.arange(size[0]) + 0.5) / size[0] * 4.8 - 2.4, 1.8 - (np.arange(size[1]) + 0.5) / size[1] * 3.6
    )
    points = np.stack([x, y, np.full(x.shape, 9.0)], axis=-1).reshape(-1, 3)
    everything = np.concatenate([vertices * radius + center for center, radius in balls])
    every_face = np.concatenate([faces + np.uint32(len(vertices) * k) for k in range(len(balls))])
    hits = surfaces(everything, every_face, points, np.broadcast_to([0.0, 0.0, -1.0], points.shape))
    wrong = np.abs(layers.reshape(-1) - hits) > 0.05
    assert wrong.mean() < 0.004  # on outlines
    assert counts[0].layers_left > 0
    assert counts[1].layers_left == 0
    assert counts[1].layers >= hits.max() - 2
