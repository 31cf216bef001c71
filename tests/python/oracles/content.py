"""What a surface carries at a point, read off by libigl: nothing of nanite_rs is used."""

from __future__ import annotations

import igl
import numpy as np


class Carrier:
    """A triangle mesh whose vertices carry values."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        self.vertices = np.asarray(vertices, np.float64)
        self.faces = np.asarray(faces, np.int64)

    def find(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The face nearest to each point, and the barycentric coordinates of the place on it."""
        _, face, place = igl.point_mesh_squared_distance(points, self.vertices, self.faces)
        a, b, c = (np.ascontiguousarray(self.vertices[self.faces[face, k]]) for k in range(3))
        at = igl.barycentric_coordinates(np.ascontiguousarray(place), a, b, c)
        return face, np.nan_to_num(at, nan=1.0 / 3.0)

    def values(self, points: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Interpolated values at the places nearest to points."""
        face, at = self.find(points)
        return np.einsum("nk,nk...->n...", at, np.asarray(values, np.float64)[self.faces[face]])

    def labels(self, points: np.ndarray, labels: np.ndarray) -> np.ndarray:
        """The label of the corner that is nearest by barycentric coordinates, equal ones added."""
        face, at = self.find(points)
        corners = np.asarray(labels)[self.faces[face]]
        share = (at[:, None, :] * (corners[:, None, :] == corners[:, :, None])).sum(axis=2)
        return corners[np.arange(len(points)), share.argmax(axis=1)]


def samples(vertices: np.ndarray, faces: np.ndarray, count: int, seed: int = 0) -> np.ndarray:
    """Points spread over a surface by area."""
    rng = np.random.default_rng(seed)
    area = igl.doublearea(np.asarray(vertices, np.float64), np.asarray(faces, np.int64))
    face = rng.choice(len(faces), count, p=area / area.sum())
    u, v = rng.random((2, count))
    u, v = np.where(u + v > 1, [1 - u, 1 - v], [u, v])
    at = np.stack([1 - u - v, u, v], axis=1)
    return np.einsum("nk,nkd->nd", at, np.asarray(vertices, np.float64)[faces[face]])
