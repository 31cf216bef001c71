"""Nothing gets stuck: coarser levels lead up to a root of one cluster, and closed meshes stay closed."""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np
import pytest

import nanite_rs as nrs
from oracles import data, subjects, topology
from oracles.dag import Dag

FOLDERS = ("nasty", "cad", "foliage", "gltf", "scans")
CUTS = 40 if os.environ.get("NANITE_SOAK") else 8
"""Cuts of each closed mesh."""
REFUSED = ("empty",)
"""Without triangles."""


def slivers(count: int = 4000, aspect: float = 1e6) -> tuple[np.ndarray, np.ndarray]:
    """A strip of triangles that are `aspect` times as long as wide, beside squares of the same length."""
    strip, faces = subjects.grid(count, 1)
    strip = strip * [count / aspect, 1.0, 1.0]
    plain, plain_faces = subjects.grid(40, 40)
    return np.concatenate([strip, plain + np.array([0, 1, 0])]), np.concatenate(
        [faces, plain_faces + len(strip)]
    )


def noise_soup(count: int = 3000) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of random vertices: every edge has many faces, every vertex hundreds."""
    rng = np.random.default_rng(3)
    return rng.random((60, 3)), np.sort(rng.integers(0, 60, (count, 3)), axis=1)


GENERATED = {
    "flat-shaded mesh": lambda: nrs.shapes.flat_shaded(*nrs.shapes.displaced_icosphere(faces=20_000)),
    "triangle soup": lambda: nrs.shapes.soup(faces=8_000),
    "soup of shared vertices": noise_soup,
    "islands of one triangle": lambda: nrs.shapes.islands(faces=20_000, count=20_000),
    "islands of four": lambda: nrs.shapes.islands(faces=16_000, count=4_000),
    "islands of eighty": lambda: nrs.shapes.islands(faces=40_000, count=500),
    "foliage": lambda: nrs.shapes.foliage(faces=20_000),
    "slivers": slivers,
    "part": lambda: nrs.shapes.cad_part(faces=30_000),
    "cube soup": lambda: subjects.soup_of(*subjects.cube(32)),
}


def check_root(mesh: nrs.NaniteMesh) -> None:
    """A valid DAG whose roots are 1 % of the triangles, or eight; what is more has its reason in the report."""
    mesh.check()
    report = mesh.report
    source = report.input_faces - report.degenerate_faces - report.duplicate_faces
    root = mesh.cut(error=float("inf"))
    stuck = sum(group.triangles for group in report.stuck)
    assert all(group.reason for group in report.stuck)
    assert len(root.faces) - stuck <= max(0.01 * source, 8), report
    assert len(root.cluster_ids) - sum(group.clusters for group in report.stuck) <= 1, report


def closed_cuts(mesh: nrs.NaniteMesh, vertices: np.ndarray, faces: np.ndarray) -> int:
    """Cuts at the error of every level and between: no edge has one face where the source has none."""
    given = topology.by_position(vertices, faces)
    if not len(given) or topology.edge_valence(given)[0] or topology.unbalanced_edges(given):
        return 0
    d = Dag.of(mesh)
    errors = np.unique(d.group_error[np.isfinite(d.group_error)])
    errors = errors[np.unique(np.linspace(0, len(errors) - 1, CUTS).astype(int))] if len(errors) else errors
    for error in errors:
        cut = mesh.cut(error=float(error))
        found = topology.by_position(cut.vertices, cut.faces)
        assert topology.unbalanced_edges(found) == 0, f"error {error}: {len(found)} faces"
        single = topology.edge_valence(found)[0]
        assert single == 0, f"error {error}: {single} edges with one face of {len(found)} faces"
    return len(errors)


@pytest.mark.parametrize("quality", ["fast", "best"])
@pytest.mark.parametrize("name", GENERATED)
def test_generated_meshes_have_a_root_and_stay_closed(name: str, quality: str) -> None:
    vertices, faces = GENERATED[name]()[:2]
    options = nrs.BuildOptions(quality=quality, error="quadric")
    mesh = nrs.NaniteMesh.from_arrays(vertices, faces, options=options, progress=False)
    check_root(mesh)
    # Where every cluster has every vertex, no vertex may move, and nothing can be done.
    assert bool(mesh.report.stuck) == (name == "soup of shared vertices"), mesh.report.stuck
    cuts = closed_cuts(mesh, vertices, faces)
    print(
        f"{name}, {quality}: {cuts} closed cuts, by step",
        np.sum([r.steps for r in mesh.report.levels], axis=0),
    )
    assert cuts or name not in (
        "flat-shaded mesh",
        "islands of four",
        "islands of eighty",
        "part",
        "cube soup",
    )


FILES = [p for folder in FOLDERS for p in data.folder_models(folder)]


@pytest.mark.parametrize("quality", ["fast", "best"])
@pytest.mark.parametrize(
    "path", [pytest.param(p, id="/".join(p.relative_to(data.shared()).parts[:2])) for p in FILES]
)
def test_real_meshes_have_a_root_and_stay_closed(path, quality: str) -> None:
    if any(name in path.parts for name in REFUSED):
        with pytest.raises(nrs.NaniteError):
            nrs.io.from_file(path)
        return
    # Without materials: lines between many of them may keep a root larger.
    source = replace(nrs.io.from_file(path), face_materials=None, materials=(), face_channels={})
    options = nrs.BuildOptions(quality=quality, error="quadric")
    mesh = nrs.NaniteMesh.from_arrays(**source.arrays(), options=options, progress=False)
    check_root(mesh)
    assert not mesh.report.stuck, mesh.report.stuck
    full = mesh.cut(error=0.0)
    print(path.parent.name, quality, closed_cuts(mesh, full.vertices, full.faces), "closed cuts")


def test_real_meshes_are_there() -> None:
    assert FILES or data.require("nasty")
