"""Distances between surfaces, by libigl in float64."""

from __future__ import annotations

import functools

import igl
import numpy as np


class Surface:
    """A mesh with libigl's tree over its faces, to be asked and sampled more than once."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        self._arrays = np.ascontiguousarray(vertices, np.float64), np.ascontiguousarray(faces, np.int64)

    @functools.cached_property
    def _tree(self) -> igl.AABB:
        tree = igl.AABB()
        tree.init(*self._arrays)
        return tree

    @functools.cached_property
    def _used(self) -> np.ndarray:
        vertices, faces = self._arrays
        return vertices[np.unique(faces)]

    @functools.cached_property
    def _areas(self) -> np.ndarray:
        """Of all faces up to each."""
        t = self._arrays[0][self._arrays[1]]
        return np.cumsum(np.linalg.norm(np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]), axis=1))

    def nearest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Unsigned distance of each point to the surface, and the nearest face."""
        points = np.ascontiguousarray(points, np.float64)
        squared, face, _ = self._tree.squared_distance(*self._arrays, points)
        return np.sqrt(np.maximum(squared, 0.0)), face

    def samples(self, count: int, seed: int = 0) -> np.ndarray:
        """``count`` points: the used vertices, half at most, and others spread evenly over the area."""
        used, areas = self._used, self._areas
        rng = np.random.default_rng(seed)
        if len(used) > count // 2:
            used = used[rng.choice(len(used), count // 2, replace=False)]
        if areas[-1] == 0:
            return used
        vertices, faces = self._arrays
        t = vertices[faces[np.searchsorted(areas, rng.random(count - len(used)) * areas[-1], "right")]]
        a, b = rng.random((2, len(t), 1))
        flip = a + b > 1
        a, b = np.where(flip, 1 - a, a), np.where(flip, 1 - b, b)
        return np.concatenate([used, t[:, 0] + a * (t[:, 1] - t[:, 0]) + b * (t[:, 2] - t[:, 0])])


def to_surface(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unsigned distance of each point to the surface."""
    return Surface(vertices, faces).nearest(points)[0]


def samples(vertices: np.ndarray, faces: np.ndarray, count: int, seed: int = 0) -> np.ndarray:
    """Points of a surface, as :meth:`Surface.samples`."""
    return Surface(vertices, faces).samples(count, seed)


def one_sided(
    a: tuple[np.ndarray, np.ndarray], b: tuple[np.ndarray, np.ndarray], count: int = 50_000
) -> np.ndarray:
    """Distances of samples of surface ``a`` to surface ``b``: their maximum is a lower bound."""
    return to_surface(samples(*a, count), *b)
