"""Clusters and groups by graph partitioning: limits, determinism, islands, and fewer edges cut."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import nanite_rs as nrs
from oracles.dag import Dag

CHOICES = [("metis", "meshopt"), ("median", "metis"), ("metis", "metis")]


def scattered(count: int) -> tuple[np.ndarray, np.ndarray]:
    """A sphere with ``count`` tetrahedra around it."""
    vertices, faces = nrs.shapes.displaced_icosphere(faces=20_000)[:2]
    rng = np.random.default_rng(1)
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    places = rng.normal(size=(count, 1, 3))
    places *= 1.5 / np.linalg.norm(places, axis=2, keepdims=True)
    leaves = (places + 0.01 * corners).reshape(-1, 3)
    sides = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])
    own = (4 * np.arange(count)[:, None, None] + sides).reshape(-1, 3)
    return np.concatenate([vertices, leaves]).astype(np.float32), np.concatenate([faces, own + len(vertices)])


@pytest.mark.parametrize(("clusterizer", "partition"), CHOICES)
def test_every_face_once_within_the_limits_whatever_the_threads(tmp_path, clusterizer, partition):
    vertices, faces = scattered(3_000)
    files = []
    for threads in (1, 2, 3):
        options = nrs.BuildOptions(
            cluster_triangles=100,
            cluster_vertices=120,
            clusterizer=clusterizer,
            partition=partition,
            face_ids=True,
            threads=threads,
        )
        mesh = nrs.NaniteMesh.from_arrays(vertices, faces, options=options)
        mesh.save(tmp_path / "mesh.nanite")
        files.append((tmp_path / "mesh.nanite").read_bytes())
    assert files[0] == files[1] == files[2]
    mesh.check()
    dag = Dag.of(mesh)
    assert dag.triangles.max() <= 100
    assert np.bincount(dag.group).max() <= 32
    assert np.array_equal(np.sort(mesh.source_face_ids), np.arange(len(faces)))
    full = mesh.cut(error=0.0)
    assert len(full) == len(faces)
    counts = np.bincount(full.face_clusters)
    assert counts.max() <= 100
    for cluster in range(len(counts)):
        assert len(np.unique(full.faces[full.face_clusters == cluster])) <= 120
    assert len(mesh.cut(target_faces=1)) < 400


def border_edges(mesh: nrs.NaniteMesh) -> int:
    """Edges of the source between two clusters."""
    cut = mesh.cut(error=0.0)
    ends = np.sort(cut.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    cluster = np.repeat(cut.face_clusters, 3)
    order = np.lexsort(ends.T)
    ends, cluster = ends[order], cluster[order]
    same = (ends[1:] == ends[:-1]).all(axis=1)
    return int((same & (cluster[1:] != cluster[:-1])).sum())


def test_metis_cuts_fewer_edges():
    vertices, faces = nrs.shapes.displaced_icosphere(faces=100_000)[:2]
    cut = {
        name: border_edges(
            nrs.NaniteMesh.from_arrays(vertices, faces, options=nrs.BuildOptions(clusterizer=name))
        )
        for name in ("median", "flex", "metis")
    }
    print(cut)
    assert cut["metis"] < 0.9 * cut["median"]


def test_unknown_partitions_are_named():
    with pytest.raises(nrs.ArgumentError, match=r'partition.*"meshopt" or "metis", not "scotch"'):
        nrs.NaniteMesh.from_arrays(
            *nrs.shapes.icosphere(faces=100)[:2], options=nrs.BuildOptions(partition="scotch")
        )


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs /proc/self/status, which Linux has")
def test_signal_handlers_stay_as_they_are():
    def caught() -> str:
        lines = Path("/proc/self/status").read_text().splitlines()
        return next(line for line in lines if line.startswith("SigCgt"))

    before = caught()
    options = nrs.BuildOptions(clusterizer="metis", partition="metis", error="quadric")
    nrs.NaniteMesh.from_arrays(*nrs.shapes.displaced_icosphere(faces=50_000)[:2], options=options)
    assert caught() == before
