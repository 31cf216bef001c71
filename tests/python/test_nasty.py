"""Meshes that break builders: every one gives a clear typed error or a built mesh whose check() passes."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

import nanite_rs as nrs
from oracles import data, subjects, topology


def build_or_refuse(vertices, faces, **options):
    """The built and checked mesh, or the error; anything but a NaniteError fails the test."""
    try:
        mesh = nrs.NaniteMesh.from_arrays(vertices, faces, progress=False, **options)
    except nrs.NaniteError as error:
        return error
    mesh.check()
    for reduction in (0.0, 0.5, 0.99):
        cut = mesh.cut(target_reduction=reduction)
        assert len(cut.faces) <= mesh.report.input_faces
        assert np.isfinite(cut.vertices).all()
        if len(cut.faces):
            assert cut.faces.min() >= 0
            assert cut.faces.max() < len(cut.vertices)
    return mesh


def files(folder: str):
    found = [pytest.param(p, id=p.parent.name) for p in data.folder_models(folder)]
    return found or [pytest.param(None, id="absent")]


def corners(mesh: nrs.NaniteMesh) -> np.ndarray:
    """Nine coordinates for each triangle at full detail."""
    cut = mesh.cut(error=0.0)
    return np.asarray(cut.vertices, np.float64)[cut.faces].reshape(-1, 9)


@pytest.mark.parametrize("path", files("nasty") + files("cad"))
def test_nasty_and_cad_files(path, tmp_path) -> None:
    if path is None:
        data.require("nasty")
    try:
        mesh = nrs.NaniteMesh.from_file(path, progress=False)
    except nrs.NaniteError as error:
        if path.parent.name not in ("empty", "Cray_right", "japanese_bridge_garden"):
            raise
        print(error)
        return
    mesh.check()
    mesh.save(tmp_path / "m.nanite", precision="exact")
    assert nrs.NaniteMesh.open(tmp_path / "m.nanite") == mesh
    mesh.save(tmp_path / "m.nanite")
    rounded = nrs.NaniteMesh.open(tmp_path / "m.nanite")
    rounded.check()
    # Rounding may put groups into other pages, so in another order. All are there, moved by rounding alone.
    before, after = corners(mesh), corners(rounded)
    assert len(before) == len(after)
    for these, those in ((before, after), (after, before)):
        moved, _ = cKDTree(these).query(those, p=np.inf)
        assert moved.max() <= rounded.info["rounding"]
    assert len(mesh.cut(error=0.0).faces) == mesh.report.input_faces - (
        mesh.report.degenerate_faces + mesh.report.duplicate_faces
    )


@pytest.mark.parametrize("path", files("nasty") + files("cad"))
def test_nasty_and_cad_arrays_keep_their_surface(path) -> None:
    """As trimesh reads them: nothing is refused without cause, full detail is the mended source."""
    if path is None:
        data.require("nasty")
    try:
        vertices, faces = data.load_arrays(path)
    except Exception as reason:
        if path.parent.name == "negative_indices":  # trimesh cannot read it
            return
        raise AssertionError(path) from reason
    result = build_or_refuse(vertices, faces)
    if isinstance(result, nrs.NaniteError):
        assert path.parent.name in ("empty", "Cray_right"), result
        return
    cut = result.cut(error=0.0)
    assert topology.surface_difference((vertices, faces), (cut.vertices, cut.faces)) == (0, 0)


TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]])
FACE = np.array([[0, 1, 2]])


def with_vertex(value: float) -> np.ndarray:
    vertices = TRIANGLE.copy()
    vertices[1, 2] = value
    return vertices


REFUSED = {
    "no faces": (TRIANGLE, np.zeros((0, 3), int), "faces"),
    "no vertices": (np.zeros((0, 3)), np.zeros((0, 3), int), ""),
    "all degenerate": (TRIANGLE, np.array([[0, 0, 1], [1, 1, 1], [2, 0, 2]]), ""),
    "NaN": (with_vertex(np.nan), FACE, "vertices[1]"),
    "infinity": (with_vertex(np.inf), FACE, "vertices[1]"),
    "minus infinity": (with_vertex(-np.inf), FACE, "vertices[1]"),
    "index out of range": (TRIANGLE, np.array([[0, 1, 2], [0, 1, 3]]), "faces[1]"),
    "index far out of range": (TRIANGLE, np.array([[0, 1, 2**40]]), "faces[0]"),
    "index beyond 32 bits that wraps": (TRIANGLE, np.array([[0, 1, 2**32 + 2]]), "faces[0]"),
    "negative index": (TRIANGLE, np.array([[0, 1, 2], [0, -1, 2]]), "faces[1]"),
    "vertices of 2 columns": (TRIANGLE[:, :2], FACE, "vertices"),
    "faces of 4 columns": (TRIANGLE, np.array([[0, 1, 2, 0]]), "faces"),
    "flat vertices": (TRIANGLE.ravel(), FACE, "vertices"),
    "flat faces": (TRIANGLE, FACE.ravel(), "faces"),
    "float faces": (TRIANGLE, FACE.astype(float), "faces"),
    "bool faces": (TRIANGLE, FACE.astype(bool), "faces"),
    "complex vertices": (TRIANGLE.astype(complex), FACE, "vertices"),
    "text vertices": (TRIANGLE.astype(str), FACE, "vertices"),
    "object vertices": (TRIANGLE.astype(object), FACE, "vertices"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused_with_argument_and_index(name: str) -> None:
    vertices, faces, mention = REFUSED[name]
    with pytest.raises(nrs.NaniteError) as caught:
        nrs.NaniteMesh.from_arrays(vertices, faces, progress=False)
    assert isinstance(caught.value, ValueError)
    assert mention in str(caught.value), str(caught.value)


@pytest.mark.parametrize("argument", ["normals", "colors", "uvs"])
def test_attributes_of_the_wrong_length_or_with_nan_are_refused(argument: str) -> None:
    width = {"normals": 3, "colors": 4, "uvs": 2}[argument]
    with pytest.raises(nrs.NaniteError, match=argument):
        nrs.NaniteMesh.from_arrays(
            TRIANGLE, FACE, progress=False, **{argument: np.ones((2, width), np.float32)}
        )
    bad = np.ones((3, width), np.float32)
    bad[2, 1] = np.nan
    with pytest.raises(nrs.NaniteError, match=argument):
        nrs.NaniteMesh.from_arrays(TRIANGLE, FACE, progress=False, **{argument: bad})


def fan(valence: int) -> tuple[np.ndarray, np.ndarray]:
    angle = np.linspace(0, 2 * np.pi, valence, endpoint=False)
    rim = np.stack([np.cos(angle), np.zeros(valence), np.sin(angle)], axis=1)
    i = np.arange(valence)
    return np.concatenate([[[0, 0.2, 0]], rim]), np.stack(
        [np.zeros(valence, int), 1 + (i + 1) % valence, 1 + i], 1
    )


def islands(count: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    corners = rng.uniform(-1, 1, (count, 1, 3)) + rng.normal(scale=0.005, size=(count, 3, 3))
    return corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)


def stacked(copies: int) -> tuple[np.ndarray, np.ndarray]:
    """The same faces again and again, turned and as separate vertices."""
    v, f = subjects.grid(20, 20)
    return np.concatenate([v] * copies), np.concatenate(
        [np.roll(f, i, axis=1) + i * len(v) for i in range(copies)] + [f] * copies
    )


def bowties(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Edges shared by many faces."""
    angle = np.linspace(0, np.pi, count)
    tips = np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], axis=1)
    axis = np.array([[0, 0, -1], [0, 0, 1.0]])
    i = np.arange(count)
    return np.concatenate([axis, tips]), np.stack([np.zeros(count, int), np.ones(count, int), i + 2], axis=1)


BUILT = {
    "one triangle": lambda: (TRIANGLE, FACE),
    "two triangles back to back": lambda: (TRIANGLE, np.array([[0, 1, 2], [2, 1, 0]])),
    "coordinates of 1e30": lambda: (subjects.cube(12)[0] * 1e30, subjects.cube(12)[1]),
    "scale of 1e-30": lambda: (subjects.cube(12)[0] * 1e-30, subjects.cube(12)[1]),
    "scale of 1e-300": lambda: (subjects.cube(12)[0] * 1e-300, subjects.cube(12)[1]),
    "denormal float32": lambda: (np.float32(1e-42) * np.float32(subjects.cube(12)[0]), subjects.cube(12)[1]),
    "tiny and far away": lambda: (subjects.cube(12)[0] * 1e-6 + 1e6, subjects.cube(12)[1]),
    "one huge and many tiny triangles": lambda: (
        np.concatenate([subjects.cube(12)[0] * 1e-12, [[0, 0, 0], [1e12, 0, 0], [0, 1e12, 0]]]),
        np.concatenate([subjects.cube(12)[1], [np.arange(3) + len(subjects.cube(12)[0])]]),
    ),
    "all in one point but distinct": lambda: (np.zeros((300, 3)) + 1.0, np.arange(300).reshape(-1, 3)),
    "all on one line": lambda: (np.outer(np.arange(300.0), [1, 2, 3]), np.arange(300).reshape(-1, 3)),
    "duplicates": lambda: stacked(5),
    "a fan of valence 10,000": lambda: fan(10_000),
    "50,000 one-triangle islands": lambda: islands(50_000),
    "an edge of 1,000 faces": lambda: bowties(1000),
    "unreferenced vertices": lambda: (np.concatenate([np.full((1000, 3), 9.0), TRIANGLE]), FACE + 1000),
    "a needle": lambda: (np.array([[0, 0, 0], [1e6, 0, 0], [5e5, 1e-6, 0]]), FACE),
}


@pytest.mark.parametrize("name", BUILT)
def test_degenerates_are_built_or_refused(name: str) -> None:
    vertices, faces = BUILT[name]()
    for dtype in (np.float64, np.float32):
        with np.errstate(under="ignore"):
            given = np.asarray(vertices).astype(dtype)
        result = build_or_refuse(given, faces)
        if isinstance(result, nrs.NaniteError):
            # Only where nothing with an area is left in the caller's own numbers.
            area = topology.area(given, faces) if np.isfinite(given).all() else 0.0
            assert name == "all in one point but distinct" or area == 0.0, result
        else:
            assert result.report.input_faces == len(faces)
            # Where the caller's numbers are float32 nothing may be lost but degenerate and duplicate faces.
            if dtype is np.float32:
                cut = result.cut(error=0.0)
                assert topology.surface_difference((given, faces), (cut.vertices, cut.faces)) == (0, 0)


def test_report_counts_what_was_mended() -> None:
    v, f = subjects.grid(4, 4)
    vertices = np.concatenate([v, v[:5], [[7, 7, 7.0]]])
    doubled = f[:3, [1, 2, 0]]
    faces = np.concatenate([f, doubled, [[0, 0, 1], [2, 3, 2]]])
    report = nrs.NaniteMesh.from_arrays(vertices, faces, progress=False).report
    assert report.input_faces == len(faces)
    assert report.input_vertices == len(vertices)
    assert report.duplicate_faces == 3
    assert report.degenerate_faces == 2
    assert report.border_edges == 16
    assert report.non_manifold_edges == 0
