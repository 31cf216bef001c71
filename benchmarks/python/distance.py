"""Distances of points to a mesh against libigl and trimesh, and of two meshes sampled and bounded.

Processor time of all threads, since libigl and nanite_rs use several; building the tree is part of every call.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import igl
import numpy as np
import trimesh

import nanite_rs as nrs

if TYPE_CHECKING:
    from collections.abc import Callable


def _seconds(call: Callable[[], object], runs: int) -> float:
    """Median processor seconds."""
    spent = []
    for _ in range(runs):
        before = time.process_time()
        call()
        spent.append(time.process_time() - before)
    return float(np.median(spent))


def run(*, quick: bool) -> dict[str, object]:
    """Microseconds per point and per triangle; JSON-ready."""
    rows = []
    points_count, runs = (20_000, 3) if quick else (200_000, 5)
    for faces_count in (20_000,) if quick else (20_000, 200_000, 1_000_000):
        v, f = nrs.shapes.displaced_icosphere(faces=faces_count)
        v, f64 = v.astype(np.float64), f.astype(np.int64)
        rng = np.random.default_rng(0)
        points = v[rng.integers(0, len(v), points_count)] + 0.01 * rng.normal(size=(points_count, 3))
        few = points[: points_count // 20]
        mesh = trimesh.Trimesh(v, f64, process=False)
        contestants: dict[str, tuple[Callable[[], object], int]] = {
            "nanite_rs": (lambda v=v, f=f, p=points: nrs.measure.closest_points(p, (v, f)), len(points)),
            "libigl": (lambda v=v, f=f64, p=points: igl.point_mesh_squared_distance(p, v, f), len(points)),
            "trimesh": (lambda m=mesh, p=few: trimesh.proximity.closest_point(m, p), len(few)),
        }
        for name, (call, count) in contestants.items():
            seconds = _seconds(call, runs if name != "trimesh" else 1)
            rows.append(
                {"triangles": len(f), "method": name, "points": count, "µs per point": seconds / count * 1e6}
            )
        cut = nrs.NaniteMesh.from_arrays(v, f, progress=False).cut(target_reduction=0.9)
        both = len(f) + len(cut)
        for name, options in {
            "surface_distance, sampled": {},
            "surface_distance, bounded to 1 %": {"mode": "bounded", "samples": 1_000},
        }.items():
            seconds = _seconds(lambda c=cut, o=options, m=(v, f): nrs.measure.surface_distance(m, c, **o), 3)
            rows.append(
                {"triangles": both, "method": name, "points": 0, "µs per point": seconds / both * 1e6}
            )
    return {"note": "for surface_distance, microseconds per triangle of both meshes", "rows": rows}
