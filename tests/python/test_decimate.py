"""One level at once: decimate(), and what simplify() makes of it, held against fast-simplification and libigl."""

from __future__ import annotations

import pickle

import fast_simplification
import numpy as np
import pytest
import trimesh

import nanite_rs as nrs

from .oracles import data, distance, subjects, topology

BEST, FAST = "best", "fast"


def rms(source: data.Mesh, vertices: np.ndarray, faces: np.ndarray) -> float:
    """Two-sided, in 1e-4 of the diagonal; samples by area, as vertices are elsewhere than faces in the mean."""

    def squares(a: trimesh.Trimesh, b: trimesh.Trimesh) -> np.ndarray:
        points, _ = trimesh.sample.sample_surface(a, 20_000, seed=1)
        return distance.to_surface(points, b.vertices, b.faces) ** 2

    given, made = (
        trimesh.Trimesh(v, f, process=False) for v, f in ((source.vertices, source.faces), (vertices, faces))
    )
    mean = (squares(given, made).mean() + squares(made, given).mean()) / 2
    return float(np.sqrt(mean)) / source.diagonal * 1e4


def border(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Positions at edges of one face, in order."""
    edges = np.sort(topology.half_edges(topology.by_position(vertices, faces)), axis=1)
    edges, counts = np.unique(edges, axis=0, return_counts=True)
    return np.unique(np.asarray(vertices)[np.unique(edges[counts == 1])], axis=0)


def large_grid() -> tuple[np.ndarray, np.ndarray]:
    """A hilly field that takes several blocks, with a border."""
    vertices, faces = subjects.grid(220, 220)
    x, _, z = vertices.T
    vertices[:, 1] = 0.2 * np.sin(5 * x) * np.cos(4 * z) + 0.02 * np.sin(31 * x + 11 * z)
    return vertices.astype(np.float32), faces


# ------------------------------------------------------------------------------- how near, and how many


@pytest.mark.parametrize("name", ["sphere", "knot", "bunny", "horse", "turbine", "armadillo"])
@pytest.mark.parametrize("removed", [0.5, 0.9])
def test_is_nearer_than_fast_simplification(name: str, removed: float) -> None:
    source = subjects.subject(name)
    scale = 100 / source.diagonal
    target = int(len(source.faces) * (1 - removed))
    scaled, faces = (source.vertices * scale).astype(np.float32), source.faces.astype(np.int32)
    v, f = fast_simplification.simplify(scaled, faces, target_count=target)
    theirs = rms(source, v / scale, f)
    found = {}
    for quality, most in ((BEST, 0.85), (FAST, 1.5)):
        made = nrs.decimate((source.vertices, source.faces), len(f), quality=quality)
        assert len(f) - max(2, 0.005 * len(f)) <= len(made) <= len(f)
        found[quality] = rms(source, made.vertices, made.faces)
        assert found[quality] < most * theirs
    print(f"{name} −{removed:.0%}: {len(f)} faces, rms {found}; fast-simplification {theirs:.3g}")


@pytest.mark.parametrize("quality", [BEST, FAST])
@pytest.mark.parametrize("target", [199_999, 90_000, 30_001, 1_000, 20])
def test_meets_its_target(quality: str, target: int) -> None:
    vertices, faces = nrs.shapes.displaced_icosphere(faces=200_000)
    made = nrs.decimate((vertices, faces), target, quality=quality)
    assert target - max(2, 0.005 * target) <= len(made) <= target
    assert made.to_trimesh().is_watertight
    assert topology.unbalanced_edges(topology.by_position(made.vertices, made.faces)) == 0
    assert np.abs(np.linalg.norm(made.normals, axis=1) - 1).max() < 1e-5


def test_borders_of_blocks_do_not_show() -> None:
    """Nowhere are triangles denser than one queue for all would leave them."""
    vertices, faces = nrs.shapes.icosphere(faces=300_000)
    made = nrs.decimate((vertices, faces), 10_000)
    areas = made.to_trimesh().area_faces
    assert areas.min() > 0.02 * areas.mean()
    assert areas.max() < 8 * areas.mean()


def test_what_is_flat_goes_first() -> None:
    """A plate with a bump in a corner, over many blocks."""
    vertices, faces = subjects.grid(300, 300)
    x, _, z = vertices.T
    at = np.hypot(x - 0.6, z - 0.6)
    vertices[:, 1] = np.where(at < 0.3, 0.1 * np.cos(np.pi / 0.6 * at) ** 2, 0.0)
    made = nrs.decimate((vertices, faces), 5_000)
    centers = made.vertices[made.faces].mean(axis=1)
    near = np.hypot(centers[:, 0] - 0.6, centers[:, 2] - 0.6) < 0.32
    assert near.mean() > 0.9


def test_small_parts_go_as_a_whole() -> None:
    ball, faces = nrs.shapes.icosphere(faces=20_000)
    crumb, sides = nrs.shapes.icosphere(faces=20)
    shifts = np.random.default_rng(3).normal(size=(50, 1, 3))
    shifts *= 1.3 / np.linalg.norm(shifts, axis=2, keepdims=True)
    vertices = np.concatenate([ball, (crumb * 0.001 + shifts).reshape(-1, 3)]).astype(np.float32)
    sides = (sides + (len(ball) + len(crumb) * np.arange(50))[:, None, None]).reshape(-1, 3)
    made = nrs.decimate((vertices, np.concatenate([faces, sides])), 100)
    assert len(made) <= 100


# ---------------------------------------------------------------------------------------- what it carries


@pytest.mark.parametrize("quality", [BEST, FAST])
def test_what_is_linear_stays_so(quality: str) -> None:
    vertices, faces = nrs.shapes.displaced_icosphere(faces=100_000)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    unit = (vertices - low) / (high - low)
    given = {
        "colors": unit,
        "uvs": [unit[:, :2], 3 * unit[:, 1:]],
        "channels": {"place": vertices, "side": vertices[:, 2] > 0},
    }
    made = nrs.decimate((vertices, faces), 10_000, quality=quality, **given)
    assert 9_950 <= len(made) <= 10_000
    at = (made.vertices - low) / (high - low)
    assert made.colors.dtype == np.uint8
    assert (made.colors[:, 3] == 255).all()
    assert made.fine_colors.dtype == np.float32
    for found, expected in [
        (made.fine_colors[:, :3], at),
        (made.uvs[0], at[:, :2]),
        (made.uvs[1] / 3, at[:, 1:]),
        ((made.channels["place"] - low) / (high - low), at),
    ]:
        off = np.abs(found - expected)
        assert off.mean() < 0.003
        assert np.quantile(off, 0.99) < 0.02
    # Labels are never blended.
    side = made.channels["side"]
    assert side.dtype == bool
    assert (side == (made.vertices[:, 2] > 0))[np.abs(made.vertices[:, 2]) > 0.05].all()


def test_materials_and_seams_stay() -> None:
    vertices, faces = nrs.shapes.displaced_icosphere(faces=80_000)
    material = np.where(vertices[faces].mean(axis=1)[:, 0] > 0, 7, -2)
    made = nrs.decimate((vertices, faces), 4_000, face_materials=material)
    assert 3_980 <= len(made) <= 4_000
    assert sorted(set(made.face_materials.tolist())) == [-2, 7]
    centers = made.vertices[made.faces].mean(axis=1)
    right = made.face_materials == np.where(centers[:, 0] > 0, 7, -2)
    assert right[np.abs(centers[:, 0]) > 0.1].all()
    assert topology.unbalanced_edges(topology.by_position(made.vertices, made.faces)) == 0
    # Two sheets of UV that meet at a seam.
    left, right = material == -2, material == 7
    split = np.concatenate([faces[left], faces[right] + len(vertices)])
    both = np.concatenate([vertices, vertices])
    uv = np.concatenate([vertices[:, :2] * 0.1, vertices[:, :2] * 0.1 + 0.5])
    seamed = nrs.decimate((both, split), 4_000, uvs=uv)
    closed = topology.by_position(seamed.vertices, seamed.faces)
    assert topology.unbalanced_edges(closed) == 0
    sheet = seamed.uvs[0][:, 0] > 0.25
    assert (sheet[seamed.faces] == sheet[seamed.faces[:, :1]]).all()


def test_normals_that_were_given_come_back() -> None:
    ball = trimesh.creation.icosphere(subdivisions=6)
    made = nrs.decimate((ball.vertices, ball.faces), 2_000, normals=ball.vertices)
    unit = made.vertices / np.linalg.norm(made.vertices, axis=1, keepdims=True)
    assert (made.normals * unit).sum(axis=1).min() > np.cos(0.05)


def test_vertices_that_stay_keep_what_they_had() -> None:
    vertices, faces = nrs.shapes.icosphere(faces=5_000)
    number = np.arange(len(vertices))
    value = np.random.default_rng(0).random(len(vertices))
    same = nrs.decimate((vertices, faces), len(faces), channels={"n": number, "x": value.astype(np.float32)})
    assert len(same) == len(faces)
    n = same.channels["n"]
    np.testing.assert_array_equal(same.vertices, np.asarray(vertices, np.float32)[n])
    np.testing.assert_array_equal(same.channels["x"], value.astype(np.float32)[n])
    np.testing.assert_array_equal(np.sort(n), number)


def test_far_from_the_origin() -> None:
    vertices, faces = nrs.shapes.displaced_icosphere(faces=20_000)
    shift = np.array([4.5e6, 5.2e6, 120.0])
    away = vertices + shift
    made = nrs.decimate((away, faces), 2_000)
    assert made.vertices.dtype == np.float64
    near = nrs.decimate((vertices, faces), 2_000)
    found = distance.one_sided((made.vertices - shift, made.faces), (vertices, faces), 5_000)
    expected = distance.one_sided((near.vertices, near.faces), (vertices, faces), 5_000)
    assert found.max() < 2 * expected.max()


# ------------------------------------------------------------------------------------------------- options


@pytest.mark.parametrize("quality", [BEST, FAST])
def test_does_not_depend_on_threads(quality: str) -> None:
    vertices, faces = nrs.shapes.displaced_icosphere(faces=150_000)
    made = [
        nrs.decimate((vertices, faces), 20_000, quality=quality, colors=np.abs(vertices) / 2, threads=threads)
        for threads in (1, 2, 5)
    ]
    for other in made[1:]:
        for name in ("vertices", "faces", "normals", "colors"):
            np.testing.assert_array_equal(getattr(made[0], name), getattr(other, name))


@pytest.mark.parametrize("quality", [BEST, FAST])
def test_the_border_stays(quality: str) -> None:
    vertices, faces = large_grid()
    expected = border(vertices, faces)
    made = nrs.decimate((vertices, faces), 8_000, quality=quality, preserve_border=True)
    assert 7_960 <= len(made) <= 8_000
    np.testing.assert_array_equal(border(made.vertices, made.faces), expected)
    free = nrs.decimate((vertices, faces), 8_000, quality=quality)
    assert len(border(free.vertices, free.faces)) < len(expected)


@pytest.mark.parametrize("steps", [8, 90])
def test_lossless_is_without_loss(steps: int) -> None:
    vertices, faces = subjects.cube(steps)
    made = nrs.decimate((vertices, faces), lossless=True)
    # Each side needs two triangles.
    assert 12 <= len(made) <= 60
    assert made.to_trimesh().is_watertight
    there = distance.one_sided((made.vertices, made.faces), (vertices, faces), 20_000)
    back = distance.one_sided((vertices, faces), (made.vertices, made.faces), 20_000)
    assert max(there.max(), back.max()) < 1e-6
    assert made.to_trimesh().volume == pytest.approx(8.0, abs=1e-5)


def test_lossless_keeps_what_is_carried() -> None:
    vertices, faces = subjects.grid(60, 60)
    # A step of colour along x = 0.
    colors = np.where(vertices[:, :1] > 0, [255, 0, 0], [0, 0, 255]).astype(np.uint8)
    made = nrs.decimate((vertices, faces), lossless=True, colors=colors)
    assert len(made) < 0.2 * len(faces)
    middle = np.linspace(-0.99, 0.99, 200)
    for x in (-0.5, -0.001, 1 / 29, 0.5):
        points = np.stack([np.full(200, x), np.zeros(200), middle], 1)
        _, nearest = distance.Surface(made.vertices, made.faces).nearest(points)
        corners = made.faces[nearest]
        at = trimesh.triangles.points_to_barycentric(made.vertices[corners].astype(np.float64), points)
        found = (made.colors[corners][:, :, 0] * at).sum(axis=1)
        wide = 2 / 60
        expected = 255 * np.clip(x / wide, 0, 1)
        assert np.abs(found - expected).max() < 2.5


def test_a_curved_surface_has_nothing_to_lose() -> None:
    vertices, faces = nrs.shapes.displaced_icosphere(faces=20_000)
    assert len(nrs.decimate((vertices, faces), lossless=True)) == len(faces)
    _, theirs = nrs.simplify(vertices, faces, 0.9, lossless=True)
    assert len(theirs) == len(faces)


def test_proof_bounds_the_distance() -> None:
    vertices, faces = nrs.shapes.displaced_icosphere(faces=20_000)
    made = nrs.decimate((vertices, faces), 2_000)
    assert made.error == np.inf
    proven = nrs.decimate((vertices, faces), 2_000, proof=True)
    np.testing.assert_array_equal(made.vertices, proven.vertices)
    there = distance.one_sided((made.vertices, made.faces), (vertices, faces), 50_000)
    back = distance.one_sided((vertices, faces), (made.vertices, made.faces), 50_000)
    found = max(there.max(), back.max())
    assert found <= proven.error < 1.2 * found


def test_progress_is_told_and_stops_it() -> None:
    vertices, faces = nrs.shapes.displaced_icosphere(faces=300_000)
    seen: list[tuple[int, int]] = []
    nrs.decimate((vertices, faces), 10_000, progress=lambda done, total: seen.append((done, total)))
    assert seen[-1][0] <= seen[-1][1]
    assert [done for done, _ in seen] == sorted(done for done, _ in seen)

    class Enough(Exception):
        pass

    def stop(done: int, total: int) -> None:
        raise Enough

    with pytest.raises(Enough):
        nrs.decimate((vertices, faces), 10_000, progress=stop)


# ------------------------------------------------------------------------------------------------- meshes


def test_takes_what_has_a_mesh(tmp_path) -> None:
    ball = trimesh.creation.icosphere(subdivisions=4)
    ball.visual.vertex_colors = np.full((len(ball.vertices), 4), [200, 100, 50, 255], np.uint8)
    ball.export(tmp_path / "ball.ply")
    expected = nrs.decimate(ball, 500)
    assert (expected.colors == [200, 100, 50, 255]).all()
    for mesh in (tmp_path / "ball.ply", str(tmp_path / "ball.ply"), trimesh.Scene([ball])):
        found = nrs.decimate(mesh, 500)
        assert len(found) == len(expected)
        np.testing.assert_array_equal(found.colors, expected.colors)
    again = nrs.decimate(expected, 100)
    assert len(again) == 100
    assert again.to_trimesh().is_watertight
    assert pickle.loads(pickle.dumps(again.vertices)).shape == again.vertices.shape
    assert repr(again).startswith("Cut(100 faces")


def test_takes_pyvista_and_meshio() -> None:
    pyvista = pytest.importorskip("pyvista")
    meshio = pytest.importorskip("meshio")
    vertices, faces = nrs.shapes.icosphere(faces=5_000)
    cells = np.column_stack([np.full(len(faces), 3), faces]).ravel()
    for mesh in (pyvista.PolyData(vertices, cells), meshio.Mesh(vertices, [("triangle", faces)])):
        assert len(nrs.decimate(mesh, 500)) == 500


SPHERE = nrs.shapes.icosphere(faces=320)


@pytest.mark.parametrize(
    ("arguments", "named", "kind", "message"),
    [
        ((SPHERE,), {}, nrs.ArgumentError, "exactly one of target_faces and target_reduction"),
        ((SPHERE, 10), {"target_reduction": 0.5}, nrs.ArgumentError, "exactly one of"),
        ((SPHERE, 10), {"lossless": True}, nrs.ArgumentError, "lossless: goes without"),
        ((SPHERE, 0), {}, nrs.ArgumentError, "target_faces: must be 1 or more"),
        ((SPHERE, 0.9), {}, nrs.DtypeError, "target_faces: expected an integer"),
        ((SPHERE,), {"target_reduction": 90}, nrs.ArgumentError, "90 % is 0.9"),
        ((SPHERE,), {"target_reduction": "0.9"}, nrs.DtypeError, "target_reduction"),
        ((SPHERE, 10), {"quality": "fat"}, nrs.ArgumentError, "quality"),
        ((SPHERE, 10), {"normal_weight": -1.0}, nrs.ArgumentError, "normal_weight"),
        ((SPHERE, 10), {"threads": -1}, nrs.ArgumentError, "threads"),
        ((SPHERE, 10), {"preserve_border": 1.5}, nrs.DtypeError, "preserve_border"),
        ((SPHERE, 10), {"proof": "yes"}, nrs.DtypeError, "proof"),
        ((SPHERE, 10), {"uvs": np.zeros((3, 2))}, nrs.ArgumentError, "uvs"),
        ((SPHERE, 10), {"colors": np.zeros((len(SPHERE[0]), 3), int)}, nrs.DtypeError, "colors"),
        ((SPHERE, 10), {"channels": {"x": [1, 2]}}, nrs.ArgumentError, "channels"),
        (((SPHERE[0], SPHERE[1] + 1), 10), {}, nrs.MeshError, "faces"),
        (((SPHERE[0] * np.nan, SPHERE[1]), 10), {}, nrs.MeshError, "vertices"),
        (((SPHERE[0].T, SPHERE[1]), 10), {}, nrs.ArgumentError, "vertices"),
        (((SPHERE[0], SPHERE[1][:0]), 10), {}, nrs.MeshError, "face"),
        (((SPHERE[0], np.zeros((4, 3), int)), 10), {}, nrs.MeshError, "no face is left"),
        ((7, 10), {}, nrs.DtypeError, "mesh: expected"),
        (("missing.ply", 10), {}, nrs.MissingFileError, "missing.ply"),
        (("mesh.nanite", 10), {}, nrs.ArgumentError, "NaniteMesh.open"),
        ((trimesh.creation.box(), 4), {"uvs": np.zeros((8, 2))}, nrs.ArgumentError, "brings its own"),
    ],
)
def test_what_is_wrong_is_named(arguments, named, kind, message) -> None:
    with pytest.raises(kind, match=message):
        nrs.decimate(*arguments, **named)


def test_a_mesh_of_all_levels_is_cut() -> None:
    mesh = nrs.NaniteMesh.from_arrays(*SPHERE)
    with pytest.raises(nrs.DtypeError, match=r"mesh\.cut"):
        nrs.decimate(mesh, 10)
    with pytest.raises(TypeError, match="target_faces=5000"):
        nrs.decimate(SPHERE, faces=10)


@pytest.mark.parametrize("quality", [BEST, FAST])
@pytest.mark.parametrize("name", ["one", "two", "needle", "same", "soup", "fan"])
def test_odd_meshes(name: str, quality: str) -> None:
    triangle = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
    rng = np.random.default_rng(1)
    around = np.linspace(0, 2 * np.pi, 50, endpoint=False)
    meshes = {
        "one": (triangle, [[0, 1, 2]]),
        "two": (triangle, [[0, 1, 2], [0, 2, 1]]),
        "needle": (triangle * [1, 1e-30, 1], [[0, 1, 2]]),
        "same": (np.concatenate([triangle, triangle]), [[0, 1, 2], [3, 4, 5], [0, 0, 1]]),
        "soup": (rng.random((3_000, 3)), np.arange(3_000).reshape(-1, 3)),
        "fan": (
            np.vstack([[0, 0, 1], np.stack([np.cos(around), np.sin(around), 0 * around], 1)]),
            [[0, i + 1, (i + 1) % 50 + 1] for i in range(50)],
        ),
    }
    vertices, faces = meshes[name]
    for target in (1, 10):
        made = nrs.decimate((vertices, faces), target, quality=quality)
        assert 1 <= len(made) <= len(faces)
        assert made.faces.max() < len(made.vertices)
        assert np.isfinite(made.vertices).all()


# ------------------------------------------------------------------------------- beside fast-simplification


def test_simplify_keeps_borders_and_loses_nothing_as_asked() -> None:
    vertices, faces = large_grid()
    v, f = nrs.simplify(vertices, faces, 0.9, preserve_border=True)
    np.testing.assert_array_equal(border(v, f), border(vertices, faces))
    assert len(f) <= 0.1 * len(faces) + 1
    box, sides = subjects.cube(20)
    _, f = nrs.simplify(box, sides, lossless=True)
    assert len(f) <= 60
    with pytest.raises(nrs.ArgumentError, match="NaniteMesh keeps all levels"):
        nrs.simplify(vertices, faces, 0.5, return_collapses=True)
    with pytest.raises(nrs.DtypeError, match="lossless"):
        nrs.simplify(vertices, faces, 0.5, lossless=2.5)
