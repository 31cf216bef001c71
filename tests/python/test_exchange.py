"""Meshes of PyVista and meshio in and out; for Open3D see `make soak`, it takes half a gigabyte to install."""

from __future__ import annotations

import os
import sys

import numpy as np
import pytest

import nanite_rs as nrs

VERTICES, FACES = nrs.shapes.icosphere(faces=5_000)
CARRIED = {
    "normals": VERTICES / np.linalg.norm(VERTICES, axis=1, keepdims=True),
    "colors": np.rint(255 * np.abs(np.column_stack([VERTICES, VERTICES[:, 0]]))).astype(np.uint8),
    "uvs": (np.arctan2(VERTICES[:, 1], VERTICES[:, 0])[:, None] + [0.0, 1.0]).astype(np.float32),
    "channels": {"heat": VERTICES[:, 2].astype(np.float32), "part": (VERTICES[:, 0] > 0).astype(np.int8)},
    "face_materials": (VERTICES[FACES].mean(axis=1)[:, 1] > 0).astype(np.int32) + 3,
}


def corners(cut: nrs.Cut, channels: tuple[str, ...]) -> np.ndarray:
    """Each triangle with all that its corners carry, from its least corner on, in sorted order."""
    carried = [
        cut.vertices,
        cut.normals,
        cut.colors,
        cut.uvs[0],
        *(cut.channels[c][:, None] for c in channels),
    ]
    columns = np.concatenate([np.asarray(c, np.float64) for c in carried], axis=1)[cut.faces]
    # Corners of equal place differ in nothing here: no seams.
    first = np.lexsort(columns[..., :3].transpose(2, 0, 1))[:, 0]
    turned = columns[np.arange(len(columns))[:, None], (first[:, None] + np.arange(3)) % 3]
    flat = np.column_stack([turned.reshape(len(turned), -1), cut.face_materials])
    return flat[np.lexsort(flat.T)]


@pytest.fixture(scope="module")
def mesh() -> nrs.NaniteMesh:
    return nrs.NaniteMesh.from_arrays(VERTICES, FACES, **CARRIED, progress=False)


# With the channels that arrive.
PACKAGES = {"pyvista": ("heat", "part"), "meshio": ("heat", "part")}
if os.environ.get("NANITE_SOAK"):
    PACKAGES["open3d"] = ()


@pytest.mark.parametrize("package", PACKAGES)
def test_there_and_back(package, mesh) -> None:
    full = mesh.cut(error=0.0)
    theirs = getattr(full, f"to_{package}")()
    assert type(theirs).__module__.startswith(package)
    back = getattr(nrs.NaniteMesh, f"from_{package}")(theirs, progress=False).cut(error=0.0)
    channels = PACKAGES[package]
    assert set(back.channels) == set(channels)
    if package == "open3d":
        back.colors[:, 3] = full.colors[:, 3] = 0  # it has no alpha
    np.testing.assert_allclose(corners(back, channels), corners(full, channels), rtol=0, atol=1e-6)


def test_what_pyvista_has_of_other_kinds() -> None:
    import pyvista

    assert len(nrs.NaniteMesh.from_pyvista(pyvista.Box(level=3), progress=False)) == 6 * 2 * 16
    grid = pyvista.ImageData(dimensions=(5, 5, 5)).cast_to_unstructured_grid()
    solid = nrs.NaniteMesh.from_pyvista(grid, progress=False)
    assert len(solid) == 6 * 2 * 16
    assert solid.report.border_edges == 0
    with pytest.raises(nrs.MeshError, match="no triangles"):
        nrs.NaniteMesh.from_pyvista(pyvista.PolyData(np.eye(3)))


def test_what_meshio_has_of_other_kinds() -> None:
    import meshio

    points = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [2, 0]], float)
    cells = [("line", [[0, 1]]), ("quad", [[0, 1, 2, 3]]), ("triangle", [[1, 4, 2]])]
    flat = meshio.Mesh(points, cells, cell_data={"face_materials": [[0], [7], [9]]})
    cut = nrs.NaniteMesh.from_meshio(flat, progress=False).cut(error=0.0)
    assert np.bincount(cut.face_materials).tolist() == [0] * 7 + [2, 0, 1]
    assert not cut.vertices[:, 2].any()
    with pytest.raises(nrs.MeshError, match="its cells are: line, tetra"):
        nrs.NaniteMesh.from_meshio(meshio.Mesh(np.eye(4, 3), [("tetra", [[0, 1, 2, 3]]), ("line", [[0, 1]])]))


@pytest.mark.parametrize("package", ["pyvista", "meshio", "open3d"])
def test_other_objects_and_absent_packages(package, mesh, monkeypatch) -> None:
    with pytest.raises(nrs.DtypeError, match=r"mesh: expected .* not str"):
        getattr(nrs.NaniteMesh, f"from_{package}")("bunny.ply")
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(nrs.DependencyError, match=f"pip install {package}"):
        getattr(mesh.cut(target_faces=1), f"to_{package}")()


def test_arrays_are_shared_without_copies(mesh) -> None:
    """As torch.from_numpy and torch.from_dlpack ask for: contiguous, writable, and the memory itself."""
    cut = mesh.cut(target_faces=1_000)
    for array in (cut.vertices, cut.faces, cut.normals, cut.colors, cut.uvs[0]):
        shared = np.from_dlpack(array)
        assert np.shares_memory(shared, array)
        assert array.flags.c_contiguous
        assert array.flags.writeable


def textured() -> tuple[nrs.NaniteMesh, list[np.ndarray]]:
    """Two textures, one of which lies turned and shifted on the second UV set, and a plain colour."""
    rng = np.random.default_rng(0)
    images = [rng.integers(0, 255, (8, 16, count)).astype(np.uint8) for count in (3, 4)]
    looks = [
        nrs.Material(base_color_texture=nrs.Texture(images[0])),
        nrs.Material(base_color_texture=nrs.Texture(images[1], uv_set=1, offset=(0.25, 0.5), rotation=0.5)),
        nrs.Material(base_color=(1.0, 0.0, 0.0)),
    ]
    uvs = [VERTICES[:, :2].astype(np.float32), VERTICES[:, 1:].astype(np.float32)]
    part = (VERTICES[FACES].mean(axis=1)[:, 2] * 1.5 + 1.5).astype(np.int32)
    mesh = nrs.NaniteMesh.from_arrays(VERTICES, FACES, uvs=uvs, materials=looks, face_materials=part)
    return mesh, images


def expected_uvs(cut: nrs.Cut) -> np.ndarray:
    """Of each material where its texture lies, from glTF's own words: scale, turn, shift, counted from the top."""
    u, v = cut.uvs[1][:, 0], 1.0 - cut.uvs[1][:, 1]
    cos, sin = np.cos(0.5), np.sin(0.5)
    turned = np.column_stack([cos * u + sin * v + 0.25, 1.0 - (cos * v - sin * u + 0.5)])
    corners = np.where((cut.face_materials == 1)[:, None, None], turned[cut.faces], cut.uvs[0][cut.faces])
    return corners.reshape(-1, 2)


def test_textures_in_pyvista() -> None:
    mesh, images = textured()
    cut = mesh.cut(target_reduction=0.5)
    parts = cut.to_pyvista(textured=True)
    assert len(parts) == 3
    expected = expected_uvs(cut).reshape(-1, 3, 2)
    for number, (part, texture) in enumerate(parts):
        own = cut.face_materials == number
        assert part.n_cells == own.sum()
        np.testing.assert_array_equal(part.points[part.regular_faces], cut.vertices[cut.faces[own]])
        if number == 2:
            assert texture is None
            continue
        np.testing.assert_array_equal(texture.to_array(), images[number])
        uvs = part.point_data.active_texture_coordinates
        np.testing.assert_allclose(uvs[part.regular_faces], expected[own], atol=1e-6)
    with pytest.raises(nrs.DtypeError, match="textured: expected True or False"):
        cut.to_pyvista(textured="yes")


class StandIn:
    """What of Open3D is used, where it is not installed: arrays as they are given."""

    class utility:
        Vector2dVector = Vector3dVector = Vector3iVector = IntVector = staticmethod(np.asarray)

    class geometry:
        Image = staticmethod(np.asarray)

        class TriangleMesh:
            def __init__(self, vertices, triangles) -> None:
                self.vertices, self.triangles = vertices, triangles


def test_textures_in_open3d(monkeypatch) -> None:
    if "open3d" not in PACKAGES:
        monkeypatch.setitem(sys.modules, "open3d", StandIn)
    mesh, images = textured()
    cut = mesh.cut(target_reduction=0.5)
    theirs = cut.to_open3d()
    found = [np.asarray(image) for image in theirs.textures]
    np.testing.assert_array_equal(found[0], images[0][::-1])
    np.testing.assert_array_equal(found[1], images[1][::-1, :, :3])
    np.testing.assert_array_equal(found[2], [[[255, 0, 0]]])
    np.testing.assert_array_equal(np.asarray(theirs.triangle_material_ids), cut.face_materials)
    np.testing.assert_allclose(np.asarray(theirs.triangle_uvs), expected_uvs(cut), atol=1e-6)


def test_meshio_has_no_place_for_materials() -> None:
    mesh, _ = textured()
    with pytest.warns(UserWarning, match="materials and their textures"):
        mesh.cut(target_faces=100).to_meshio()
