"""Building: triangles per second from arrays, on one thread and on two, beside fast-simplification.

The peer is what Python has for levels of detail: the mesh halved again and again by fast-simplification, down to
128 triangles. Those are whole meshes of one detail each, without stated errors. The nearest relative is
meshopt's ``clod_build``, which Rust compares with (``cargo bench --bench build``): both sides see the same arrays
in the same run there. Criterion's latest medians are read in, if there are any.
"""

from __future__ import annotations

import json
from pathlib import Path

import fast_simplification
import numpy as np

import nanite_rs as nrs

from .measure import interleaved

ROOT = Path(__file__).resolve().parents[2]
OURS = {
    "nanite_rs, proven errors, 1 thread": {"threads": 1},
    "nanite_rs, proven errors, 2 threads": {"threads": 2},
    "nanite_rs, estimated errors, 2 threads": {"threads": 2, "error": "quadric"},
}
PEER = "fast-simplification, halved again and again"


def run(*, quick: bool) -> dict[str, object]:
    """Builds the same mesh several times, contestants in turn; JSON-ready."""
    vertices, faces = nrs.shapes.displaced_icosphere(faces=100_000 if quick else 1_000_000)
    contestants = {
        method: lambda _, o=options: nrs.NaniteMesh.from_arrays(
            vertices, faces, options=nrs.BuildOptions(**o), progress=False
        )
        for method, options in OURS.items()
    }
    contestants[PEER] = lambda _: halved(vertices, faces)
    times = interleaved(contestants, runs=3, warm_up=0 if quick else 1)
    rows = [
        {
            "triangles": len(faces),
            "method": method,
            "s": t["median"],
            "Mtri/s": len(faces) / t["median"] / 1e6,
        }
        for method, t in times.items()
    ]
    return {
        "rows": rows,
        "speed-up of two threads": rows[0]["s"] / rows[1]["s"],
        "criterion": criterion("build"),
    }


def halved(vertices: np.ndarray, faces: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Levels of detail by fast-simplification, each of half the triangles of the one before."""
    levels = [(vertices, faces.astype(np.int32))]
    while len(levels[-1][1]) > 128:
        level = fast_simplification.simplify(*levels[-1], 0.5)
        if len(level[1]) >= len(levels[-1][1]):
            break
        levels.append(level)
    return levels


def criterion(group: str) -> dict[str, float]:
    """Median seconds of each of criterion's latest results whose name contains ``group``."""
    medians = {}
    for estimates in sorted((ROOT / "target" / "criterion").glob("**/new/estimates.json")):
        name = "/".join(estimates.relative_to(ROOT / "target" / "criterion").parts[:-2])
        if group in name:
            medians[name] = json.loads(estimates.read_text())["median"]["point_estimate"] / 1e9
    return medians
