"""What faces carry: labels of every face of a cut are exactly those of the source's faces there."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

import nanite_rs as nrs

VERTICES, FACES = nrs.shapes.displaced_icosphere(faces=20_000)
CENTERS = VERTICES[FACES].mean(axis=1)
SEEDS = CENTERS[np.random.default_rng(1).integers(len(FACES), size=40)]
# Segments of the surface, with a number and a pair that belong together.
SEGMENT = np.argmin(((CENTERS[:, None] - SEEDS) ** 2).sum(axis=-1), axis=1)
PAIR = np.stack([SEGMENT % 7, -SEGMENT], axis=1).astype(np.int16)
MATERIAL = (CENTERS[:, 2] > 0).astype(np.int32)
GIVEN = {"segment": SEGMENT + 1000, "pair": PAIR, "even": SEGMENT % 2 == 0}
FAST = nrs.BuildOptions(quality="fast")


@pytest.fixture(scope="module", params=["best", "fast"])
def mesh(request):
    return nrs.NaniteMesh.from_arrays(
        VERTICES,
        FACES,
        face_materials=MATERIAL,
        face_channels=GIVEN,
        options=nrs.BuildOptions(quality=request.param),
    )


def areas(vertices, faces, labels) -> np.ndarray:
    return np.bincount(labels, trimesh.triangles.area(vertices[faces].astype(np.float64)), 40)


def check(cut: nrs.Cut) -> None:
    found = dict(cut.face_channels)
    assert list(found) == list(GIVEN)
    for name, values in found.items():
        assert values.dtype == GIVEN[name].dtype
        assert len(values) == len(cut)
        at_corners = cut.channels[name][cut.faces]
        assert (at_corners == at_corners[:, :1]).all()
    # Rows are rows of the source, materials included.
    segment = found["segment"] - 1000
    assert np.array_equal(found["pair"], np.stack([segment % 7, -segment], axis=1))
    assert np.array_equal(found["even"], segment % 2 == 0)
    pairs = set(zip(SEGMENT.tolist(), MATERIAL.tolist(), strict=True))
    assert set(zip(segment.tolist(), cut.face_materials.tolist(), strict=True)) <= pairs


@pytest.mark.parametrize("reduction", [0.0, 0.5, 0.9, 0.95])
def test_faces_of_cuts_have_the_labels_of_the_source(mesh, reduction) -> None:
    for exact in (True, False):
        cut = mesh.cut(target_reduction=reduction, exact=exact)
        check(cut)
        ours, theirs = (
            areas(cut.vertices, cut.faces, cut.face_channels["segment"] - 1000),
            areas(VERTICES, FACES, SEGMENT),
        )
        assert np.abs(ours / theirs - 1).max() < (1e-5 if reduction == 0 else 0.15)
    if reduction == 0:
        away, row = cKDTree(CENTERS).query(cut.vertices[cut.faces].mean(axis=1))
        assert away.max() < 1e-6
        assert np.array_equal(cut.face_channels["segment"], GIVEN["segment"][row])
        assert np.array_equal(cut.face_materials, MATERIAL[row])
        assert np.array_equal(np.repeat(cut.cluster_materials, np.diff(cut._first_face)), cut.face_materials)


def test_files_and_pickles_keep_them(mesh, tmp_path) -> None:
    mesh.save(tmp_path / "a.nanite")
    opened = nrs.NaniteMesh.open(tmp_path / "a.nanite")
    for other in (opened, pickle.loads(pickle.dumps(mesh))):
        assert other.face_channels == mesh.face_channels
        assert list(other.channels) == other.info["channels"] == list(GIVEN)
        check(other.cut(target_faces=1_500))
    assert nrs.NaniteMesh.file_info(tmp_path / "a.nanite")["channels"] == list(GIVEN)
    check(pickle.loads(pickle.dumps(mesh.cut(target_faces=1_500))))


def test_decimated_and_cut_again() -> None:
    small = nrs.decimate((VERTICES, FACES), 2_000, face_materials=MATERIAL, face_channels=GIVEN)
    check(small)
    check(nrs.decimate(small, 1_500))


def test_materials_are_drawn_by_their_numbers(mesh, tmp_path) -> None:
    """Whatever numbers the core has for combinations of labels."""
    looks = [nrs.Material(base_color=(1, 0, 0)), nrs.Material(base_color=(0, 0, 1))]
    plain = nrs.NaniteMesh.from_arrays(VERTICES, FACES, face_materials=MATERIAL, options=FAST)
    mesh.save(tmp_path / "a.nanite")
    colors = []
    for drawn in (plain, mesh, nrs.NaniteMesh.open(tmp_path / "a.nanite")):
        scene = nrs.Scene(ambient_light=(0.5, 0.5, 0.5))
        node = scene.add(drawn, material=looks[::-1])
        node.material = looks
        pose = nrs.look_at((2, 2, 1), (0, 0, 0), up=(0, 0, 1))
        with nrs.Renderer(96, 96, backend="cpu") as renderer:
            colors.append(
                renderer.render(scene, nrs.PerspectiveCamera(0.8), pose, pixel_error=0).color.astype(int)
            )
    for color in colors[1:]:
        assert (np.abs(color - colors[0]).max(axis=-1) > 8).mean() < 0.002
    assert all((color[..., 0] > color[..., 2] + 50).any() for color in colors)


def test_without_materials_there_are_none() -> None:
    mesh = nrs.NaniteMesh.from_arrays(VERTICES, FACES, face_channels={"segment": SEGMENT}, options=FAST)
    cut = mesh.cut(error=0)
    assert cut.face_materials is None
    assert cut.cluster_materials is None
    assert set(cut.face_channels["segment"].tolist()) == set(SEGMENT.tolist())


def test_floats_become_those_of_vertices() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 2, 0]], np.float32)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    with pytest.warns(
        nrs.UsageWarning, match="face_channels: heat: floating-point data of faces are averaged"
    ):
        mesh = nrs.NaniteMesh.from_arrays(vertices, faces, face_channels={"heat": np.array([3.0, 6.0])})
    cut = mesh.cut(error=0)
    assert list(cut.face_channels) == []
    # The second triangle is twice as large.
    mean = {(0, 0): 5, (1, 0): 3, (1, 1): 5, (0, 2): 6}
    assert [mean[tuple(v)] for v in cut.vertices[:, :2].tolist()] == pytest.approx(
        cut.channels["heat"].tolist()
    )


def test_trimesh_and_ply_take_and_give_them(tmp_path) -> None:
    made = trimesh.Trimesh(VERTICES, FACES, face_attributes={"segment": SEGMENT}, process=False)
    cut = nrs.NaniteMesh.from_trimesh(made, options=FAST).cut(target_faces=2_000)
    back = cut.to_trimesh()
    assert np.array_equal(back.face_attributes["segment"], cut.face_channels["segment"])
    assert "segment" not in back.vertex_attributes
    cut.export(tmp_path / "a.ply")
    raw = trimesh.load(tmp_path / "a.ply", process=False).metadata["_ply_raw"]
    assert np.array_equal(raw["face"]["data"]["segment"].ravel(), cut.face_channels["segment"])


@pytest.mark.parametrize("package", ["pyvista", "meshio"])
def test_cell_data_of_other_packages(package) -> None:
    module = pytest.importorskip(package)
    cells = {"segment": SEGMENT, "heat": CENTERS[:, 0]}
    if package == "pyvista":
        theirs = module.PolyData.from_regular_faces(VERTICES, FACES)
        for name, values in cells.items():
            theirs.cell_data[name] = values
        theirs.cell_data["vtkOriginalCellIds"] = np.arange(len(FACES))
    else:
        theirs = module.Mesh(VERTICES, [("triangle", FACES)], cell_data={k: [v] for k, v in cells.items()})
    with pytest.warns(UserWarning, match=r"floating-point data of faces, averaged to vertices \(heat\)"):
        mesh = getattr(nrs.NaniteMesh, f"from_{package}")(theirs, options=FAST)
    cut = mesh.cut(target_faces=2_000)
    assert list(cut.face_channels) == ["segment"]
    assert np.abs(cut.channels["heat"] - cut.vertices[:, 0]).max() < 0.2
    back = getattr(cut, f"to_{package}")()
    given = back.cell_data["segment"]
    assert np.array_equal(given if package == "pyvista" else given[0], cut.face_channels["segment"])


def test_what_differs_too_much_is_left_out_of_files() -> None:
    made = trimesh.Trimesh(
        VERTICES, FACES, face_attributes={"row": np.arange(len(FACES)), "segment": SEGMENT}, process=False
    )
    with pytest.warns(UserWarning, match=r"data of faces that differ too much to be kept apart \(row\)"):
        mesh = nrs.NaniteMesh.from_trimesh(made, options=FAST)
    assert list(mesh.face_channels) == ["segment"]


@pytest.mark.parametrize(
    ("given", "more", "error", "text"),
    [
        ([1], {}, nrs.DtypeError, "face_channels: expected a mapping"),
        ({3: MATERIAL}, {}, nrs.DtypeError, "names are strings, not int"),
        ({"a": MATERIAL[:5]}, {}, nrs.ArgumentError, r"face_channels\['a'\]: expected shape \(\d+,\)"),
        ({"a": MATERIAL.astype(str)}, {}, nrs.DtypeError, r"face_channels\['a'\]: expected a floating-point"),
        ({"a": np.arange(len(FACES))}, {}, nrs.ArgumentError, "different rows of a, at most 4,096"),
        ({"a": MATERIAL}, {"face_materials": -MATERIAL}, nrs.ArgumentError, "is below 0"),
        (
            {"a": MATERIAL},
            {"face_materials": MATERIAL * 10**5},
            nrs.ArgumentError,
            "number the materials from 0",
        ),
        (
            {"a": MATERIAL},
            {"channels": {"a": VERTICES[:, 0]}},
            nrs.ArgumentError,
            "channels has one of that name",
        ),
        ({"a": MATERIAL.astype(np.int64) << 40}, {}, nrs.ArgumentError, "labels are stored in 32 bits"),
    ],
)
def test_what_cannot_be(given, more, error, text) -> None:
    with pytest.raises(error, match=text):
        nrs.NaniteMesh.from_arrays(VERTICES, FACES, face_channels=given, **more)
    with pytest.raises(error, match=text):
        nrs.decimate((VERTICES, FACES), 100, face_channels=given, **more)
