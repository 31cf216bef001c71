"""Face materials: clusters of one material, lines between materials kept, surfaces closed across them."""

import igl
import numpy as np
import pytest
import trimesh

import nanite_rs as nrs
from nanite_rs import _core
from oracles import data, topology

QUALITIES = ["fast", "best"]


def build(v, f, materials, quality="fast", **content):
    options = nrs.BuildOptions(quality=quality)
    mesh = nrs.NaniteMesh.from_arrays(
        v, f, face_materials=materials, **content, options=options, progress=False
    )
    mesh.check()
    return mesh


def faces_of(vertices, faces, materials):
    """Triangles by position with their material, corners turned to a common order."""
    corners = vertices[faces].astype(np.float32) + 0.0
    turned = [min(tuple(map(tuple, np.roll(t, k, axis=0).tolist())) for k in range(3)) for t in corners]
    return sorted(zip(turned, np.asarray(materials).tolist(), strict=True))


@pytest.mark.parametrize("quality", QUALITIES)
def test_full_detail_has_the_materials_given(quality) -> None:
    v, f = nrs.shapes.icosphere(faces=5_000)
    materials = np.array([-(2**31), 2**31 - 1, 0])[np.digitize(v[f].mean(axis=1)[:, 0], [-0.2, 0.4])]
    mesh = build(v, f, materials, quality)
    cut = mesh.cut(error=0.0)
    assert cut.face_materials.dtype == np.int32
    assert faces_of(cut.vertices, cut.faces, cut.face_materials) == faces_of(v, f, materials)
    assert nrs.NaniteMesh.from_arrays(v, f).cut(error=0.0).face_materials is None


@pytest.mark.parametrize("quality", QUALITIES)
@pytest.mark.parametrize("count", [2, 7])
def test_closed_surfaces_stay_closed_and_keep_the_areas_of_materials(quality, count) -> None:
    v, f = nrs.shapes.icosphere(faces=40_000)
    towards = np.random.default_rng(2).normal(size=(3, count))
    materials = np.argmax(v[f].mean(axis=1) @ towards, axis=1)
    mesh = build(v, f, materials, quality)
    area = np.bincount(materials, igl.doublearea(v.astype(np.float64), f), count)
    for reduction in (0.5, 0.9, 0.97):
        cut = mesh.cut(target_reduction=reduction)
        assert len(cut) < 1.1 * (1.0 - reduction) * len(f)
        faces = topology.by_position(cut.vertices, cut.faces)
        assert topology.is_closed(faces)
        assert topology.euler_characteristic(faces) == 2
        found = np.bincount(
            cut.face_materials, igl.doublearea(cut.vertices.astype(np.float64), cut.faces), count
        )
        np.testing.assert_allclose(found, area, rtol=0.03)


@pytest.mark.parametrize("quality", QUALITIES)
def test_straight_lines_between_materials_stay_straight(quality) -> None:
    """On a plane the lines may only move along themselves: what is left covers what was there."""
    v, f = grid(100)
    cells = np.floor(v[f].mean(axis=1)[:, :2] * 4.0).astype(int)
    materials = cells[:, 0] + 10 * cells[:, 1]
    mesh = build(v, f, materials, quality)
    cut = mesh.cut(target_reduction=0.95)
    assert len(cut) <= 0.05 * len(f)
    middle = cut.vertices[cut.faces].mean(axis=1)
    cells = np.floor(middle[:, :2] * 4.0).astype(int)
    np.testing.assert_array_equal(cut.face_materials, cells[:, 0] + 10 * cells[:, 1])
    for k in range(2):
        corners = cut.vertices[cut.faces][:, :, k] * 4.0
        low = cells[:, k, None]
        assert (corners >= low - 1e-3).all()
        assert (corners <= low + 1 + 1e-3).all()


def grid(n):
    y, x = np.divmod(np.arange((n + 1) ** 2), n + 1)
    v = np.column_stack([x / n, y / n, np.zeros_like(x)]).astype(np.float32)
    corner = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    f = np.concatenate(
        [
            np.column_stack([corner, corner + 1, corner + n + 2]),
            np.column_stack([corner, corner + n + 2, corner + n + 1]),
        ]
    )
    return v, f


def test_clusters_have_one_material_and_none_is_lost() -> None:
    v, f = data.scan("armadillo").vertices, data.scan("armadillo").faces
    materials = np.floor(v[f].mean(axis=1)[:, 1] / np.ptp(v[:, 1]) * 6.0).astype(np.int64)
    mesh = build(v, f, materials)
    table = _core.cluster_table(mesh._core)
    cut = mesh.cut(error=0.0)
    assert np.bincount(cut.face_materials + 10).tolist() == np.bincount(materials + 10).tolist()
    coarse = mesh.cut(target_reduction=0.98)
    assert set(coarse.face_materials.tolist()) == set(materials.tolist())
    assert len(table["id"]) >= len(cut.cluster_ids) >= len(f) / 128


def test_every_face_a_material_of_its_own_changes_nothing() -> None:
    """Nothing may collapse: the DAG stays at full detail, and says why."""
    v, f = nrs.shapes.icosphere(faces=300)
    mesh = build(v, f, np.arange(len(f)))
    assert len(mesh.cut(target_faces=1)) == len(f)
    assert mesh.report.stuck


def test_trimesh_and_files(tmp_path) -> None:
    v, f = grid(20)
    materials = (np.arange(len(f)) // 7 % 3).astype(np.uint8)
    mesh = build(v, f, materials, uvs=v[:, :2])
    mesh.save(tmp_path / "m.nanite", precision="exact")
    again = nrs.NaniteMesh.open(tmp_path / "m.nanite")
    assert again == mesh
    assert mesh != build(v, f, materials[::-1], uvs=v[:, :2])
    back = mesh.cut(error=0.0).to_trimesh()
    cut = nrs.NaniteMesh.from_trimesh(back).cut(error=0.0)
    assert faces_of(cut.vertices, cut.faces, cut.face_materials) == faces_of(v, f, materials)
    textured = trimesh.Trimesh(v, f, process=False)
    textured.visual = trimesh.visual.TextureVisuals(uv=v[:, :2], face_materials=materials.astype(int))
    cut = nrs.NaniteMesh.from_trimesh(textured).cut(error=0.0)
    assert faces_of(cut.vertices, cut.faces, cut.face_materials) == faces_of(v, f, materials)
    scene = trimesh.Scene([textured, trimesh.creation.icosphere(2), textured.copy()])
    cut = nrs.NaniteMesh.from_trimesh(scene).cut(error=0.0)
    assert np.unique(cut.face_materials).tolist() == [0, 1, 2, 3, 4, 5, 6]


def test_bad_materials_are_named() -> None:
    v, f = nrs.shapes.icosphere(faces=80)
    wide = np.zeros(len(f), np.int64)
    wide[3] = 2**31
    for materials, error, message in [
        (wide, nrs.ArgumentError, r"face_materials\[3\]: 2147483648 is not between"),
        (np.zeros(len(f)), nrs.DtypeError, "expected an integer dtype, not float64"),
        (np.zeros((len(f), 1), int), nrs.ArgumentError, "expected shape"),
        (np.zeros(5, int), nrs.ArgumentError, f"expected one for each of the {len(f)} faces, found 5"),
    ]:
        with pytest.raises(error, match=message):
            nrs.NaniteMesh.from_arrays(v, f, face_materials=materials)
