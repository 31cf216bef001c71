"""What goes in and what is carried: dtypes, attributes, precision far from the origin, threads, progress."""

import numpy as np
import pytest
import trimesh

import nanite_rs as nrs
from conftest import SOAK
from oracles import distance, subjects, topology

INTEGERS = ["int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", ">i4", ">u8"]


@pytest.mark.parametrize("dtype", INTEGERS)
@pytest.mark.parametrize("order", ["C", "F", "strided"])
def test_faces_of_every_integer_type_and_layout(dtype: str, order: str) -> None:
    vertices, faces = subjects.cube(4)
    assert len(vertices) < 127
    expected = nrs.NaniteMesh.from_arrays(vertices, faces, progress=False)
    given = np.asarray(faces).astype(dtype)
    if order == "F":
        given = np.asfortranarray(given)
    elif order == "strided":
        given = np.repeat(given, 2, axis=0)[::2]
    given.setflags(write=False)
    assert nrs.NaniteMesh.from_arrays(vertices, given, progress=False) == expected


@pytest.mark.parametrize("dtype", ["float32", "float64", ">f4", ">f8"])
@pytest.mark.parametrize("order", ["C", "F", "strided"])
def test_vertices_of_both_float_types_and_every_layout(dtype: str, order: str) -> None:
    vertices, faces = subjects.cube(2)
    given = (vertices * 4 + 8).astype(dtype)
    if order == "F":
        given = np.asfortranarray(given)
    elif order == "strided":
        given = np.repeat(given, 2, axis=0)[::2]
    given.setflags(write=False)
    cut = nrs.NaniteMesh.from_arrays(given, faces, progress=False).cut(error=0)
    assert topology.surface_difference((given.astype(float), faces), (cut.vertices, cut.faces)) == (0, 0)


@pytest.mark.parametrize("dtype", ["float16", "longdouble", "int32", "uint8", "bool"])
def test_vertices_of_other_types_are_refused_by_name(dtype: str) -> None:
    vertices, faces = subjects.cube(2)
    with pytest.raises(nrs.DtypeError, match=f"vertices.*{np.dtype(dtype).name}"):
        nrs.NaniteMesh.from_arrays(vertices.astype(dtype), faces, progress=False)


def test_lists_are_taken_like_arrays() -> None:
    vertices, faces = subjects.cube(2)
    expected = nrs.NaniteMesh.from_arrays(vertices, faces, progress=False)
    assert nrs.NaniteMesh.from_arrays(vertices.tolist(), faces.tolist(), progress=False) == expected


def test_the_callers_arrays_are_left_alone() -> None:
    vertices, faces = subjects.cube(4)
    v, f = vertices.copy(), faces.copy()
    mesh = nrs.NaniteMesh.from_arrays(v, f, progress=False)
    np.testing.assert_array_equal(v, vertices)
    np.testing.assert_array_equal(f, faces)
    v[:] = 0
    assert mesh.cut(error=0).vertices.any()


# ----------------------------------------------------------------------------------- far from the origin


def test_utm_coordinates_keep_their_millimetres() -> None:
    source = subjects.subject("terrain")
    origin = np.array([500_000.0, 120.0, 4_649_776.0])
    detail = source.vertices.astype(np.float64) * 50  # a site 100 m across
    vertices = np.round(detail * 1000) / 1000 + origin
    assert np.abs(vertices.astype(np.float32) - vertices).max() > 0.1, "float32 must not suffice"
    mesh = nrs.NaniteMesh.from_arrays(vertices, source.faces, progress=False)
    mesh.check()
    cut = mesh.cut(error=0)
    assert cut.vertices.dtype == np.float64
    assert cut.error <= 1e-5
    # Every vertex within the stated error of a source vertex, and every face there.
    away = distance.to_surface(cut.vertices - origin, vertices - origin, source.faces)
    assert away.max() <= cut.error + 1e-9
    assert len(cut.faces) == len(source.faces)
    order = np.lexsort(np.round(cut.vertices - origin, 3).T)
    expected = np.lexsort(np.round(vertices - origin, 3).T)
    np.testing.assert_allclose(
        (cut.vertices - origin)[order], (vertices - origin)[expected], rtol=0, atol=max(cut.error, 1e-6)
    )
    coarse = mesh.cut(target_reduction=0.9)
    away = distance.to_surface(coarse.vertices - origin, vertices - origin, source.faces)
    near = nrs.NaniteMesh.from_arrays(vertices - origin, source.faces, progress=False).cut(
        target_reduction=0.9
    )
    assert away.max() <= coarse.error < 1.25 * near.error


def test_float32_sources_give_float32_back_bit_for_bit() -> None:
    source = subjects.subject("sphere")
    cut = subjects.built("sphere").cut(error=0)
    assert cut.vertices.dtype == np.float32
    given = np.unique(source.used.view("V12").ravel())
    np.testing.assert_array_equal(np.unique(np.ascontiguousarray(cut.vertices).view("V12").ravel()), given)


def test_the_same_mesh_moved_and_scaled_by_powers_of_two_cuts_the_same() -> None:
    source = subjects.subject("small sphere")
    base = nrs.NaniteMesh.from_arrays(source.vertices, source.faces, progress=False)
    scaled = nrs.NaniteMesh.from_arrays(source.vertices * np.float32(1024), source.faces, progress=False)
    a, b = base.cut(error=0.01), scaled.cut(error=0.01 * 1024)
    np.testing.assert_array_equal(a.faces, b.faces)
    np.testing.assert_array_equal(a.vertices * np.float32(1024), b.vertices)
    assert b.error == pytest.approx(a.error * 1024)


# ------------------------------------------------------------------------------------------- attributes


def painted():
    """A closed mesh with normals, colours and two UV sets that are functions of position."""
    source = subjects.subject("sphere")
    v = source.vertices.astype(np.float64)
    normals = topology.vertex_normals(source.vertices, source.faces)
    colors = np.clip((v / np.abs(v).max() * 0.5 + 0.5) * 255, 0, 255)
    colors = np.concatenate([colors, np.full((len(v), 1), 200.0)], axis=1).round().astype(np.uint8)
    uvs = [(v[:, :2] * 0.5).astype(np.float32), (v[:, 1:] * 2 + 1).astype(np.float32)]
    return source, normals, colors, uvs


@pytest.fixture(scope="module")
def painted_mesh():
    source, normals, colors, uvs = painted()
    mesh = nrs.NaniteMesh.from_arrays(
        source.vertices, source.faces, normals=normals, colors=colors, uvs=uvs, progress=False
    )
    mesh.check()
    return mesh


def test_attributes_are_exact_at_full_detail(painted_mesh) -> None:
    source, normals, colors, uvs = painted()
    cut = painted_mesh.cut(error=0)
    row = {p.tobytes(): i for i, p in enumerate(source.vertices)}
    at = np.array([row[p.tobytes()] for p in np.ascontiguousarray(cut.vertices, np.float32)])
    np.testing.assert_array_equal(cut.colors, colors[at])
    assert len(cut.uvs) == 2
    for ours, given in zip(cut.uvs, uvs, strict=True):
        np.testing.assert_array_equal(ours, given[at])
    apart = np.linalg.norm(cut.normals.astype(np.float64) - normals[at], axis=1)
    assert apart.max() < 1e-4  # 2 × 16 bits of an octahedron
    np.testing.assert_allclose(np.linalg.norm(cut.normals, axis=1), 1, atol=1e-6)


def test_attributes_follow_the_surface_in_coarse_cuts(painted_mesh) -> None:
    for reduction, colour, uv, angle in ((0.5, 6, 0.02, 15), (0.9, 12, 0.05, 30)):
        cut = painted_mesh.cut(target_reduction=reduction)
        scale = np.abs(subjects.subject("sphere").vertices).max()
        expected = np.clip((np.asarray(cut.vertices, float) / scale * 0.5 + 0.5) * 255, 0, 255)
        off = np.abs(cut.colors[:, :3].astype(float) - expected).max(axis=1)
        assert np.quantile(off, 0.99) < colour
        assert (cut.colors[:, 3] == 200).all()
        assert np.quantile(np.abs(cut.uvs[0] - np.asarray(cut.vertices)[:, :2] * 0.5), 0.99) < uv
        own = topology.vertex_normals(cut.vertices, cut.faces)
        turned = np.degrees(np.arccos(np.clip(np.einsum("ij,ij->i", own, cut.normals), -1, 1)))
        assert np.quantile(turned, 0.95) < angle


def test_a_flat_colored_surface_does_not_collapse() -> None:
    vertices, faces = subjects.grid(128, 128)
    stripes = (np.sin(vertices[:, 0] * 20) > 0).astype(np.uint8) * 255
    colors = np.stack([stripes, stripes, stripes, np.full_like(stripes, 255)], axis=1)
    plain = nrs.NaniteMesh.from_arrays(vertices, faces, progress=False)
    mesh = nrs.NaniteMesh.from_arrays(vertices, faces, colors=colors, progress=False)
    cut = mesh.cut(error=1e-4)
    assert len(cut.faces) > len(plain.cut(error=1e-4).faces)
    # Away from the edges of the stripes the triangles have the colour of the stripe that they lie on.
    x = cut.vertices[cut.faces][..., 0].mean(axis=1)
    inside = np.abs(np.sin(x * 20)) > 0.5
    off = np.abs(cut.colors[cut.faces][..., 0].mean(axis=1) - (np.sin(x * 20) > 0) * 255.0)
    assert np.quantile(off[inside], 0.95) < 64
    cut = mesh.cut(target_faces=len(faces) // 4)
    expected = (np.sin(np.asarray(cut.vertices)[:, 0] * 20) > 0) * 255
    assert (np.abs(cut.colors[:, 0].astype(int) - expected) > 128).mean() < 0.05


def test_missing_normals_are_angle_weighted() -> None:
    source = subjects.subject("sphere")
    cut = subjects.built("sphere").cut(error=0)
    expected = topology.vertex_normals(np.asarray(cut.vertices), np.asarray(cut.faces, np.int64))
    assert np.linalg.norm(cut.normals.astype(np.float64) - expected, axis=1).max() < 2e-4
    assert len(cut.vertices) == len(source.used)


def test_seams_stay_where_attributes_differ() -> None:
    """A flat-shaded cube keeps three normals at its corners and closes by position."""
    vertices, faces = subjects.cube(16)
    soup, order = subjects.soup_of(vertices, faces)
    t = soup.reshape(-1, 3, 3)
    flat = np.repeat(np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]), 3, axis=0)
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    mesh = nrs.NaniteMesh.from_arrays(soup, order, normals=flat.astype(np.float32), progress=False)
    mesh.check()
    for target in (1.0, 0.3, 0.05):
        cut = mesh.cut(target_reduction=1 - target)
        assert topology.unbalanced_edges(topology.by_position(cut.vertices, cut.faces)) == 0
        corner = np.abs(np.abs(np.asarray(cut.vertices)) - 1).max(axis=1) < 1e-6
        assert corner.any()
        axis = np.abs(cut.normals[corner]).max(axis=1)
        assert axis.min() > 0.99


def test_trimesh_round_trip_with_colors_and_transforms() -> None:
    box = trimesh.creation.box().subdivide().subdivide()
    box.visual.vertex_colors = np.random.default_rng(0).integers(0, 255, (len(box.vertices), 4), np.uint8)
    mesh = nrs.NaniteMesh.from_trimesh(box, progress=False)
    cut = mesh.cut(error=0)
    assert cut.colors is not None
    assert topology.surface_difference((box.vertices, box.faces), (cut.vertices, cut.faces)) == (0, 0)


# ------------------------------------------------------------------------------- threads, progress, repeat


@pytest.mark.parametrize(
    "name", ["sphere", "part", "flat sphere", "soup", "bunny", *(["dragon"] if SOAK else [])]
)
def test_same_bytes_for_any_number_of_threads(name: str, tmp_path) -> None:
    source = subjects.subject(name)
    blobs = []
    for threads in (1, 2, 8, 2):
        mesh = nrs.NaniteMesh.from_arrays(
            source.vertices, source.faces, options=nrs.BuildOptions(threads=threads), progress=False
        )
        path = tmp_path / f"{threads}.nanite"
        mesh.save(path)
        blobs.append(path.read_bytes())
    assert all(b == blobs[0] for b in blobs[1:])


def test_progress_is_reported_and_reaches_the_end() -> None:
    # Progress is told a few times per second: enough work for that.
    vertices, faces = nrs.shapes.displaced_icosphere(faces=500_000)
    seen: list[tuple[int, int]] = []
    nrs.NaniteMesh.from_arrays(vertices, faces, progress=lambda done, total: seen.append((done, total)))
    assert len(seen) >= 3
    fractions = [d / t for d, t in seen]
    assert fractions == sorted(fractions)
    assert fractions[-1] == pytest.approx(1, abs=0.05)


def test_keyboard_interrupt_from_progress_stops_the_build() -> None:
    vertices, faces = nrs.shapes.displaced_icosphere(faces=500_000)
    calls = 0

    def stop(done: int, total: int) -> None:
        nonlocal calls
        calls += 1
        if calls == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        nrs.NaniteMesh.from_arrays(vertices, faces, progress=stop)
    assert calls < 10
