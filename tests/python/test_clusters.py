"""All clusters as arrays: what others need to draw cuts of their own."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import binary_fill_holes

import nanite_rs as nrs

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "draw_clusters.py"


@pytest.fixture(scope="module")
def mesh() -> nrs.NaniteMesh:
    vertices, faces = nrs.shapes.displaced_icosphere(faces=20_000)
    return nrs.NaniteMesh.from_arrays(
        vertices,
        faces,
        colors=np.rint(255 * np.abs(vertices) / np.abs(vertices).max()).astype(np.uint8),
        uvs=[vertices[:, :2].astype(np.float32), vertices[:, 1:].astype(np.float32)],
        face_materials=(vertices[faces].mean(axis=1)[:, 0] > 0).astype(np.int32) + 4,
    )


def sorted_rows(rows: np.ndarray) -> np.ndarray:
    return rows[np.lexsort(rows.T)]


def triangles_of(every: nrs.Clusters, drawn: np.ndarray) -> np.ndarray:
    """Corners of the triangles of some clusters, as rows of all that they carry."""
    columns = np.column_stack([every.vertices, every.normals, every.colors, *every.uvs])
    out = []
    for c in np.flatnonzero(drawn):
        first, own = every.vertex_offsets[c], slice(every.triangle_offsets[c], every.triangle_offsets[c + 1])
        corners = columns[first + every.triangles[own].astype(int)].reshape(-1, 3 * columns.shape[1])
        out.append(np.column_stack([corners, np.full(len(corners), every.materials[c])]))
    return sorted_rows(np.concatenate(out))


@pytest.mark.parametrize("error", [0.0, 0.003, 0.02, 0.2])
def test_the_rule_of_the_cut_finds_cuts(mesh, error) -> None:
    every = mesh.clusters()
    drawn = (every.errors <= error) & (every.group_errors[every.groups] > error)
    cut = mesh.cut(error=error)
    np.testing.assert_array_equal(np.sort(every.ids[drawn]), np.sort(cut.cluster_ids))
    columns = np.column_stack([cut.vertices, cut.normals, cut.colors, *cut.uvs])
    theirs = np.column_stack([columns[cut.faces].reshape(len(cut), -1), cut.face_materials])
    np.testing.assert_array_equal(triangles_of(every, drawn), sorted_rows(theirs))


def test_shapes_and_limits(mesh) -> None:
    every = mesh.clusters()
    assert len(every) == mesh.report.clusters
    assert every.triangle_offsets[-1] == len(every.triangles) == mesh.report.triangles
    assert every.vertex_offsets[-1] == len(every.vertices) == len(every.normals) == len(every.vertex_ids)
    assert np.diff(every.triangle_offsets).max() <= 128
    assert np.diff(every.vertex_offsets).max() <= 255
    assert (
        every.triangles.max(axis=1)
        < np.repeat(np.diff(every.vertex_offsets), np.diff(every.triangle_offsets))
    ).all()
    own = np.repeat(np.arange(len(every)), np.diff(every.vertex_offsets))
    assert (every.vertices >= every.lower[own]).all()
    assert (every.vertices <= every.upper[own]).all()
    assert (every.errors < every.group_errors[every.groups]).all()
    # Spheres nest, up to the rounding of what encloses them.
    inner, outer = every.spheres, every.group_spheres[every.groups]
    apart = np.linalg.norm(inner[:, :3] - outer[:, :3], axis=1)
    assert (apart + inner[:, 3] <= outer[:, 3] * (1 + 1e-5)).all()
    made = every.origins >= 0
    assert (made == (every.levels > 0)).all()
    np.testing.assert_allclose(every.errors[made], every.group_errors[every.origins[made]])
    assert repr(every).startswith(f"Clusters({len(every):,} clusters, ")


def test_of_files_and_of_bare_meshes(tmp_path) -> None:
    far = nrs.shapes.icosphere(faces=2_000)[0].astype(np.float64) + 1e7 + 1e-4
    mesh = nrs.NaniteMesh.from_arrays(far, nrs.shapes.icosphere(faces=2_000)[1])
    every = mesh.clusters()
    assert (every.vertices.dtype, every.colors, every.uvs, every.materials) == (np.float64, None, [], None)
    mesh.save(tmp_path / "far.nanite", precision="exact")
    opened = nrs.NaniteMesh.open(tmp_path / "far.nanite").clusters()
    for name in ("vertices", "triangles", "errors", "group_spheres", "ids"):
        np.testing.assert_array_equal(getattr(opened, name), getattr(every, name))


def test_the_example_draws_them(tmp_path) -> None:
    """Where wgpu finds no adapter, it says so."""
    wgpu = pytest.importorskip("wgpu")
    try:
        wgpu.gpu.request_adapter_sync()
    except RuntimeError as error:
        pytest.skip(f"no adapter: {error}")
    run = subprocess.run(
        [sys.executable, str(EXAMPLE), "", str(tmp_path / "x.png")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    drawn, _, clusters, *_ = run.stdout.split()
    assert 10 < int(drawn.replace(",", "")) < int(clusters.replace(",", "")) / 4
    picture = np.asarray(Image.open(tmp_path / "x.png"))[..., :3]
    covered = (picture < 250).any(axis=2)
    assert 0.1 < covered.mean() < 0.5
    assert not (binary_fill_holes(covered) & ~covered).any()
