"""Points and lines: against discs and bands that are drawn by hand here, and among meshes of all kinds."""

from __future__ import annotations

import copy
import pickle
import warnings

import numpy as np
import pytest

import nanite_rs as nrs
from oracles import picture
from oracles.documents import Document

SIZE = 96, 64
CAMERAS = {
    "pinhole": nrs.PerspectiveCamera(yfov=0.9, znear=0.5),
    "parallel": nrs.OrthographicCamera(3.0, 2.0, znear=0.5, zfar=50.0),
}
POSE = nrs.look_at((1.0, 2.0, 6.0), (0.0, 0.0, 0.0))
every_camera = pytest.mark.parametrize("camera", CAMERAS)
RIM = 0.002
"""Pixels so near to where a disc or a band ends may go either way."""


def on_screen(camera, points):
    """Pixels, distances and pixels per unit of what lies at points of the world."""
    width, height = SIZE
    matrix = CAMERAS[camera].projection_matrix(width, height)
    local = (np.asarray(points, np.float64) - POSE[:3, 3]) @ POSE[:3, :3]
    depth = -local[:, 2]
    scale = np.array([matrix[0, 0] * width, -matrix[1, 1] * height]) / 2.0
    per_unit = scale / depth[:, None] if camera == "pinhole" else np.broadcast_to(scale, (len(local), 2))
    return local[:, :2] * per_unit + np.array([width, height]) / 2.0, depth, np.abs(per_unit[:, 1])


def centers():
    return np.stack(np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5), axis=-1)


class Drawn:
    """A picture made by hand: what is nearest in each pixel, and whether that is beyond doubt."""

    def __init__(self) -> None:
        shape = SIZE[::-1]
        self.depth, self.row = np.full(shape, np.inf), np.full(shape, -1)
        self.doubtful = np.full(shape, np.inf)

    def put(self, row, beyond, depth):
        """Draw what covers the pixels where `beyond`, a distance in pixels, is not positive."""
        rim = np.abs(beyond) < RIM
        self.doubtful[rim] = np.minimum(self.doubtful[rim], np.broadcast_to(depth, rim.shape)[rim] * 0.9999)
        crossing = (beyond <= 0.0) & (np.abs(depth / self.depth - 1.0) < 1e-5)
        self.doubtful[crossing] = 0.0
        nearer = (beyond <= 0.0) & (depth < self.depth)
        self.row[nearer] = row
        self.depth[nearer] = np.broadcast_to(depth, nearer.shape)[nearer]

    @property
    def sure(self):
        return (self.doubtful > self.depth) | np.isinf(self.doubtful)


def rendered(scene, camera, backend="cpu", **options):
    with nrs.Renderer(*SIZE, backend=backend) as renderer:
        return renderer.render(scene, CAMERAS[camera], POSE, **options)


@every_camera
@pytest.mark.parametrize(("radius", "unit"), [(4.3, "pixels"), (0.17, "world"), (0.3, "pixels")])
def test_discs_are_where_they_are_drawn_by_hand(camera, radius, unit, backend):
    rng = np.random.default_rng(3)
    positions = rng.uniform(-4, 4, (400, 3))
    at, depth, per_unit = on_screen(camera, positions)
    colors = rng.integers(0, 256, (400, 3)).astype(np.uint8)
    drawn = Drawn()
    for row in np.flatnonzero(depth > 0.5):
        size = max(radius if unit == "pixels" else radius * per_unit[row], 0.5)
        away = np.hypot(*np.moveaxis(centers() - at[row], -1, 0))
        inside = (np.floor(centers()) == np.floor(at[row])).all(axis=-1)
        if size < 1.5 and np.abs(at[row] - np.round(at[row])).min() < RIM:
            beyond = np.where(away < 2.0, 0.0, away - size)
        else:
            beyond = np.where(inside, -1.0, away - size)
        drawn.put(row, beyond, depth[row])
    scene = nrs.Scene()
    cloud = nrs.Points(positions, colors=colors, radius=radius, unit=unit)
    node = scene.add(cloud)
    frame = rendered(scene, camera, backend)
    sure = drawn.sure
    assert sure.mean() > 0.9
    assert (drawn.row >= 0).mean() > 0.02
    np.testing.assert_array_equal(frame.face_id[sure], drawn.row[sure])
    covered = sure & (drawn.row >= 0)
    np.testing.assert_allclose(frame.depth[covered], drawn.depth[covered], rtol=1e-5)
    np.testing.assert_array_equal(frame.instance_id[covered], node.instance_id)
    np.testing.assert_array_equal(frame.color[covered], _encoded(colors / 255.0)[drawn.row[covered]])
    np.testing.assert_allclose(frame.normal[covered], np.tile(POSE[:3, 2], (covered.sum(), 1)), atol=1e-6)
    assert (frame.color[sure & ~covered] == 255).all()


def _encoded(colors):
    """As pyrender writes what is lit: to the power of 1/2.2."""
    return np.rint(255.0 * np.asarray(colors, np.float64) ** (1.0 / 2.2)).astype(np.uint8)


@every_camera
@pytest.mark.parametrize(("width", "unit"), [(3.0, "pixels"), (0.2, "world"), (0.1, "pixels")])
def test_bands_are_where_they_are_drawn_by_hand(camera, width, unit, backend):
    rng = np.random.default_rng(5)
    positions, segments = rng.uniform(-5, 9, (60, 3)), rng.integers(0, 60, (40, 2))
    drawn, shares = Drawn(), np.zeros((40, *SIZE[::-1]))
    for row, (a, b) in enumerate(positions[segments]):
        _, depth, _ = on_screen(camera, [a, b])
        if (depth < 0.5).all():
            continue
        # What lies before the near plane is cut off.
        limits = np.clip((0.5 - depth[0]) / (depth[1] - depth[0]) if depth[0] != depth[1] else 0.0, 0.0, 1.0)
        ends = np.array([limits if depth[0] < 0.5 else 0.0, limits if depth[1] < 0.5 else 1.0])
        p, q = a + ends[:, None] * (b - a)
        at, depth, per_unit = on_screen(camera, [p, q])
        sizes = np.maximum(width / 2.0 if unit == "pixels" else width / 2.0 * per_unit, 0.5) * np.ones(2)
        foot, beyond, best = _beyond_hull(centers(), at, sizes)
        covered = beyond <= 0.0
        t = np.where(covered, _nearest_disc(centers(), at, sizes, depth, covered, best), foot)
        value = (1.0 / depth if camera == "pinhole" else depth) @ np.array([1.0 - t, t]).reshape(2, -1)
        value = value.reshape(t.shape)
        depths = 1.0 / value if camera == "pinhole" else value
        drawn.put(row, beyond, depths)
        # What differs little in depth is told apart by the picture.
        _, both, _ = on_screen(camera, [a, b])
        tells = np.abs(both[1] - both[0]) > 0.01 * depths
        turned = foot if camera == "parallel" else _at_depth(foot, depth)
        share = np.where(tells, (depths - depth[0]) / (depth[1] - depth[0]), turned)
        steady = (foot > 0.0) & (foot < 1.0)
        shares[row] = np.where(steady, ends[0] + share * (ends[1] - ends[0]), np.nan)
    colors = rng.random((60, 3))
    scene = nrs.Scene()
    scene.add(nrs.Lines(positions, segments, colors=colors, width=width, unit=unit))
    frame = rendered(scene, camera, backend, shading="gltf")
    sure = drawn.sure
    assert sure.mean() > 0.85
    assert (drawn.row >= 0).mean() > 0.04
    np.testing.assert_array_equal(frame.face_id[sure], drawn.row[sure])
    covered = sure & (drawn.row >= 0)
    np.testing.assert_allclose(frame.depth[covered], drawn.depth[covered], rtol=1e-4)
    row = drawn.row[covered]
    share = np.take_along_axis(shares, drawn.row[None].clip(0), axis=0)[0][covered]
    wanted = colors[segments[row]]
    wanted = wanted[:, 0] + share[:, None] * (wanted[:, 1] - wanted[:, 0])
    inside = np.isfinite(share)  # and not in an end
    assert inside.mean() > 0.5
    assert np.abs(frame.linear[covered] - wanted)[inside].max() < 0.01


def _at_depth(t, depth):
    """From shares of a segment on the picture to shares of it in space."""
    seen = 1.0 / ((1.0 - t) / depth[0] + t / depth[1])
    return (seen - depth[0]) / (depth[1] - depth[0]) if depth[0] != depth[1] else t


def _nearest_disc(pixels, ends, sizes, depth, covered, best):
    """Where the nearest disc lies that covers a pixel: by halves between the near end and the best disc."""
    out = np.zeros(covered.shape)
    order = [0, 1] if depth[0] <= depth[1] else [1, 0]
    (p, q), (first, last) = ends[order], sizes[order]

    def covers(t):
        away = pixels[covered] - (p + t[:, None] * (q - p))
        return np.hypot(*away.T) <= first + t * (last - first)

    high = best[covered] if order == [0, 1] else 1.0 - best[covered]
    low = np.zeros(len(high))
    at_end = covers(low)
    for _ in range(60):
        middle = (low + high) / 2.0
        inside = covers(middle)
        low, high = np.where(inside, low, middle), np.where(inside, middle, high)
    out[covered] = np.where(at_end, 0.0, high)
    return out if order == [0, 1] else 1.0 - out


def _beyond_hull(pixels, ends, sizes):
    """How far along a segment pixels are, how far outside of the hull of its discs, and the best of these."""
    (p, q), (big, small) = ends, sizes
    way = q - p
    length = np.hypot(*way)
    t = np.clip(((pixels - p) @ way) / max(length**2, 1e-30), 0.0, 1.0)
    # Of all discs between both, the one that reaches farthest: sampled, then refined by golden sections.
    low, high = np.zeros(t.shape), np.ones(t.shape)

    def beyond(share):
        at = p + share[..., None] * way
        return np.hypot(*np.moveaxis(pixels - at, -1, 0)) - (big + share * (small - big))

    ratio = (np.sqrt(5.0) - 1.0) / 2.0
    for _ in range(60):
        left, right = high - ratio * (high - low), low + ratio * (high - low)
        first = beyond(left) < beyond(right)
        low, high = np.where(first, low, left), np.where(first, right, high)
    best = (low + high) / 2.0
    return t, beyond(best), best


@pytest.mark.parametrize("virtual", [False, True])
def test_meshes_hide_them_and_are_hidden(virtual, backend):
    vertices, faces = nrs.shapes.displaced_icosphere(faces=4_000)
    ball = (
        nrs.NaniteMesh.from_arrays(vertices, faces, progress=False)
        if virtual
        else nrs.TriangleMesh(vertices, faces)
    )
    rng = np.random.default_rng(1)
    cloud = nrs.Points(rng.uniform(-2, 2, (600, 3)), radius=2.0)
    wires = nrs.Lines(rng.uniform(-2, 2, (90, 3)), width=4.0)
    frames = []
    for shown in ([ball], [cloud], [wires], [ball, cloud, wires]):
        scene = nrs.Scene(ambient_light=(1, 1, 1))
        for one in shown:
            scene.add(one)
        frames.append(rendered(scene, "pinhole", backend, pixel_error=0.0))
    *alone, together = frames
    depths = np.array([np.where(frame.depth > 0, frame.depth, np.inf) for frame in alone])
    nearest = depths.min(axis=0)
    np.testing.assert_array_equal(together.depth, np.where(np.isfinite(nearest), nearest, 0.0))
    which = np.where(np.isfinite(nearest), depths.argmin(axis=0), -1)
    np.testing.assert_array_equal(together.instance_id, which)
    assert min((which == k).sum() for k in range(3)) > 50
    for k, frame in enumerate(alone):
        np.testing.assert_array_equal(together.color[which == k], frame.color[which == k])
        np.testing.assert_array_equal(together.face_id[which == k], frame.face_id[which == k])


def crowd():
    """Points, lines, an ordinary mesh, a virtual one, glass and a moving body."""
    rng = np.random.default_rng(8)
    scene = nrs.Scene(ambient_light=(0.3, 0.3, 0.3))
    scene.add(nrs.DirectionalLight(intensity=3.0), pose=nrs.look_at((2, 5, 3), (0, 0, 0)))
    vertices, faces = nrs.shapes.torus_knot(faces=6_000)
    scene.add(nrs.NaniteMesh.from_arrays(vertices, faces, progress=False))
    scene.add(nrs.TriangleMesh(vertices * 0.5 + [1.5, 0, 0], faces))
    scene.add(
        nrs.TriangleMesh(*nrs.shapes.icosphere(faces=500)),
        material=nrs.Material(base_color=(0.2, 0.4, 0.9, 0.4), alpha_mode="blend"),
    )
    scene.add(nrs.Points(rng.normal(size=(30_000, 3)), colors=rng.random((30_000, 3)), radius=1.0))
    scene.add(nrs.Lines(rng.normal(size=(200, 3)), colors=(1.0, 0.0, 0.0), width=0.03, unit="world"))
    return scene


def test_culling_changes_no_picture(backend):
    scene = crowd()
    with nrs.Renderer(*SIZE, backend=backend) as renderer:
        for step in range(3):
            pose = nrs.look_at((4 * np.sin(step), 1, 4 * np.cos(step)), (0, 0, 0))
            frames = [
                renderer.render(scene, CAMERAS["pinhole"], pose, occlusion=occlusion, shadows=shadows)
                for occlusion in (True, False)
                for shadows in (False, True)
            ]
            for other in frames[2:]:
                for name in ("depth", "instance_id", "face_id", "cluster_id", "triangle_id", "normal"):
                    np.testing.assert_array_equal(getattr(frames[0], name), getattr(other, name), name)
            np.testing.assert_array_equal(frames[0].color, frames[2].color)
            np.testing.assert_array_equal(frames[1].color, frames[3].color)
            alone = renderer.render(scene, CAMERAS["pinhole"], pose, depth_only=True)
            np.testing.assert_array_equal(alone.depth, frames[0].depth)


def test_they_throw_no_shadow():
    floor = nrs.TriangleMesh([[-3, 0, -3], [-3, 0, 3], [3, 0, 3], [3, 0, -3.0]], [[0, 1, 2], [0, 2, 3]])
    scene = nrs.Scene()
    scene.add(floor)
    scene.add(nrs.DirectionalLight(intensity=3.0), pose=nrs.look_at((0, 5, 0.1), (0, 0, 0)))
    before = rendered(scene, "pinhole", shadows=True)
    node = scene.add(
        nrs.Points(np.random.default_rng(0).uniform((-1, 0.2, -1), (1, 2.2, 1), (200, 3)), radius=3.0)
    )
    after = rendered(scene, "pinhole", shadows=True)
    floor_seen = after.instance_id == 0
    np.testing.assert_array_equal(after.color[floor_seen], before.color[floor_seen])
    assert (after.instance_id == node.instance_id).sum() > 200
    assert (after.shadow[~floor_seen & (after.depth > 0)] == 1.0).all()


def test_every_point_shows_in_its_pixel(backend):
    rng = np.random.default_rng(2)
    positions = rng.uniform(-1.5, 1.5, (300, 3))
    at, _, _ = on_screen("parallel", positions)
    scene = nrs.Scene()
    scene.add(nrs.Points(positions, radius=1e-3))
    frame = rendered(scene, "parallel", backend)
    wanted = np.zeros(SIZE[::-1], bool)
    wanted[np.floor(at[:, 1]).astype(int), np.floor(at[:, 0]).astype(int)] = True
    assert ((frame.depth > 0) != wanted).sum() <= 2  # on the line between two pixels
    assert wanted.sum() > 250


def test_many_are_culled_where_they_are_not_seen():
    rng = np.random.default_rng(4)
    scene = nrs.Scene()
    scene.add(nrs.Points(rng.uniform(-100, 100, (200_000, 3)), radius=0.05, unit="world"))
    frame = rendered(scene, "pinhole")
    assert 0 < frame.stats.clusters < 600  # of 1,563
    # One whose middle is behind the edge of the picture reaches into it.
    edge = nrs.Scene()
    width = 2.0 * np.tan(0.45) * SIZE[0] / SIZE[1]
    point = POSE[:3, 3] + POSE[:3, :3] @ np.array([0.52 * width, 0.0, -1.0])
    edge.add(nrs.Points(point[None], radius=4.0))
    assert (rendered(edge, "pinhole").depth > 0).sum() > 5


def test_they_move_and_frames_keep_what_they_show(backend):
    rng = np.random.default_rng(6)
    positions = rng.normal(size=(500, 3))
    # Lines that meet would be ties.
    pairs = np.arange(50).reshape(25, 2)
    cloud, path = nrs.Points(positions, radius=2.0), nrs.Lines(positions[:50], pairs, width=2.0)
    scene = nrs.Scene()
    scene.add(cloud)
    scene.add(path, pose=nrs.look_at((0.2, 0, 0), (0, 0, 1)))
    with nrs.Renderer(*SIZE, backend=backend) as renderer:
        before = renderer.render(scene, CAMERAS["pinhole"], POSE)
        moved = positions[:, [1, 2, 0]]
        cloud.update(moved)
        path.update(moved[:50].astype(np.float32))
        after = renderer.render(scene, CAMERAS["pinhole"], POSE)
        other = nrs.Scene()
        other.add(nrs.Points(moved, radius=2.0))
        other.add(
            nrs.Lines(moved[:50].astype(np.float32), pairs, width=2.0),
            pose=nrs.look_at((0.2, 0, 0), (0, 0, 1)),
        )
        anew = renderer.render(other, CAMERAS["pinhole"], POSE)
        for name in ("depth", "instance_id", "face_id"):
            np.testing.assert_array_equal(getattr(after, name), getattr(anew, name))
        assert (before.face_id != after.face_id).any()
        np.testing.assert_array_equal(cloud.positions, moved)
        with pytest.raises(nrs.MeshError, match=r"positions\[3\]"):
            cloud.update(np.where(np.arange(500)[:, None] == 3, np.nan, moved))
        with pytest.raises(nrs.ArgumentError, match="500"):
            cloud.update(moved[:10])
        again = renderer.render(scene, CAMERAS["pinhole"], POSE)
        np.testing.assert_array_equal(again.face_id, after.face_id)


def test_copies_and_pickles():
    scene = crowd()
    for made in (copy.deepcopy(scene), copy.copy(scene), pickle.loads(pickle.dumps(scene))):
        ours, theirs = rendered(scene, "pinhole"), rendered(made, "pinhole")
        np.testing.assert_array_equal(ours.color, theirs.color)
    cloud = scene.instances[3].mesh
    other = copy.deepcopy(cloud)
    cloud.update(cloud.positions + 10.0)
    assert np.abs(other.positions).max() < 7.0
    assert len(other) == 30_000
    lines = pickle.loads(pickle.dumps(scene.instances[4].mesh))
    assert (lines.width, lines.unit, len(lines)) == (0.03, "world", 199)
    assert "30,000 points" in repr(scene.instances[3])


def test_looks():
    scene = nrs.Scene(bg_color=(1, 1, 1))
    node = scene.add(nrs.Points(np.zeros((1, 3)), radius=20.0))
    middle = SIZE[1] // 2, SIZE[0] // 2
    assert (rendered(scene, "pinhole").color[middle] == 0).all()
    node.material = nrs.Material(base_color=(1.0, 0.0, 0.0, 0.2), alpha_mode="blend")
    assert rendered(scene, "pinhole").color[middle].tolist() == [255, 0, 0]
    with pytest.warns(nrs.UsageWarning, match="alpha counts for nothing"):
        nrs.Points(np.zeros((2, 3)), colors=[[1.0, 0, 0, 0.5], [0, 1.0, 0, 1.0]])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        one = nrs.Points(np.zeros((2, 3)), colors=(0.0, 1.0, 0.0))
    assert one.colors.shape == (2, 3)


BAD = {
    "shape": (lambda: nrs.Points([1.0, 2.0, 3.0]), nrs.ArgumentError, r"positions: expected shape \(N, 3\)"),
    "none": (lambda: nrs.Points(np.zeros((0, 3))), nrs.MeshError, "positions: there are none"),
    "dtype": (lambda: nrs.Points(np.zeros((2, 3), int)), nrs.DtypeError, "positions: .*floating-point"),
    "finite": (lambda: nrs.Points([[0, 0, 0], [np.inf, 0, 0]]), nrs.MeshError, r"positions\[1\]"),
    "radius": (lambda: nrs.Points(np.eye(3), radius=0.0), nrs.ArgumentError, "radius: must be positive"),
    "nan": (lambda: nrs.Points(np.eye(3), radius=np.nan), nrs.ArgumentError, "radius: must be positive"),
    "unit": (lambda: nrs.Points(np.eye(3), unit="inches"), nrs.ArgumentError, "unit: must be"),
    "colors": (lambda: nrs.Points(np.eye(3), colors=np.ones((2, 3))), nrs.ArgumentError, "colors"),
    "row": (lambda: nrs.Lines(np.eye(3), [[0, 1], [1, 3]]), nrs.MeshError, r"segments\[1\]: \[1, 3\]"),
    "negative": (lambda: nrs.Lines(np.eye(3), [[0, -1]]), nrs.MeshError, r"segments\[0\]"),
    "pairs": (
        lambda: nrs.Lines(np.eye(3), [0, 1, 2]),
        nrs.ArgumentError,
        r"segments: expected shape \(M, 2\)",
    ),
    "whole": (lambda: nrs.Lines(np.eye(3), [[0.0, 1.0]]), nrs.DtypeError, "segments: expected an integer"),
    "one": (lambda: nrs.Lines(np.zeros((1, 3))), nrs.MeshError, "two ends"),
    "width": (lambda: nrs.Lines(np.eye(3), width=-1.0), nrs.ArgumentError, "width: must be positive"),
    "word": (lambda: nrs.Points(np.eye(3), colors="red"), nrs.DtypeError, "colors: expected numbers"),
    "bytes": (lambda: nrs.Points(np.eye(3), colors=(300, 0, 0)), nrs.ArgumentError, "colors: whole numbers"),
    "wide": (lambda: nrs.Points(np.eye(3), radius=1e30), nrs.ArgumentError, "at most 1e\\+06"),
    "cloud": (lambda: nrs.Points.from_trimesh(1), nrs.DtypeError, "cloud: expected a trimesh.PointCloud"),
    "path": (lambda: nrs.Lines.from_trimesh(1), nrs.DtypeError, "path: expected a trimesh.path.Path3D"),
    "fewer": (
        lambda: nrs.Points(np.eye(3)).update(np.zeros((4, 3))),
        nrs.ArgumentError,
        "positions: expected 3",
    ),
    "item": (lambda: nrs.Scene().add(3), nrs.DtypeError, "expected a mesh, points, lines or a light"),
    "name": (lambda: nrs.Points(np.eye(3), point_size=3), TypeError, "radius="),
    "edges": (lambda: nrs.Lines(np.eye(3), edges=[[0, 1]]), TypeError, "segments="),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_refused(name):
    make, error, message = BAD[name]
    with pytest.raises(error, match=message):
        make()


def test_trimesh_has_clouds_and_paths():
    import trimesh

    rng = np.random.default_rng(9)
    cloud = trimesh.PointCloud(rng.random((100, 3)), colors=rng.integers(0, 255, (100, 4)).astype(np.uint8))
    path = trimesh.path.Path3D(**trimesh.path.exchange.misc.lines_to_path(rng.random((6, 2, 3))))
    scene = nrs.Scene()
    points, lines = scene.add(cloud), scene.add(path)
    assert len(points.mesh) == 100
    assert len(lines.mesh) == 6
    np.testing.assert_array_equal(points.mesh.colors, cloud.colors[:, :3])
    both = trimesh.Scene([cloud, path, trimesh.creation.box()])
    loaded = nrs.load_scene(both)
    assert sorted(type(own[0].mesh).__name__ for own in loaded.instances.values()) == [
        "Lines",
        "Points",
        "TriangleMesh",
    ]


def test_gltf_has_points_and_lines(tmp_path):
    rng = np.random.default_rng(10)
    positions = rng.random((6, 3)).astype(np.float32)
    document = Document()
    place, painted = document.accessor(positions), document.accessor(rng.random((6, 3)).astype(np.float32))
    order = document.accessor(np.array([5, 4, 0, 1], np.uint16))
    look = document.row("materials", pbrMetallicRoughness={"baseColorFactor": [0.5, 0.5, 0.5, 1.0]})
    row = {"attributes": {"POSITION": place, "COLOR_0": painted}, "material": look}
    modes = {mode: {**row, "indices": order, "mode": mode} for mode in range(4)}
    mesh = document.row("meshes", primitives=[*modes.values(), {**row, "mode": 0}])
    document.row("nodes", mesh=mesh, translation=[1, 0, 0], name="all")
    document.json["scenes"] = [{"nodes": [0]}]
    path = document.save(tmp_path / "a.glb")
    loaded = nrs.load_scene(path)
    points, pairs, loop, strip, every = (node.mesh for node in loaded.instances["all"])
    np.testing.assert_array_equal(points.positions, positions[[5, 4, 0, 1]])
    np.testing.assert_array_equal(pairs.segments, [[5, 4], [0, 1]])
    np.testing.assert_array_equal(loop.segments, [[5, 4], [4, 0], [0, 1], [1, 5]])
    np.testing.assert_array_equal(strip.segments, [[5, 4], [4, 0], [0, 1]])
    assert len(every) == 6
    assert loaded.instances["all"][0].pose[0, 3] == 1.0
    with pytest.raises(nrs.MeshError, match=r"no triangles in it.*points and lines"):
        nrs.NaniteMesh.from_file(path)


@pytest.mark.parametrize("kind", ["points", "large points", "lines", "loop", "strip"])
def test_pyrenders_points_and_lines(kind):
    pyrender = picture.import_pyrender()
    size = 320, 240
    rng = np.random.default_rng(12)
    count = 40 if "points" in kind else 12
    positions = rng.uniform(-1.2, 1.2, (count, 3)).astype(np.float32)
    colors = rng.random((count, 3)).astype(np.float32)
    mode = {"lines": 1, "loop": 2, "strip": 3}.get(kind, 0)
    point_size = 5.0 if kind == "large points" else 1.0
    script = pyrender.Scene(bg_color=(1.0, 1.0, 1.0))
    script.add(pyrender.Mesh([pyrender.Primitive(positions, color_0=colors, mode=mode)]))
    script.add(pyrender.PerspectiveCamera(yfov=0.9, znear=0.5), pose=POSE)
    theirs = picture._offscreen(*size)
    theirs.point_size = point_size
    try:
        color, depth = theirs.render(script, flags=pyrender.RenderFlags.FLAT)
    finally:
        theirs.point_size = 1.0
    with nrs.Renderer(*size, backend="cpu") as renderer:
        # Flat colours are written as they are there.
        view = nrs.from_pyrender(script, viewport=size, point_size=point_size)
        frame = renderer.render(*view, transfer="linear")
    ours, other = frame.depth > 0, depth > 0
    if kind == "large points":
        # Squares there, discs here.
        assert 0.7 < (ours & other).sum() / other.sum() < 0.95
        assert (ours & ~other).mean() < 1e-3
    else:
        # On lines a pixel beside may be chosen.
        shared = (ours & other).sum() / (ours | other).sum()
        assert shared > (0.9 if kind == "points" else 0.55), shared
    both = ours & other
    # A line is as near as what of it lies within half its width.
    near = np.abs(frame.depth[both] / depth[both] - 1.0) < (2e-3 if mode == 0 else 2e-2)
    assert near.mean() > 0.95
    assert (np.abs(frame.color[both][near].astype(int) - color[both][near]).max(axis=-1) <= 3).mean() > 0.9


PLY = """ply
format ascii 1.0
element vertex 5
property float x
property float y
property float z
property uchar red
property uchar green
property uchar blue
property float intensity
element edge 2
property int vertex1
property int vertex2
end_header
0 0 0 255 0 0 0.5
1 0 0 0 255 0 0.5
nan 0 0 9 9 9 0.5
0 1 0 0 0 255 0.5
0 0 1 255 255 255 0.5
0 1
3 {last}
"""


def test_ply_without_faces_is_points(tmp_path):
    path = tmp_path / "cloud.ply"
    path.write_text(PLY.format(last=4))
    with pytest.warns(UserWarning, match="1 points that are not finite.*intensity"):
        loaded = nrs.load_scene(path)
    points, edges = (node.mesh for node in loaded.instances["points"])
    np.testing.assert_array_equal(points.positions, [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    np.testing.assert_array_equal(points.colors[2], [0, 0, 255])
    np.testing.assert_array_equal(edges.segments, [[0, 1], [2, 3]])
    with nrs.Renderer(64, 64, backend="cpu") as renderer:
        frame = renderer.render(*loaded)
    assert set(np.unique(frame.instance_id)) == {-1, 0, 1}
    with pytest.raises(nrs.MeshError, match="no triangles in it"):
        nrs.NaniteMesh.from_file(path)
    path.write_text(PLY.format(last=5))
    with pytest.raises(nrs.MeshError, match=r"edge\[1\] refers to none of the 5 vertices"):
        nrs.load_scene(path)


def test_trimeshs_own_clouds_come_through_files(tmp_path):
    import trimesh

    rng = np.random.default_rng(3)
    cloud = trimesh.PointCloud(rng.random((50, 3)), colors=rng.integers(0, 255, (50, 4)).astype(np.uint8))
    cloud.export(tmp_path / "a.ply")
    (node,) = nrs.load_scene(tmp_path / "a.ply").instances["points"]
    np.testing.assert_allclose(node.mesh.positions, cloud.vertices, atol=1e-6)
    np.testing.assert_array_equal(node.mesh.colors, cloud.colors[:, :3])
    trimesh.Scene([cloud]).export(tmp_path / "a.glb")
    ((node,),) = nrs.load_scene(tmp_path / "a.glb").instances.values()
    np.testing.assert_allclose(node.mesh.positions, cloud.vertices, atol=1e-6)


@every_camera
def test_lines_that_point_at_the_camera_show_their_near_end(camera, backend):
    """A post seen from above, through a plate: its top is in front."""
    pose = nrs.look_at((0, 0, 6), (0, 0, 0))
    for ends in ([[0, 0, 0], [0, 0, 1.0]], [[0, 0, 1.0], [0, 0, 0]]):
        scene = nrs.Scene(ambient_light=(1, 1, 1))
        colors = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])[:: 1 if ends[0][2] == 0 else -1]
        post = scene.add(nrs.Lines(ends, colors=colors, width=12.0))
        plate = [[-1, -1, 0.5], [1, -1, 0.5], [1, 1, 0.5], [-1, 1, 0.5]]
        scene.add(nrs.TriangleMesh(plate, [[0, 1, 2], [0, 2, 3]]))
        with nrs.Renderer(*SIZE, backend=backend) as renderer:
            frame = renderer.render(scene, CAMERAS[camera], pose, shading="gltf")
        shown = frame.instance_id == post.instance_id
        assert shown.sum() > 100
        np.testing.assert_allclose(frame.depth[shown], 5.0, rtol=1e-6)
        np.testing.assert_allclose(frame.linear[shown], [[0.0, 0.0, 1.0]] * shown.sum(), atol=1e-6)


@pytest.mark.parametrize("far", [1e3, 1e6, 1e9, 1e12])
def test_endless_axes_go_where_near_ones_do(far, backend):
    axes = np.concatenate([np.eye(3) * -1.0, np.eye(3)])
    pairs = [[0, 3], [1, 4], [2, 5]]
    camera, pose = nrs.PerspectiveCamera(yfov=0.8, znear=0.05), nrs.look_at((3, 2, 4), (0.3, 0.2, 0.1))
    frames = []
    for reach in (100.0, far):
        scene = nrs.Scene()
        scene.add(nrs.Lines(axes * reach, pairs, width=3.0))
        with nrs.Renderer(*SIZE, backend=backend) as renderer:
            frames.append(renderer.render(scene, camera, pose))
    near, endless = frames
    same = near.face_id == endless.face_id
    assert (near.face_id >= 0).sum() > 400
    assert same.mean() > 0.99
    shown = same & (near.depth > 0)
    np.testing.assert_allclose(endless.depth[shown], near.depth[shown], rtol=1e-3)


def test_frozen_views_pick_points():
    cloud = nrs.Points(np.random.default_rng(1).uniform(-1, 1, (50, 3)), radius=5.0)
    scene = nrs.Scene(ambient_light=(1, 1, 1))
    scene.add(cloud)
    scene.add(nrs.TriangleMesh(*nrs.shapes.icosphere(faces=80)))
    for shown in (cloud, scene):
        with nrs.Viewer(shown, width=80, height=60) as viewer:
            y, x = np.argwhere(viewer.frame().instance_id == 0)[20].tolist()
            before = viewer.pick(x, y)
            viewer.freeze()
            after = viewer.pick(x, y)
            assert after is not None
            assert (after.instance_id, after.triangle_id) == (before.instance_id, before.triangle_id)
            assert viewer.image().any()


@pytest.mark.parametrize(
    "shown",
    [
        nrs.Points([[0.0, 0, 0]]),
        nrs.Points([[1.0, 1, 1]] * 5, radius=0.2, unit="world"),
        nrs.Points([[0.0, 0, 0], [1, 0, 0]], radius=2.0, unit="world"),
        nrs.Lines([[7.0, 1, 1], [7.0, 1, 1]]),
    ],
    ids=["one", "equal", "large", "no length"],
)
def test_small_and_large_ones_are_framed(shown):
    with nrs.Viewer(shown, width=80, height=60) as viewer:
        covered = (viewer.frame().depth > 0).mean()
    assert 0.0 < covered < 0.8
    assert shown._repr_png_()
    low, high = shown.bounds
    reach = getattr(shown, "radius", 0.0) if shown.unit == "world" else 0.0
    np.testing.assert_allclose([low, high], [shown.positions.min(0) - reach, shown.positions.max(0) + reach])
