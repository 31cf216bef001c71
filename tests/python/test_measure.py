"""Distances against libigl, brute force and closed forms; bounds against dense samples."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

import nanite_rs as nrs
from nanite_rs.measure import closest_points, surface_distance
from oracles import data, distance


def square(size: float = 1.0, z: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    vertices = np.array([[0, 0, z], [size, 0, z], [size, size, z], [0, size, z]], np.float64)
    return vertices, np.array([[0, 1, 2], [0, 2, 3]])


def spikes(count: int, height: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Thin, tall pyramids on the unit square."""
    rng = np.random.default_rng(seed)
    base, faces = square()
    vertices, all_faces = [base], [faces]
    for i in range(count):
        x, y = rng.uniform(0.1, 0.9, 2)
        r = rng.uniform(1e-4, 1e-3)
        tip = height * rng.uniform(0.5, 1.0)
        vertices.append(np.array([[x - r, y - r, 0], [x + r, y - r, 0], [x, y + r, 0], [x, y, tip]]))
        all_faces.append(np.array([[0, 1, 3], [1, 2, 3], [2, 0, 3]]) + 4 + 4 * i)
    return np.concatenate(vertices), np.concatenate(all_faces)


def soup(seed: int, count: int, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of all shapes, slivers, segments and points among them."""
    rng = np.random.default_rng(seed)
    t = rng.normal(size=(count, 1, 3)) + size * rng.normal(size=(count, 3, 3))
    kind = rng.integers(0, 6, count)
    t[kind == 0, 2] = t[kind == 0, 0]
    t[kind == 1] = t[kind == 1][:, :1]
    t[kind == 2, 2] = (t[kind == 2, 0] + t[kind == 2, 1]) / 2 + 1e-9
    return t.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)


def brute_force(points: np.ndarray, mesh: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Each point against each triangle, by trimesh."""
    triangles = mesh[0][mesh[1]]
    out = np.full(len(points), np.inf)
    for t in triangles:
        q = trimesh.triangles.closest_point(np.broadcast_to(t, (len(points), 3, 3)), points)
        out = np.minimum(out, np.linalg.norm(points - q, axis=1))
    return out


def dense(mesh: tuple[np.ndarray, np.ndarray], steps: int) -> np.ndarray:
    """Points of every face on a fine grid, its edges and corners included."""
    i, j = np.meshgrid(np.arange(steps + 1), np.arange(steps + 1))
    inside = i + j <= steps
    u, v = (i[inside] / steps)[None, :, None], (j[inside] / steps)[None, :, None]
    t = mesh[0][mesh[1]].astype(np.float64)[:, :, None]
    return (t[:, 0] + u * (t[:, 1] - t[:, 0]) + v * (t[:, 2] - t[:, 0])).reshape(-1, 3)


def check_closest(points: np.ndarray, mesh: tuple[np.ndarray, np.ndarray], tolerance: float = 1e-12) -> None:
    """Agrees with libigl, and says where the nearest point lies."""
    found = closest_points(points, mesh)
    expected = distance.to_surface(points, *mesh)
    size = max(float(np.abs(mesh[0]).max()), float(np.abs(points).max()))
    # libigl gives the square, which loses half the digits near zero.
    np.testing.assert_allclose(found.distances, expected, rtol=1e-9, atol=1e-8 * size)
    np.testing.assert_allclose(
        np.linalg.norm(points - found.points, axis=1), found.distances, rtol=1e-9, atol=tolerance * size
    )
    # Each lies on its face: barycentric coordinates are not negative and give the point. Slivers aside.
    t = mesh[0][mesh[1][found.faces]]
    u, v, w = t[:, 1] - t[:, 0], t[:, 2] - t[:, 0], found.points - t[:, 0]
    uu, uv, vv, wu, wv = ((x * y).sum(axis=1) for x, y in ((u, u), (u, v), (v, v), (w, u), (w, v)))
    det = uu * vv - uv * uv
    good = det > 1e-4 * uu * vv
    assert good.mean() > 0.9
    s, r = ((vv * wu - uv * wv)[good] / det[good], (uu * wv - uv * wu)[good] / det[good])
    assert min(s.min(), r.min(), (1 - s - r).min()) > -1e-7
    on_face = t[good, 0] + s[:, None] * u[good] + r[:, None] * v[good]
    np.testing.assert_allclose(on_face, found.points[good], rtol=0, atol=1e-10 * size)


@pytest.mark.parametrize("offset", [0.0, 1e-6, 0.3, 1e4])
def test_closest_points_agree_with_libigl(offset: float) -> None:
    vertices, faces = nrs.shapes.displaced_icosphere(faces=5_000)
    mesh = (vertices.astype(np.float64), faces)
    rng = np.random.default_rng(1)
    points = mesh[0][rng.integers(0, len(vertices), 3_000)] + offset * rng.normal(size=(3_000, 3))
    check_closest(points, mesh)


def test_closest_points_far_from_the_origin() -> None:
    """UTM-like coordinates, which float32 boxes could not tell apart."""
    vertices, faces = nrs.shapes.displaced_icosphere(faces=5_000)
    shift = np.array([4.5e5, 5.4e6, 300.0])
    mesh = (vertices.astype(np.float64) * 0.01 + shift, faces)
    points = shift + 0.012 * np.random.default_rng(2).normal(size=(500, 3))
    found = closest_points(points, mesh)
    moved = distance.to_surface(points - shift, mesh[0] - shift, faces)
    np.testing.assert_allclose(found.distances, moved, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("name", ["bunny", "armadillo", "horse"])
def test_closest_points_of_scans_agree_with_libigl(name: str) -> None:
    mesh = data.scan(name)
    rng = np.random.default_rng(0)
    points = mesh.used[rng.integers(0, len(mesh.used), 20_000)].astype(np.float64)
    points += 0.02 * mesh.diagonal * rng.normal(size=points.shape)
    check_closest(points, (mesh.vertices.astype(np.float64), mesh.faces))


@pytest.mark.parametrize("seed", range(5))
def test_degenerate_soups_agree_with_brute_force(seed: int) -> None:
    mesh = soup(seed, 60, 0.2 + seed)
    points = np.random.default_rng(seed).normal(size=(200, 3)) * 2
    found = closest_points(points, mesh)
    good = trimesh.triangles.area(mesh[0][mesh[1]]) > 1e-12
    # trimesh cannot do degenerate triangles: as their longest edges, which are triangles with a repeated corner.
    expected = brute_force(points, (mesh[0], mesh[1][good]))
    for t in mesh[0][mesh[1][~good]]:
        for a, b in ((0, 1), (1, 2), (2, 0)):
            along = t[b] - t[a]
            w = np.clip((points - t[a]) @ along / max(along @ along, 1e-300), 0, 1)
            expected = np.minimum(expected, np.linalg.norm(points - (t[a] + w[:, None] * along), axis=1))
    np.testing.assert_allclose(found.distances, expected, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("scale", [1e-30, 1e-9, 1.0, 1e9, 1e30])
def test_scale_changes_nothing_but_the_scale(scale: float) -> None:
    a = nrs.shapes.displaced_icosphere(faces=2_000)
    b = nrs.shapes.icosphere(faces=500)
    one = surface_distance(
        (a[0].astype(np.float64), a[1]), (b[0].astype(np.float64), b[1]), mode="bounded", samples=5_000
    )
    other = surface_distance(
        (a[0].astype(np.float64) * scale, a[1]),
        (b[0].astype(np.float64) * scale, b[1]),
        mode="bounded",
        samples=5_000,
    )
    for name in ("mean", "rms", "max", "lower", "upper"):
        assert getattr(other, name) == pytest.approx(
            getattr(one, name) * scale, rel=1e-2 if name in ("lower", "upper") else 1e-9
        )
    assert one.converged
    assert other.converged


def test_statistics_agree_with_closed_forms() -> None:
    found = surface_distance(square(1.0), square(1.0, z=0.25), samples=10_000, mode="bounded")
    assert found.mean == pytest.approx(0.25, rel=1e-12)
    assert found.rms == pytest.approx(0.25, rel=1e-12)
    assert found.max == pytest.approx(0.25, rel=1e-12)
    assert found.a_to_b.area == pytest.approx(1.0)
    assert found.normals == nrs.measure.Deviation(0.0, 0.0, 0.0)
    # From a square of 3 to one of 1 in its corner: the corner is √8 away, and the mean is known.
    found = surface_distance(square(3.0), square(1.0), samples=200_000, mode="bounded")
    assert found.b_to_a.max == pytest.approx(0.0, abs=1e-12)
    assert found.max == pytest.approx(np.sqrt(8), rel=1e-12)
    assert found.lower <= np.sqrt(8) <= found.upper
    x = (np.arange(2_000) + 0.5) / 2_000 * 3 - 1
    x = np.maximum(x, 0)
    expected = np.hypot(x[:, None], x[None]).mean()
    assert found.a_to_b.mean == pytest.approx(expected, rel=1e-3)
    weight = found.a_to_b.area / (found.a_to_b.area + found.b_to_a.area)
    assert found.mean == pytest.approx(weight * found.a_to_b.mean, rel=1e-6)


def test_normals_are_compared_in_degrees() -> None:
    v, f = square()
    turned = v @ np.array([[1, 0, 0], [0, np.cos(0.5), np.sin(0.5)], [0, -np.sin(0.5), np.cos(0.5)]])
    assert surface_distance((v, f), (turned, f)).normals.mean == pytest.approx(np.degrees(0.5))
    assert surface_distance((v, f), (v, f[:, ::-1])).normals.max == pytest.approx(180)


def test_sampled_statistics_agree_with_libigl() -> None:
    v, f = nrs.shapes.displaced_icosphere(faces=20_000)
    cut = nrs.NaniteMesh.from_arrays(v, f).cut(target_faces=2_000)
    found = surface_distance((v, f), cut)
    both = ((v, f), (cut.vertices, cut.faces))
    for side, (a, b) in ((found.a_to_b, both), (found.b_to_a, both[::-1])):
        sampled = distance.one_sided(a, b, 100_000)[len(np.unique(a[1])) :]
        assert side.mean == pytest.approx(sampled.mean(), rel=0.02)
        assert side.rms == pytest.approx(np.sqrt((sampled**2).mean()), rel=0.02)
        np.testing.assert_allclose(
            side.per_vertex, distance.to_surface(a[0], b[0].astype(np.float64), b[1]), rtol=1e-9, atol=1e-9
        )


def bounded_holds(
    a: tuple[np.ndarray, np.ndarray], b: tuple[np.ndarray, np.ndarray], most: int = 200_000
) -> None:
    """Bounds against so many points of a grid on every face."""
    found = surface_distance(a, b, mode="bounded", samples=1_000)
    for side, (p, q) in ((found.a_to_b, (a, b)), (found.b_to_a, (b, a))):
        steps = int(np.sqrt(2 * most / len(p[1])))
        seen = closest_points(dense(p, steps), q).distances.max()
        assert seen <= side.upper
        assert side.lower <= side.upper
        assert side.max <= side.upper
        # Attained: nothing that is sampled finely can stay much below it.
        assert side.lower <= seen + np.ptp(dense(p, 1), axis=0).max() * 2 / steps
        assert side.converged
    assert found.upper == max(found.a_to_b.upper, found.b_to_a.upper)
    assert found.upper - found.lower <= 0.01 * found.upper + 1e-11


def test_bounds_hold_on_spikes() -> None:
    """Spikes a thousandth wide, which hardly any sample hits."""
    bounded_holds(spikes(30, 0.5), square())
    found = surface_distance(spikes(30, 0.5), square(), mode="bounded", samples=100)
    assert found.upper == pytest.approx(spikes(30, 0.5)[0][:, 2].max(), rel=0.011)


def test_bounds_hold_on_sheets_thinner_than_the_samples_are_apart() -> None:
    top, bottom = square(1.0, 1e-4), square(1.0, -1e-4)
    sheets = (np.concatenate([top[0], bottom[0]]), np.concatenate([top[1], bottom[1] + 4]))
    bounded_holds(sheets, square())
    # A gap in the middle, seen only between the vertices.
    grid = np.linspace(0, 1, 41)
    v = np.stack(np.meshgrid(grid, grid, [0.0]), -1).reshape(-1, 3)
    i = np.arange(40 * 41).reshape(40, 41)[:, :40].ravel()
    f = np.concatenate([np.stack([i, i + 1, i + 42], 1), np.stack([i, i + 42, i + 41], 1)])
    center = v[f].mean(axis=1)
    hole = f[np.hypot(center[:, 0] - 0.37, center[:, 1] - 0.61) > 0.05]
    bounded_holds(square(), (v, hole))
    found = surface_distance(square(), (v, hole), mode="bounded", samples=10)
    # No point of a face is farther from its centre than this.
    reach = np.sqrt(5) / 3 / 40
    assert 0.05 - reach < found.lower <= found.upper < 0.05 + reach


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32), st.integers(1, 12), st.integers(1, 12), st.sampled_from([0.01, 0.5, 3.0]))
def test_bounds_hold_on_soups(seed: int, m: int, n: int, size: float) -> None:
    a, b = soup(seed, m, size), soup(seed + 1, n, size)
    found = surface_distance(a, b, mode="bounded", samples=100)
    for side, (p, q) in ((found.a_to_b, (a, b)), (found.b_to_a, (b, a))):
        assert closest_points(dense(p, 40), q).distances.max() <= side.upper
        assert side.converged
        assert side.upper - side.lower <= 0.0101 * side.upper


def test_bounds_meet_on_the_same_surface_cut_differently() -> None:
    v, f = square()
    other = np.array([[0, 1, 3], [1, 2, 3]])
    found = surface_distance((v, f), (v, other), mode="bounded")
    assert found.lower == 0.0
    assert found.upper < 1e-11
    assert found.converged
    mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.displaced_icosphere(faces=5_000))
    assert surface_distance(mesh, mesh.cut(error=0.0), mode="bounded").upper < 1e-11


def test_bounds_hold_on_a_scan() -> None:
    mesh = data.scan("horse")
    built = nrs.NaniteMesh.from_arrays(mesh.vertices, mesh.faces)
    cut = built.cut(target_reduction=0.95)
    found = surface_distance((mesh.vertices, mesh.faces), cut, mode="bounded")
    assert found.converged
    sampled = distance.one_sided((mesh.vertices, mesh.faces), (cut.vertices, cut.faces), 200_000).max()
    assert sampled <= found.a_to_b.upper
    sampled = distance.one_sided((cut.vertices, cut.faces), (mesh.vertices, mesh.faces), 200_000).max()
    assert sampled <= found.b_to_a.upper


def test_a_spent_budget_is_said_and_the_bound_holds() -> None:
    rng = np.random.default_rng(3)
    a = (rng.normal(size=(300, 3)), np.arange(300).reshape(-1, 3))
    b = (rng.normal(size=(300, 3)), np.arange(300).reshape(-1, 3))
    full = surface_distance(a, b, mode="bounded", samples=1, tolerance=1e-4)
    stopped = surface_distance(a, b, mode="bounded", samples=1, tolerance=1e-4, budget=0)
    assert full.converged
    assert not stopped.converged
    assert stopped.upper >= full.lower
    assert stopped.lower <= full.upper
    assert full.upper - full.lower <= 1e-4 * full.upper


def test_results_do_not_depend_on_threads() -> None:
    code = (
        "import nanite_rs as nrs, numpy as np\n"
        "a, b = nrs.shapes.displaced_icosphere(faces=40_000), nrs.shapes.icosphere(faces=3_000)\n"
        "d = nrs.measure.surface_distance(a, b, mode='bounded', samples=20_000)\n"
        "print(d.mean.hex(), d.rms.hex(), d.max.hex(), d.lower.hex(), d.upper.hex(), d.normals)\n"
        "print(hash(d.a_to_b.per_vertex.tobytes()), nrs.measure.closest_points(b[0], a).faces.sum())\n"
    )
    import os

    outputs = set()
    for threads in ("1", "2", "5"):
        environment = {**os.environ, "RAYON_NUM_THREADS": threads, "PYTHONHASHSEED": "0"}
        done = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=True
        )
        outputs.add(done.stdout)
    assert len(outputs) == 1, outputs


def test_seeds_repeat_and_differ() -> None:
    a, b = nrs.shapes.displaced_icosphere(faces=2_000), nrs.shapes.icosphere(faces=500)
    one, same, other = (surface_distance(a, b, samples=5_000, seed=s) for s in (7, 7, 8))
    assert one.mean == same.mean
    assert one.mean != other.mean
    assert one.mean == pytest.approx(other.mean, rel=0.02)


def test_every_kind_of_mesh_is_taken() -> None:
    v, f = nrs.shapes.icosphere(faces=320)
    mesh = nrs.NaniteMesh.from_arrays(v, f)
    for kind in (
        (v, f),
        (v.tolist(), f.tolist()),
        trimesh.Trimesh(v, f, process=False),
        mesh,
        mesh.cut(error=0.0),
    ):
        assert surface_distance((v, f), kind, samples=1_000).max < 1e-7


BAD = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, np.nan, 0]])
TRIANGLE = np.array([[0, 1, 2]])


def test_faults_are_typed_and_named() -> None:
    good = square()
    with pytest.raises(nrs.MeshError, match=r"b\.vertices\[3\] is not finite"):
        surface_distance(good, (BAD, TRIANGLE))
    with pytest.raises(nrs.MeshError, match=r"a\.vertices\[3\] is not finite"):
        surface_distance((BAD.astype(np.float32), TRIANGLE), good)
    with pytest.raises(nrs.MeshError, match=r"points\[3\] is not finite"):
        closest_points(BAD, good)
    with pytest.raises(nrs.MeshError, match=r"b\.vertices: there are no faces"):
        surface_distance(good, (good[0], np.zeros((0, 3), np.int64)))
    with pytest.raises(nrs.MeshError, match="there are no faces"):
        closest_points(good[0], (np.zeros((0, 3)), np.zeros((0, 3), np.int64)))
    with pytest.raises(nrs.MeshError, match=r"faces\[0\] refers to vertex 9"):
        surface_distance(good, (good[0], np.array([[0, 1, 9]], np.uint32)))
    with pytest.raises(nrs.ArgumentError, match=r"a\.vertices: coordinates must not exceed"):
        surface_distance((good[0] * 1e305, good[1]), good)
    with pytest.raises(nrs.ArgumentError, match="tolerance"):
        surface_distance(good, good, tolerance=0.0)
    with pytest.raises(nrs.ArgumentError, match="samples"):
        surface_distance(good, good, samples=0)
    with pytest.raises(nrs.ArgumentError, match="mode"):
        surface_distance(good, good, mode="exact")
    with pytest.raises(nrs.DtypeError, match="b: expected"):
        surface_distance(good, 3)
    with pytest.raises(nrs.ArgumentError, match=r"points: expected shape \(N, 3\)"):
        closest_points(np.zeros((4, 2)), good)
    assert len(closest_points(np.zeros((0, 3)), good).distances) == 0


def test_a_surface_without_area_is_measured() -> None:
    point = (np.ones((3, 3)), TRIANGLE)
    found = surface_distance(point, square(), mode="bounded", samples=10)
    assert found.a_to_b.area == 0.0
    assert found.a_to_b.max == pytest.approx(1.0)
    assert found.converged
    assert np.isnan(found.normals.mean)
    assert found.upper == pytest.approx(np.sqrt(3), rel=0.011)
