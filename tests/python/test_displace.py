"""Displacement: the stated bound against distances by libigl, no crack, few triangles, and what is refused.

The exact surface is made here anew, with NumPy, from its definition in docs/displacement.md.
"""

import warnings

import igl
import numpy as np
import pytest
import trimesh

import nanite_rs as nrs
from oracles import data

RNG = np.random.default_rng(42)


# ---------------------------------------------------------------- the exact surface, in NumPy


def bilinear(texels, uv, wrap="repeat"):
    """Values of a map at texture coordinates, v up."""
    h, w = texels.shape[:2]
    x, y = uv[..., 0] * w - 0.5, (1.0 - uv[..., 1]) * h - 0.5
    i, j = np.floor(x).astype(int), np.floor(y).astype(int)

    def at(i, j):
        if wrap == "clamp":
            return texels[np.clip(j, 0, h - 1), np.clip(i, 0, w - 1)]
        if wrap == "mirror":
            i, j = i % (2 * w), j % (2 * h)
            return texels[np.minimum(j, 2 * h - 1 - j), np.minimum(i, 2 * w - 1 - i)]
        return texels[j % h, i % w]

    fx, fy = x - i, y - j
    if texels.ndim == 3:
        fx, fy = fx[..., None], fy[..., None]
    top = at(i, j) * (1 - fx) + at(i + 1, j) * fx
    return top * (1 - fy) + (at(i, j + 1) * (1 - fx) + at(i + 1, j + 1) * fx) * fy


def unit(v):
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    return v / np.where(length > 0, length, 1)


def corner_normals(v, f):
    """Normals weighted by angle over all faces at a position, by trimesh."""
    welded, index = np.unique(v, axis=0, return_inverse=True)
    mesh = trimesh.Trimesh(welded, index.reshape(-1)[f], process=False)
    return trimesh.geometry.weighted_vertex_normals(
        len(welded), mesh.faces, mesh.face_normals, mesh.face_angles
    )[index.reshape(-1)]


def exact(v, f, uv, n, texels, scale, mid=0.0, wrap="repeat", steps=24):
    """Points of the exact surface without tears, on a grid of each face."""
    b = np.array([(i, j, steps - i - j) for i in range(steps + 1) for j in range(steps + 1 - i)]) / steps
    p, t, d = (np.einsum("kb,fbx->fkx", b, a[f]) for a in (v, uv, n))
    height = scale * (bilinear(texels, t, wrap) - mid)
    moved = height if texels.ndim == 3 else height[..., None] * unit(d)
    return (p + moved).reshape(-1, 3)


def farthest(points, made):
    squared = igl.point_mesh_squared_distance(points, made.vertices, made.faces.astype(np.int64))[0]
    return float(np.sqrt(squared.max()))


# ---------------------------------------------------------------- topology


def edge_counts(v, f):
    """How often each edge between positions is used."""
    _, index = np.unique(v, axis=0, return_inverse=True)
    f = index.reshape(-1)[f]
    edges = np.sort(np.concatenate([f[:, [0, 1]], f[:, [1, 2]], f[:, [2, 0]]]), axis=1)
    return np.unique(edges, axis=0, return_counts=True)


def assert_no_crack(made, v, f):
    """The border is that of the source, subdivided; inside, two faces meet at each edge, turned alike."""
    edges, counts = edge_counts(made.vertices, made.faces)
    own, own_counts = edge_counts(v, f)
    assert counts.max() == own_counts.max() == 2
    border, own_border = edges[counts == 1], own[own_counts == 1]
    assert (len(border) > 0) == (len(own_border) > 0)
    # Each vertex of the border has two of its edges, and loops are as many as they were.
    loops = trimesh.graph.connected_components(border) if len(border) else []
    own_loops = trimesh.graph.connected_components(own_border) if len(own_border) else []
    assert len(loops) == len(own_loops)
    assert not len(border) or (np.unique(border, return_counts=True)[1] == 2).all()
    euler = len(np.unique(edges)) - len(edges) + len(made.faces)
    own_used = np.unique(own)
    assert euler == len(own_used) - len(own) + len(f)


# ---------------------------------------------------------------- surfaces


def plane(n=1):
    side = np.linspace(0.0, 1.0, n + 1)
    x, y = np.meshgrid(side, side)
    v = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    i = np.arange(n * (n + 1)).reshape(n, n + 1)[:, :-1].ravel()
    f = np.concatenate([np.column_stack([i, i + 1, i + n + 2]), np.column_stack([i, i + n + 2, i + n + 1])])
    return v, f, v[:, :2].copy()


def torus(n=24, m=12):
    a, b = np.meshgrid(np.arange(n + 1) / n, np.arange(m + 1) / m, indexing="ij")
    # The last row and column are the first, so that positions agree to the bit.
    s, t = (np.where(a == 1, 0, a) * 2 * np.pi, np.where(b == 1, 0, b) * 2 * np.pi)
    v = np.stack([(1 + 0.4 * np.cos(t)) * np.cos(s), (1 + 0.4 * np.cos(t)) * np.sin(s), 0.4 * np.sin(t)], -1)
    i = np.arange(n)[:, None] * (m + 1) + np.arange(m)
    i = i.ravel()
    f = np.concatenate([np.column_stack([i, i + m + 1, i + m + 2]), np.column_stack([i, i + m + 2, i + 1])])
    return v.reshape(-1, 3), f, np.stack([a, b], -1).reshape(-1, 2)


def icosphere(subdivisions=2):
    """A sphere whose texture coordinates have no seam: the map is laid over it from above and below, mirrored."""
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
    v = np.asarray(mesh.vertices)
    return v, np.asarray(mesh.faces), 0.5 + 0.4 * v[:, :2]


SIDE = (np.arange(128) + 0.5) / 128
X, Y = np.meshgrid(SIDE, 1 - SIDE)
WAVES = np.sin(2 * np.pi * 3 * X) * np.cos(2 * np.pi * 2 * Y)
BUMP = np.exp(-((X - 0.4) ** 2 + (Y - 0.6) ** 2) / 0.003)
STEP = (X > 0.5).astype(float)
RAMP = X + 0.5 * Y
CONE = np.maximum(0.0, 0.3 - np.hypot(X - 0.5, Y - 0.5))
NOISE = RNG.random((32, 32))
VECTORS = np.stack([0.2 * WAVES, BUMP, WAVES * Y], -1)

SURFACES = {
    "plane, waves": (plane(), WAVES, "repeat"),
    "plane, bump": (plane(2), BUMP, "clamp"),
    "plane, step": (plane(3), STEP, "clamp"),
    "plane, ramp": (plane(), RAMP, "mirror"),
    "plane, cone": (plane(), CONE, "clamp"),
    "plane, noise": (plane(2), NOISE, "repeat"),
    "torus, waves": (torus(), WAVES, "repeat"),
    "torus, bump": (torus(), BUMP, "repeat"),
    "sphere, mirrored": (icosphere(), WAVES, "mirror"),
    "sphere, cone": (icosphere(), CONE, "clamp"),
    "plane, vectors": (plane(2), VECTORS, "clamp"),
    "torus, flat map": (torus(), np.full((4, 4), 0.7), "repeat"),
}


@pytest.mark.parametrize("name", SURFACES)
def test_no_point_of_the_exact_surface_is_farther_than_the_bound(name):
    (v, f, uv), texels, wrap = SURFACES[name]
    normals = corner_normals(v, f)
    made = nrs.displace(
        v, f, uvs=uv, normals=normals, height=texels, scale=0.1, tolerance=3e-3, midlevel=0.2, wrap=wrap
    )
    points = exact(v, f, uv, normals, texels, 0.1, 0.2, wrap, steps=64 if len(f) < 100 else 16)
    off = farthest(points, made)
    assert off <= made.error <= 3e-3
    # The map of the torus goes on over the seam.
    assert made.tear == 0.0
    # The bound is not far above what is there, where there is something.
    assert off > 0.2 * made.error or made.error < 1e-9
    assert_no_crack(made, v, f)


def test_vertices_lie_on_an_analytic_surface():
    """A sphere with a constant height is a sphere: its vertices have its radius."""
    v, f, uv = icosphere(3)
    made = nrs.displace(v, f, uvs=uv, normals=v, height=np.ones((2, 2)), scale=0.25, tolerance=0.01)
    on_face = trimesh.Trimesh(v, f, process=False)
    _, distance, _ = trimesh.proximity.closest_point(on_face, made.vertices)
    assert np.abs(distance - 0.25).max() < 0.01
    corners = np.isin(np.round(made.vertices / 1.25, 9), np.round(v, 9)).all(axis=1)
    assert np.allclose(np.linalg.norm(made.vertices[corners], axis=1), 1.25)


def test_flat_parts_stay_coarse():
    v, f, uv = plane(1)
    assert len(nrs.displace(v, f, uvs=uv, height=np.full((512, 512), 3.0), tolerance=1e-6)) == 2
    ramp = np.tile(np.arange(64.0), (64, 1))
    inside = 0.1 + 0.8 * uv
    made = nrs.displace(v, f, uvs=inside, height=ramp, tolerance=1e-6)
    assert len(made) == 2
    assert made.error < 1e-9


def uniform(v, f, uv, texels, scale, count):
    """Faces of an even subdivision of the unit square, and its largest distance from the exact surface."""
    n = round(np.sqrt(count / 2))
    v, f, uv = plane(n)
    moved = v + scale * bilinear(texels, uv, "clamp")[:, None] * [0.0, 0.0, 1.0]
    made = type("Made", (), {"vertices": moved, "faces": f})
    v1, f1, uv1 = plane(1)
    return len(f), farthest(
        exact(v1, f1, uv1, np.tile([0.0, 0.0, 1.0], (4, 1)), texels, scale, 0, "clamp", 300), made
    )


@pytest.mark.parametrize(("texels", "most"), [(BUMP, 0.4), (CONE, 0.4), (STEP, 0.4)])
def test_local_detail_takes_fewer_triangles_than_an_even_subdivision(texels, most):
    v, f, uv = plane(1)
    made = nrs.displace(v, f, uvs=uv, height=texels, scale=0.2, tolerance=2e-3, wrap="clamp")
    # An even subdivision of so many more triangles is still farther off.
    _, off = uniform(v, f, uv, texels, 0.2, len(made) / most)
    assert off > made.error


# ---------------------------------------------------------------- seams and creases


def cube():
    """A cube with sharp normals: 24 vertices, a chart for each side."""
    v, f, uv, n = [], [], [], []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            normal = np.zeros(3)
            normal[axis] = sign
            a = np.roll(normal, 1)
            b = np.cross(normal, a)
            first = len(v)
            for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
                v.append(normal + x * a + y * b)
                uv.append([(x + 1) / 2, (y + 1) / 2])
                n.append(normal)
            f += [[first, first + 1, first + 2], [first, first + 2, first + 3]]
    return np.array(v), np.array(f), np.array(uv), np.array(n)


def torn_exact(v, f, uv, n, texels, scale, steps):
    """Points of a torn surface, by its definition, corner by corner and edge by edge."""
    _, ids = np.unique(v, axis=0, return_inverse=True)
    ids = ids.reshape(-1)

    def own(t, d):
        return scale * bilinear(texels, t)[..., None] * unit(d)

    def mean(ts, ds):
        height = scale * np.mean([bilinear(texels, t) for t in ts], axis=0)
        return height[..., None] * unit(np.sum([unit(d) for d in ds], axis=0))

    def different(rows):
        return list({tuple(np.round(row, 12)): row for row in rows}.values())

    at, sides = {}, {}
    for face in f:
        for k in range(3):
            a, b = face[k], face[(k + 1) % 3]
            at.setdefault(ids[a], []).append(np.concatenate([uv[a], n[a]]))
            a, b = (a, b) if ids[a] < ids[b] else (b, a)
            sides.setdefault((ids[a], ids[b]), []).append(np.concatenate([uv[a], n[a], uv[b], n[b]]))
    at = {key: np.array(different(rows)) for key, rows in at.items()}
    sides = {key: np.array(different(rows)) for key, rows in sides.items()}
    b = np.array([(i, j, steps - i - j) for i in range(steps + 1) for j in range(steps + 1 - i)]) / steps
    out = []
    for face in f:
        surface = b @ v[face] + own(b @ uv[face], b @ n[face])
        for k in range(3):
            rows = at[ids[face[k]]]
            tear = mean(rows[:, :2], rows[:, 2:]) - own(uv[face[k]], n[face[k]])
            surface += b[:, k, None] * tear
            i, j = (k + 1) % 3, (k + 2) % 3
            i, j = (i, j) if ids[face[i]] < ids[face[j]] else (j, i)
            rows = sides[ids[face[i]], ids[face[j]]]
            if len(rows) < 2:
                continue
            weight = b[:, i] + b[:, j]
            t = (b[:, j] / np.where(weight > 0, weight, 1))[:, None]

            def difference(t, rows=rows, i=i, j=j, face=face):
                ts = [row[:2] * (1 - t) + row[5:7] * t for row in rows]
                ds = [row[2:5] * (1 - t) + row[7:] * t for row in rows]
                of_face = own(uv[face[i]] * (1 - t) + uv[face[j]] * t, n[face[i]] * (1 - t) + n[face[j]] * t)
                return mean(ts, ds) - of_face

            zero = np.zeros((1, 1))
            rest = difference(t) - (1 - t) * difference(zero) - t * difference(zero + 1)
            surface += weight[:, None] * rest
        out.append(surface)
    return np.concatenate(out)


def test_a_cube_with_creases_is_closed_and_within_the_bound():
    v, f, uv, n = cube()
    texels = 0.5 + 0.5 * WAVES[::4, ::4]
    made = nrs.displace(v, f, uvs=uv, normals=n, height=texels, scale=0.2, tolerance=0.01)
    assert_no_crack(made, v, f)
    points = torn_exact(v, f, uv, n, texels, 0.2, 40)
    assert 0.1 * made.error < farthest(points, made) <= made.error <= 0.01
    # Without blending, sides stand apart by more than the bound, and no more than what is stated.
    apart = farthest(exact(v, f, uv, n, texels, 0.2, steps=40), made)
    assert made.error < apart <= made.tear + made.error
    assert made.tear <= 0.5


def test_a_seam_in_the_texture_is_closed():
    v, f, uv = plane(2)
    # One half of the plane shows another part of the map.
    right = v[f].mean(axis=1)[:, 0] > 0.5
    more = np.concatenate([v, v])
    other = np.where(right[:, None], f + len(v), f)
    coordinates = np.concatenate([uv, uv[:, ::-1] * 0.7 + 0.2])
    normals = np.tile([0.0, 0.0, 1.0], (len(more), 1))
    made = nrs.displace(
        more, other, uvs=coordinates, normals=normals, height=WAVES, scale=0.05, tolerance=2e-3
    )
    assert_no_crack(made, v, f)
    points = torn_exact(more, other, coordinates, normals, WAVES, 0.05, 60)
    assert farthest(points, made) <= made.error <= 2e-3
    assert 0.0 < made.tear < 0.2


def test_mirrored_coordinates_tear_nothing():
    v, f, uv = plane(2)
    mirrored = uv.copy()
    mirrored[:, 0] = np.abs(uv[:, 0] - 0.5) * 2
    made = nrs.displace(v, f, uvs=mirrored, height=BUMP, scale=0.05, tolerance=1e-3, wrap="clamp")
    assert made.tear == 0.0
    assert_no_crack(made, v, f)
    left, right = (made.vertices[:, 0] <= 0.5), (made.vertices[:, 0] >= 0.5)
    assert abs(made.vertices[left, 2].max() - made.vertices[right, 2].max()) < 2e-3


# ---------------------------------------------------------------- a real mesh, real pictures, meshes of it


def test_a_scan_takes_displacement():
    mesh = trimesh.load(data.require("scans", "stanford_bunny_full", "bun_zipper.ply"), force="mesh")
    small = nrs.decimate((mesh.vertices, mesh.faces), target_faces=2000)
    v, f = np.asarray(small.vertices, np.float64), np.asarray(small.faces)
    size = np.ptp(v, axis=0).max()
    uv = (v[:, :2] - v[:, :2].min(axis=0)) / size
    normals = corner_normals(v, f)
    made = nrs.displace(
        v, f, uvs=uv, normals=normals, height=WAVES[::4, ::4], scale=0.02 * size, tolerance=2e-3 * size
    )
    assert farthest(exact(v, f, uv, normals, WAVES[::4, ::4], 0.02 * size, steps=10), made) <= made.error
    assert made.error <= 2e-3 * size


def test_errors_of_cuts_include_the_bound(tmp_path):
    v, f, uv = plane(2)
    made = nrs.displace(v, f, uvs=uv, height=WAVES, scale=0.1, tolerance=5e-4, wrap="clamp")
    mesh = made.build()
    assert mesh.check() is not None
    points = exact(v, f, uv, np.tile([0.0, 0.0, 1.0], (len(v), 1)), WAVES, 0.1, 0, "clamp", 64)
    mesh.save(tmp_path / "waves.nanite")
    assert made.error <= mesh.cut(error=0).error < made.error + 1e-6
    # A file rounds positions, too.
    for one in (mesh, nrs.NaniteMesh.open(tmp_path / "waves.nanite")):
        full = one.cut(error=0)
        assert made.error <= full.error < 2 * made.error
        coarse = one.cut(error=5e-3)
        assert len(coarse) < len(full)
        assert coarse.error <= 5e-3
        assert farthest(points, coarse) <= coarse.error


def test_faces_keep_materials_and_data_of_their_source():
    v, f, uv = plane(3)
    made = nrs.displace(v, f, uvs=uv, height=WAVES, scale=0.1, tolerance=2e-3, wrap="clamp")
    labels = np.arange(len(f), dtype=np.uint16) + 100
    pairs = np.column_stack([np.arange(len(f)), 3 * np.arange(len(f)) + 1]).astype(np.int32)
    mesh = made.build(face_materials=np.arange(len(f)) % 2, face_channels={"label": labels, "pairs": pairs})
    cut = mesh.cut(error=0)
    # The source is flat: where a face lies in the plane says of which it is a part.
    centers = cut.vertices[cut.faces].mean(axis=1) * [1, 1, 0]
    for face, label, both, look in zip(
        centers, cut.face_channels["label"], cut.face_channels["pairs"], cut.face_materials, strict=True
    ):
        row = int(label) - 100
        inside = trimesh.triangles.points_to_barycentric(v[f[row]][None] * [1, 1, 0], face[None])
        assert inside.min() > -1e-3
        assert np.array_equal(both, pairs[row])
        assert look == row % 2
    with pytest.raises(nrs.ArgumentError, match=r"face_channels\['label'\]: expected one for each face"):
        made.build(face_channels={"label": labels[:-1]})
    with pytest.raises(nrs.ArgumentError, match="face_materials: expected one for each face"):
        made.build(face_materials=np.zeros(2, int))
    with pytest.raises(nrs.ArgumentError, match=r"face_materials: expected \(F,\)"):
        made.build(face_materials=np.zeros((len(f), 2), int))
    with pytest.raises(nrs.DtypeError, match="face_channels: expected a mapping"):
        made.build(face_channels=labels)


def test_pictures_are_heights():
    v, f, uv = plane(1)
    bytes_ = np.round(BUMP[::8, ::8] * 255).astype(np.uint8)
    how = {"uvs": uv, "scale": 0.1, "tolerance": 1e-3}
    made = nrs.displace(v, f, height=bytes_ / 255.0, wrap="clamp", **how)
    texture = nrs.Texture(bytes_, wrap="clamp")
    assert np.allclose(nrs.displace(v, f, height=texture, **how).vertices, made.vertices)
    grey = nrs.Image(np.repeat(bytes_[:, :, None], 3, axis=2))
    assert np.allclose(nrs.displace(v, f, height=grey, wrap="clamp", **how).vertices, made.vertices)
    halves = np.float16(bytes_ / 255.0)
    assert nrs.displace(v, f, height=halves, wrap="clamp", **how).error <= 1e-3
    turned = nrs.Texture(bytes_, wrap="clamp", rotation=0.3, scale=(2.0, 2.0), offset=(0.1, 0.2))
    assert nrs.displace(v, f, height=turned, **how).error <= 1e-3


# ---------------------------------------------------------------- limits


def test_threads_do_not_matter():
    v, f, uv = icosphere()
    how = {"uvs": uv, "height": WAVES, "scale": 0.05, "tolerance": 2e-3}
    threads = nrs.get_num_threads()
    try:
        found = []
        for count in (1, 2, 3):
            nrs.set_num_threads(count)
            found.append(nrs.displace(v, f, **how))
    finally:
        nrs.set_num_threads(threads)
    for other in found[1:]:
        for name in ("vertices", "faces", "uvs", "normals", "face_ids"):
            assert np.array_equal(getattr(found[0], name), getattr(other, name))
        assert found[0].error == other.error


def test_so_many_triangles_and_no_more():
    v, f, uv = plane(1)
    with pytest.warns(nrs.UsageWarning, match="above the tolerance"):
        made = nrs.displace(v, f, uvs=uv, height=WAVES, tolerance=1e-6, wrap="clamp", max_triangles=500)
    assert len(made) <= 500
    normals = np.tile([0.0, 0.0, 1.0], (4, 1))
    assert farthest(exact(v, f, uv, normals, WAVES, 1.0, 0, "clamp", 100), made) <= made.error


def test_large_maps_are_not_copied():
    """16 M texels: what is allocated by Python stays far below another map."""
    import tracemalloc

    v, f, uv = plane(1)
    texels = np.zeros((4096, 4096), np.uint8)
    texels[1000:1016, 3000:3016] = 255
    tracemalloc.start()
    made = nrs.displace(v, f, uvs=uv, height=texels, scale=0.01, tolerance=1e-3)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 4 << 20
    assert 100 < len(made) < 20_000
    assert made.vertices[:, 2].max() > 0.009


def test_extreme_numbers():
    v, f, uv = plane(1)
    for factor in (1e-30, 1e30):
        made = nrs.displace(v * factor, f, uvs=uv, height=WAVES, scale=0.1 * factor, tolerance=0.01 * factor)
        assert made.error <= 0.01 * factor
        assert np.isfinite(made.vertices).all()
    # Faces without area, and those with two corners at one place.
    flat = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 0, 0], [0, 0, 0]])
    made = nrs.displace(flat, [[0, 1, 2], [0, 3, 1]], uvs=flat[:, :2].copy(), height=WAVES, tolerance=0.1)
    assert made.dropped_faces == 1
    assert np.isfinite(made.vertices).all()
    zero = nrs.displace(v, f, uvs=uv, normals=np.zeros((4, 3)), height=WAVES, tolerance=0.1)
    assert np.allclose(zero.vertices[:, 2], 0.0)


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"uvs": np.zeros((3, 2))}, nrs.ArgumentError, r"uvs: expected shape \(4, 2\)"),
        ({"uvs": np.full((4, 2), np.nan)}, nrs.ArgumentError, r"uvs\[0\] is not finite"),
        ({"uvs": np.full((4, 2), 1e30)}, nrs.ArgumentError, "uvs: row 0"),
        ({"uvs": np.zeros((4, 2), int)}, nrs.DtypeError, "uvs: expected a floating-point"),
        ({"normals": np.full((4, 3), np.inf)}, nrs.ArgumentError, r"normals\[0\] is not finite"),
        ({"height": np.array([[0.0, np.nan]])}, nrs.ArgumentError, "height: NaN at row 0, column 1"),
        ({"height": np.array([[0.0], [np.inf]])}, nrs.ArgumentError, "height: inf at row 1, column 0"),
        ({"height": np.zeros((0, 4))}, nrs.ArgumentError, "height: the map is empty"),
        ({"height": np.zeros((4, 4, 2))}, nrs.ArgumentError, "height: expected"),
        ({"height": np.zeros((4, 4), np.int32)}, nrs.DtypeError, "height: must be uint8"),
        ({"height": "missing.png"}, nrs.MissingFileError, "missing.png"),
        ({"height": nrs.Texture(np.zeros((2, 2)), filter="nearest")}, nrs.ArgumentError, "height: a texture"),
        ({"tolerance": 0.0}, nrs.ArgumentError, "tolerance: must be above 0"),
        ({"tolerance": np.nan}, nrs.ArgumentError, "tolerance"),
        ({"scale": np.inf}, nrs.ArgumentError, "scale: must be finite"),
        ({"midlevel": np.nan}, nrs.ArgumentError, "midlevel: must be finite"),
        ({"wrap": "tile"}, nrs.ArgumentError, "wrap: must be repeat"),
        ({"max_triangles": 0}, nrs.ArgumentError, "max_triangles: must be 1 or more"),
        ({"vertices": np.full((4, 3), np.nan)}, nrs.MeshError, r"vertices\[0\] is not finite"),
        ({"vertices": np.zeros((4, 3))}, nrs.MeshError, "empty"),
        ({"faces": [[0, 1, 7]]}, nrs.MeshError, "refers to vertex 7"),
        ({"faces": np.zeros((0, 3), int)}, nrs.MeshError, "empty"),
    ],
)
def test_what_is_wrong_is_named(change, error, message):
    v, f, uv = plane(1)
    given = {"vertices": v, "faces": f, "uvs": uv, "height": WAVES, "tolerance": 0.1} | change
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(error, match=message):
            nrs.displace(given.pop("vertices"), given.pop("faces"), **given)
