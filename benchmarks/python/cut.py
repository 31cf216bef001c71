"""Cuts of a built mesh, of whole groups and exact, against ``fast_simplification.simplify`` to the same number.

fast-simplification's thresholds are absolute, so it is run on the mesh as given and on the mesh scaled to a
diagonal of 100, where it is at its best. Deviation: 100,000 samples each way, by libigl, in units of 1e-4 of
the diagonal.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import fast_simplification
import igl
import numpy as np

import nanite_rs as nrs

from .measure import interleaved

if TYPE_CHECKING:
    from collections.abc import Callable


def run(*, quick: bool) -> dict[str, object]:
    """Times and deviations; JSON-ready."""
    vertices, faces = nrs.shapes.displaced_icosphere(faces=50_000 if quick else 1_000_000)
    source = Source(vertices, faces, samples=20_000 if quick else 100_000)
    diagonal = source.diagonal
    scaled = (vertices * (100 / diagonal)).astype(np.float32)
    signed = faces.astype(np.int32)
    mesh = nrs.NaniteMesh.from_arrays(vertices, faces, progress=False)
    rows = []
    for reduction in (0.5, 0.9, 0.99):
        contestants = {
            "nanite_rs cut": lambda _, r=reduction: mesh.cut(target_reduction=r, exact=False),
            "fast-simplification, as given": lambda _, r=reduction: fast_simplification.simplify(
                vertices, signed, r
            ),
            "fast-simplification, diagonal 100": lambda _, r=reduction: fast_simplification.simplify(
                scaled, signed, r
            ),
            "nanite_rs cut, exact": lambda _, r=reduction: mesh.cut(target_reduction=r),
        }
        times = interleaved(contestants, runs=3 if quick else 7)
        for name, call in contestants.items():
            result = call(0)
            v, f = (result.vertices, result.faces) if hasattr(result, "vertices") else result[:2]
            if name.endswith("100"):
                v = v * (diagonal / 100)
            rows.append(
                {
                    "removed": reduction,
                    "method": name,
                    "triangles": len(f),
                    "ms": times[name]["median"] * 1e3,
                    "times faster": times[name]["median"] / times["nanite_rs cut"]["median"],
                    **source.two_sided(v, f),
                }
            )
    return {"source triangles": len(faces), "rows": rows}


class Source:
    """A mesh that others are measured against by libigl: its samples and the tree over its faces, made once."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, *, samples: int) -> None:
        self.diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0)))
        self._count = samples
        self._samples = _samples(vertices, faces, samples)
        self._distances = _distances_to(vertices, faces)

    def two_sided(self, vertices: np.ndarray, faces: np.ndarray) -> dict[str, float]:
        """Mean, rms and max distance of samples of either surface to the other one, in 1e-4 of the diagonal."""
        forward = _distances_to(vertices, faces)(self._samples)
        backward = self._distances(_samples(vertices, faces, self._count))
        both = np.concatenate([forward, backward]) / self.diagonal * 1e4
        return {"mean": float(both.mean()), "rms": float(np.sqrt((both**2).mean())), "max": float(both.max())}


def _samples(v: np.ndarray, f: np.ndarray, count: int) -> np.ndarray:
    rng = np.random.default_rng(0)
    t = np.asarray(v, np.float64)[np.asarray(f, np.int64)]
    weights = np.linalg.norm(np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]), axis=1)
    t = t[rng.choice(len(t), count, p=weights / weights.sum())]
    a, b = rng.random((2, len(t), 1))
    flip = a + b > 1
    a, b = np.where(flip, 1 - a, a), np.where(flip, 1 - b, b)
    return np.ascontiguousarray(t[:, 0] + a * (t[:, 1] - t[:, 0]) + b * (t[:, 2] - t[:, 0]))


def _distances_to(v: np.ndarray, f: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    arrays = np.ascontiguousarray(v, np.float64), np.ascontiguousarray(f, np.int64)
    tree = igl.AABB()
    tree.init(*arrays)
    return lambda points: np.sqrt(np.maximum(tree.squared_distance(*arrays, points)[0], 0))
