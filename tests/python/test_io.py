"""Meshes in from files and trimesh objects: attributes, scenes, transforms, and errors that say what to do."""

from __future__ import annotations

import gzip
import sys

import numpy as np
import pytest
import trimesh

import nanite_rs as nrs
from nanite_rs import io
from oracles import data
from oracles.documents import Document


@pytest.fixture
def ball() -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=3)


def same_surface(cut: nrs.Cut, mesh: trimesh.Trimesh) -> bool:
    """Triangles as sets of corner positions, cyclic order included, in float32."""

    def key(vertices, faces):
        corners = np.asarray(vertices, np.float64).astype(np.float32)[np.asarray(faces)]
        first = np.lexsort(corners.transpose(2, 0, 1), axis=1)[:, 0]
        rolled = corners[np.arange(len(corners))[:, None], (first[:, None] + np.arange(3)) % 3]
        rows = rolled.reshape(len(corners), 9)
        return rows[np.lexsort(rows.T)]

    return np.array_equal(key(cut.vertices, cut.faces), key(mesh.vertices, mesh.faces))


@pytest.mark.parametrize("suffix", ["ply", "obj", "stl", "off", "glb"])
@pytest.mark.parametrize("packed", [False, True])
def test_every_format_gives_the_same_surface(ball, tmp_path, suffix, packed):
    ball.vertices = ball.vertices.astype(np.float32).astype(np.float64)
    path = tmp_path / f"ball.{suffix}"
    ball.export(path, **({"digits": 12} if suffix in ("obj", "off") else {}))
    if packed:
        data = gzip.compress(path.read_bytes())
        path = path.with_name(path.name + ".gz")
        path.write_bytes(data)
    mesh = nrs.NaniteMesh.from_file(path)
    assert len(mesh) == 1280
    assert mesh.check().clusters > 0
    assert same_surface(mesh.cut(error=0.0), ball)


def test_vertex_colors_travel(ball):
    colors = np.random.default_rng(0).integers(0, 256, (len(ball.vertices), 4), dtype=np.uint8)
    ball.visual = trimesh.visual.ColorVisuals(ball, vertex_colors=colors)
    cut = nrs.NaniteMesh.from_trimesh(ball).cut(error=0.0)
    place = {tuple(v): tuple(c) for v, c in zip(ball.vertices.astype(np.float32), colors, strict=True)}
    found = [tuple(c) for c in cut.colors]
    assert [place[tuple(np.float32(v))] for v in cut.vertices] == found
    back = cut.to_trimesh()
    assert np.array_equal(back.visual.vertex_colors, cut.colors)


def test_face_colors_become_vertex_colors(ball):
    colors = np.zeros((len(ball.faces), 4), np.uint8)
    colors[:, 3] = 255
    colors[: len(colors) // 2, 0] = 200
    ball.visual = trimesh.visual.ColorVisuals(ball, face_colors=colors)
    mesh = nrs.NaniteMesh.from_trimesh(ball)
    cut = mesh.cut(error=0.0)
    assert len(mesh) == len(ball.faces)
    of_face = cut.colors[cut.faces]
    assert (of_face == of_face[:, :1]).all()
    assert (of_face[:, 0, 0] == 200).sum() == len(colors) // 2


def test_uvs_and_stored_normals_travel(ball):
    uv = ball.vertices[:, :2] * 0.5 + 0.5
    normals = ball.vertices.copy()
    textured = trimesh.Trimesh(
        ball.vertices,
        ball.faces,
        vertex_normals=normals,
        visual=trimesh.visual.TextureVisuals(uv=uv),
        process=False,
    )
    source = io.from_trimesh(textured)
    assert source.normals is not None
    mesh = nrs.NaniteMesh.from_trimesh(textured)
    assert not mesh.report.computed_normals
    cut = mesh.cut(error=0.0)
    assert len(cut.uvs) == 1
    assert np.allclose(cut.uvs[0], cut.vertices[:, :2] * 0.5 + 0.5, atol=1e-6)
    assert (np.sum(cut.normals * cut.vertices, axis=1) > 0.9999).all()
    assert cut.to_trimesh().visual.uv.shape == (len(cut.vertices), 2)


def test_missing_normals_are_computed(ball):
    mesh = nrs.NaniteMesh.from_arrays(ball.vertices, ball.faces)
    assert mesh.report.computed_normals
    cut = mesh.cut(error=0.0)
    assert (np.sum(cut.normals * cut.vertices, axis=1) > 0.999).all()


def scene_of(ball: trimesh.Trimesh) -> trimesh.Scene:
    scene = trimesh.Scene()
    shift = trimesh.transformations.translation_matrix([4.0, 0.0, 0.0])
    mirror = np.diag([-1.0, 1.0, 1.0, 1.0])
    mirror[0, 3] = -4.0
    scene.add_geometry(ball, node_name="plain", geom_name="ball")
    scene.graph.update(frame_to="shifted", geometry="ball", matrix=shift)
    scene.graph.update(frame_to="mirrored", geometry="ball", matrix=mirror)
    return scene


def test_a_scene_is_flattened_with_its_transforms(ball):
    mesh = nrs.NaniteMesh.from_trimesh(scene_of(ball))
    assert len(mesh) == 3 * len(ball.faces)
    assert np.allclose(mesh.bounds, [[-5.0, -1.0, -1.0], [5.0, 1.0, 1.0]])
    cut = mesh.cut(error=0.0).to_trimesh()
    # A mirrored instance keeps its outside outside: volumes add up.
    assert cut.volume == pytest.approx(3 * ball.volume, rel=1e-5)


def test_scene_parts_with_and_without_attributes(ball):
    colored = ball.copy()
    colored.visual = trimesh.visual.ColorVisuals(
        colored, vertex_colors=[[10, 20, 30, 255]] * len(ball.vertices)
    )
    scene = trimesh.Scene({"a": colored, "b": ball.copy().apply_translation([3.0, 0.0, 0.0])})
    cut = nrs.NaniteMesh.from_trimesh(scene).cut(error=0.0)
    left = cut.vertices[:, 0] < 1.5
    assert (cut.colors[left] == (10, 20, 30, 255)).all()
    assert (cut.colors[~left] == 255).all()


def test_a_scaled_part_keeps_its_normals_perpendicular(ball):
    ball = trimesh.Trimesh(ball.vertices, ball.faces, vertex_normals=ball.vertices, process=False)
    scene = trimesh.Scene()
    scene.add_geometry(ball, transform=np.diag([1.0, 5.0, 1.0, 1.0]))
    cut = nrs.NaniteMesh.from_trimesh(scene).cut(error=0.0)
    expected = cut.vertices * (1.0, 1.0 / 25.0, 1.0)
    expected /= np.linalg.norm(expected, axis=1)[:, None]
    assert (np.sum(cut.normals * expected, axis=1) > 0.9999).all()


# --------------------------------------------------------------------------------------------------- errors


def test_missing_file(tmp_path):
    for make in (nrs.NaniteMesh.from_file, nrs.NaniteMesh.open):
        with pytest.raises(nrs.MissingFileError) as caught:
            make(tmp_path / "nothing.nanite")
        assert isinstance(caught.value, FileNotFoundError)
        assert caught.value.filename == str(tmp_path / "nothing.nanite")
    with pytest.raises(FileNotFoundError, match=r"nothing\.ply"):
        nrs.NaniteMesh.from_file(tmp_path / "nothing.ply")
    with pytest.raises(nrs.FileError):
        nrs.NaniteMesh.from_file(tmp_path)


@pytest.mark.parametrize("name", ["notes.md", "mesh", "mesh.gz"])
def test_unknown_extension_lists_the_known_ones(tmp_path, name):
    (tmp_path / name).write_text("hello")
    with pytest.raises(nrs.FormatError, match=r"extension.*trimesh reads .*obj.*ply.*stl"):
        nrs.NaniteMesh.from_file(tmp_path / name)


@pytest.mark.parametrize("suffix", ["ply", "obj", "stl", "off", "glb", "gltf", "ply.gz"])
@pytest.mark.parametrize("data", [b"", b"\x00\x01garbage\xff" * 40])
def test_damaged_files_are_typed_errors(tmp_path, suffix, data):
    path = tmp_path / f"bad.{suffix}"
    path.write_bytes(data)
    with pytest.raises((nrs.FormatError, nrs.MeshError), match=r"bad\."):
        nrs.NaniteMesh.from_file(path)


def test_no_triangles(tmp_path):
    trimesh.PointCloud(np.eye(3)).export(tmp_path / "points.ply")
    with pytest.raises(nrs.MeshError, match=r"points\.ply: there are no triangles in it"):
        nrs.NaniteMesh.from_file(tmp_path / "points.ply")
    with pytest.raises(nrs.MeshError, match="no triangles"):
        nrs.NaniteMesh.from_trimesh(trimesh.Scene())


def test_wrong_object():
    with pytest.raises(nrs.DtypeError, match=r"expected trimesh\.Trimesh or trimesh\.Scene, not list"):
        nrs.NaniteMesh.from_trimesh([1, 2])


def test_draco_without_its_package_says_what_to_install(monkeypatch):
    name = "USNM_1145291-150k-2048-medium-100k-2048_draco.glb"
    path = data.require("scans", "smithsonian_fossil_100k", name)
    assert len(nrs.NaniteMesh.from_file(path)) == 100_000
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    with pytest.raises(nrs.DependencyError, match=r"DracoPy is needed; pip install DracoPy"):
        nrs.NaniteMesh.from_file(path)


def test_extensions_that_nobody_reads_are_named(tmp_path):
    document = Document()
    document.mesh(document.quad())
    document.json["extensionsRequired"] = ["EXT_packed_by_magic"]
    with pytest.raises(nrs.FormatError, match="it requires EXT_packed_by_magic"):
        nrs.NaniteMesh.from_file(document.save(tmp_path / "packed.glb"))


def test_gzipped_scan():
    mesh = nrs.NaniteMesh.from_file(data.require("scans", "stanford_dragon_res2", "dragon_vrip_res2.ply.gz"))
    assert mesh.report.input_faces == 202_520
    assert mesh.report.duplicate_faces > 0
