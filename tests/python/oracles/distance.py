"""Distances between surfaces, by libigl in float64."""

from __future__ import annotations

import igl
import numpy as np


def to_surface(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unsigned distance of each point to the surface."""
    return to_faces(points, vertices, faces)[0]


def to_faces(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unsigned distance of each point to the surface, and the nearest face."""
    squared, face, _ = igl.point_mesh_squared_distance(
        np.ascontiguousarray(points, np.float64),
        np.ascontiguousarray(vertices, np.float64),
        np.ascontiguousarray(faces, np.int64),
    )
    return np.sqrt(np.maximum(squared, 0.0)), face


def samples(vertices: np.ndarray, faces: np.ndarray, count: int, seed: int = 0) -> np.ndarray:
    """The used vertices and, up to ``count`` in all, points spread evenly over the area."""
    v = np.asarray(vertices, np.float64)
    used = v[np.unique(faces)]
    rng = np.random.default_rng(seed)
    if len(used) > count // 2:
        used = used[rng.choice(len(used), count // 2, replace=False)]
    t = v[faces]
    weights = np.linalg.norm(np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]), axis=1)
    if weights.sum() == 0:
        return used
    pick = rng.choice(len(faces), count - len(used), p=weights / weights.sum())
    a, b = rng.random((2, len(pick), 1))
    flip = a + b > 1
    a, b = np.where(flip, 1 - a, a), np.where(flip, 1 - b, b)
    t = t[pick]
    return np.concatenate([used, t[:, 0] + a * (t[:, 1] - t[:, 0]) + b * (t[:, 2] - t[:, 0])])


def one_sided(
    a: tuple[np.ndarray, np.ndarray], b: tuple[np.ndarray, np.ndarray], count: int = 50_000
) -> np.ndarray:
    """Distances of samples of surface ``a`` to surface ``b``: their maximum is a lower bound."""
    return to_surface(samples(*a, count), *b)
