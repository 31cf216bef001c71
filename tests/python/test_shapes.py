"""The procedural meshes: closed where they say so, outward, deterministic, and of the size asked for."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest
import trimesh

from nanite_rs import ArgumentError, shapes

CLOSED = ["cad_part", "displaced_icosphere", "gyroid_shell", "torus_knot"]


def as_trimesh(mesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(*mesh, process=False)


@pytest.mark.parametrize("name", sorted(shapes.SHAPES))
@pytest.mark.parametrize("faces", [20_000, 150_000])
def test_dtypes_ranges_and_size(name, faces):
    vertices, triangles = shapes.SHAPES[name](faces=faces)
    assert vertices.dtype == np.float32
    assert vertices.shape[1:] == (3,)
    assert triangles.dtype == np.uint32
    assert triangles.shape[1:] == (3,)
    assert vertices.flags.c_contiguous
    assert triangles.flags.c_contiguous
    assert np.isfinite(vertices).all()
    assert np.array_equal(np.unique(triangles), np.arange(len(vertices)))
    assert np.abs(vertices).max() <= 2.0
    assert 0.65 * faces <= len(triangles) <= 1.2 * faces


@pytest.mark.parametrize("seed", [0, 7])
@pytest.mark.parametrize("name", CLOSED)
def test_closed_and_outward(name, seed):
    mesh = as_trimesh(shapes.SHAPES[name](faces=60_000, seed=seed))
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0.1
    assert mesh.area_faces.min() > 0.0
    # Welding by position changes nothing: no two vertices coincide.
    assert len(np.unique(mesh.vertices, axis=0)) == len(mesh.vertices)


@pytest.mark.parametrize(("name", "euler"), [("displaced_icosphere", 2), ("torus_knot", 0), ("cad_part", 0)])
def test_topology(name, euler):
    assert as_trimesh(shapes.SHAPES[name](faces=30_000)).euler_number == euler


@pytest.mark.parametrize("faces", [100_000, 400_000])
def test_gyroid_is_of_high_genus(faces):
    assert as_trimesh(shapes.gyroid_shell(faces=faces)).euler_number < -40


def test_islands_are_that_many_and_each_is_closed():
    mesh = as_trimesh(shapes.islands(faces=8_000, count=100))
    assert mesh.body_count == 100
    assert mesh.is_watertight
    assert mesh.volume > 0.0
    assert as_trimesh(shapes.islands(faces=400, count=100)).is_watertight  # tetrahedra
    assert len(shapes.islands(faces=50_000, count=50_000)[1]) == 50_000  # single triangles


def test_terrain_faces_up_and_fan_meets_in_its_tip():
    assert as_trimesh(shapes.terrain(faces=20_000)).face_normals[:, 1].min() > 0.0
    vertices, faces = shapes.fan(faces=1_000)
    assert (faces == 0).sum() == 1_000
    assert as_trimesh((vertices, faces)).face_normals[:, 1].min() > 0.0


def test_cad_part_is_creased_thin_and_partly_flat():
    mesh = as_trimesh(shapes.cad_part(faces=60_000))
    angles = mesh.face_adjacency_angles
    assert (angles > np.radians(30)).sum() > 1_000
    assert (angles < 1e-4).mean() > 0.2
    edges = np.linalg.norm(np.diff(mesh.triangles[:, [0, 1, 2, 0]], axis=1), axis=2)
    assert np.median(edges.max(axis=1) / edges.min(axis=1)) > 10.0


def test_flat_shaded_normals_belong_to_the_faces():
    vertices, faces, normals = shapes.flat_shaded(*shapes.displaced_icosphere(faces=2_000))
    mesh = as_trimesh((vertices, faces))
    assert len(vertices) == 3 * len(faces)
    assert np.allclose(np.repeat(mesh.face_normals, 3, axis=0), normals, atol=1e-4)


@pytest.mark.parametrize(
    ("name", "digest"),
    [
        ("cad_part", "ede2a5ba87c6cee8"),
        ("displaced_icosphere", "ff4924d453f8488b"),
        ("gyroid_shell", "0d623876028a4637"),
        ("islands", "0c89b2c7d32b1179"),
        ("soup", "fe2e64452e7d6c17"),
        ("terrain", "1b20a9ae0b92c8ce"),
        ("torus_knot", "25388c380a239e44"),
    ],
)
def test_same_bytes_on_every_machine(name, digest):
    vertices, faces = shapes.SHAPES[name](faces=5_000, seed=5)
    found = hashlib.sha256(vertices.tobytes() + faces.tobytes()).hexdigest()[:16]
    assert found == digest
    other, _ = shapes.SHAPES[name](faces=5_000, seed=6)
    assert not np.array_equal(vertices[: len(other)], other)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: shapes.icosphere(faces=0), "faces: must be between 1"),
        (lambda: shapes.torus_knot(faces=-3), "faces: must be"),
        (lambda: shapes.islands(faces=10, count=20), "count: must be between 1 and faces"),
    ],
)
def test_bad_sizes_are_refused(make, message):
    with pytest.raises(ArgumentError, match=message):
        make()


def test_ten_million_triangles_take_seconds(soak):
    vertices, faces = shapes.displaced_icosphere(faces=10_000_000 if soak else 1_000_000)
    assert len(faces) >= (10_000_000 if soak else 1_000_000)
    assert len(vertices) == len(faces) // 2 + 2
