"""Meshes of many kinds: what a cut states holds, and no cut exceeds its budget, whatever the mesh.

The meshes are those of `benchmarks/python/zoo_meshes.py`; `make soak` takes all of them, files too.
"""

import os
import sys
from pathlib import Path

import numpy as np
import pytest

import nanite_rs as nrs
from oracles import distance

sys.path.append(str(Path(__file__).resolve().parents[2]))  # where the package of the benchmarks is
from benchmarks.python import zoo_meshes

SOAK = bool(os.environ.get("NANITE_SOAK"))
FEW = (
    "small box beside large",
    "plain gears",
    "annuli",
    "fine extrusion",
    "sliced rod",
    "fins",
    "voxels",
    "hanging vertices",
    "both windings",
    "far away",
)
REMOVED = (0.5, 0.9, 0.99)
SAMPLES = 50_000 if SOAK else 10_000
"""Points on either surface; half of them are vertices, as far as there are."""


def rounding(mesh: distance.Surface, cut: distance.Surface, largest: float) -> float:
    """What libigl finds between surfaces and points of their own; 1e-10 of the largest coordinate otherwise."""
    own = max(s.nearest(s.samples(SAMPLES, 1))[0].max() for s in (mesh, cut))
    return max(float(own), 1e-10 * largest)


@pytest.mark.parametrize("quality", ["best", "fast"])
@pytest.mark.parametrize("name", zoo_meshes.ZOO if SOAK else FEW)
def test_errors_and_budgets_hold(name: str, quality: str) -> None:
    vertices, faces = zoo_meshes.ZOO[name]()
    if not len(faces) <= zoo_meshes.LARGEST:
        pytest.skip(f"{len(faces)} triangles are too many")
    options = nrs.BuildOptions(quality=quality)
    mesh = nrs.NaniteMesh.from_arrays(vertices, faces, options=options, progress=False)
    mesh.check()
    source, coarsest = distance.Surface(vertices, faces), len(mesh.cut(error=np.inf).faces)
    for removed in REMOVED:
        cut = mesh.cut(target_reduction=removed)
        budget = round((1 - removed) * len(faces), 6)
        assert len(cut.faces) <= max(budget, coarsest), f"{len(cut.faces)} triangles for {budget}"
        made = distance.Surface(cut.vertices, cut.faces)
        out, back = source.nearest(made.samples(SAMPLES))[0], made.nearest(source.samples(SAMPLES))[0]
        worst = max(out.max(), back.max())
        slack = rounding(source, made, float(np.abs(vertices).max())) if worst > cut.error else 0.0
        assert worst <= cut.error + slack, f"{removed:g} removed: {worst} is stated as {cut.error}"
