"""What ``zoo.py`` measures: distances both ways, area whose side is turned, edges that are open, shared or folded.

Distances are libigl's, in float64, of samples spread evenly over the area.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import igl
import numpy as np
from scipy.spatial import cKDTree

from .zoo_meshes import welded

NEIGHBOURS = 48
"""Samples of the source around a point in doubt that are tried before its triangles are."""
EXACT = 300
"""Most points in doubt of a mesh that are held against every triangle; more are extrapolated from so many."""
PROOF = 400
"""Most samples farther off than a cut states that are held against every triangle."""


@dataclass
class Doubts:
    """Samples of a surface whose nearest triangle of the source faces away, of so many samples."""

    points: np.ndarray
    normals: np.ndarray
    distances: np.ndarray
    samples: int


class Reference:
    """The source that others are measured against: its samples and the tree over its faces, made once."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, samples: int) -> None:
        self.diagonal = float(np.linalg.norm(np.ptp(np.asarray(vertices, np.float64), axis=0)))
        self.surface = Surface(vertices, faces)
        self.count = samples
        self._samples, _ = self.surface.samples(samples)

    def distances(self, vertices: np.ndarray, faces: np.ndarray) -> tuple[dict[str, float], Doubts]:
        """Mean, rms and max, of two directions the larger, in 1e-4 of the diagonal; and what may be turned."""
        other = Surface(vertices, faces)
        there, of = other.samples(self.count)
        out, nearest = self.surface.nearest(there)
        back, _ = other.nearest(self._samples)
        scale = 1e4 / self.diagonal
        found = {
            "mean": float(max(out.mean(), back.mean())) * scale,
            "rms": float(np.sqrt(max((out**2).mean(), (back**2).mean()))) * scale,
            "max": float(max(out.max(), back.max())) * scale,
        }
        normals = other.normals[of]
        away = (normals * self.surface.normals[nearest]).sum(axis=1) <= 0
        return found, Doubts(there[away], normals[away], out[away], self.count)

    @functools.cached_property
    def _dense(self) -> tuple[cKDTree, np.ndarray]:
        points, face = self.surface.samples(4 * self.count)
        return cKDTree(points), self.surface.normals[face]

    def turned(self, doubts: Doubts, allowed: float) -> float:
        """Share of the area such that nothing of the source within ``allowed`` faces the same way.

        Or within the distance of its nearest point, where that is more.
        """
        if not len(doubts.points):
            return 0.0
        tree, facing = self._dense
        reach = np.maximum(1.01 * doubts.distances, allowed) + 1e-9 * self.diagonal
        away, which = tree.query(doubts.points, k=NEIGHBOURS)
        along = np.einsum("ikj,ij->ik", facing[which], doubts.normals)
        left = np.flatnonzero(~((along > 0) & (away <= reach[:, None])).any(axis=1))
        some = left if len(left) <= EXACT else np.random.default_rng(0).permutation(left)[:EXACT]
        bad = sum(not self.surface.faces_along(doubts.points[i], doubts.normals[i], reach[i]) for i in some)
        return bad * len(left) / max(len(some), 1) / doubts.samples

    def beyond(self, vertices: np.ndarray, faces: np.ndarray, stated: float) -> tuple[float, bool]:
        """The largest distance, and whether one is more than ``stated``, in the units of the mesh.

        libigl is off by up to the width of a sliver, so samples that it finds too far off are measured once more.
        """
        other = Surface(vertices, faces)
        most, least = 0.0, 1e-10 * float(np.abs(self.surface.vertices).max())
        for points, surface in ((other.samples(self.count)[0], self.surface), (self._samples, other)):
            away, _ = surface.nearest(points)
            far = np.flatnonzero(away > stated)
            most = max(most, float(np.delete(away, far).max(initial=0)))
            far = far[np.argsort(-away[far])]
            rest = np.random.default_rng(0).permutation(far[PROOF // 2 :])
            for i in np.concatenate([far[: PROOF // 2], rest[: PROOF // 2]]):
                most = max(most, surface.distance(points[i], away[i]))
        return most, most > stated * (1 + 1e-6) + least


class Surface:
    """A mesh with normals, samples and libigl's tree over its faces."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        self.vertices = np.ascontiguousarray(vertices, np.float64)
        self.faces = np.ascontiguousarray(faces, np.int64)
        a, b, c = self.vertices[self.faces].swapaxes(0, 1)
        normals = np.cross(b - a, c - a)
        lengths = np.linalg.norm(normals, axis=1)
        self.normals = normals / np.where(lengths > 0, lengths, 1)[:, None]
        self.areas = lengths / 2

    @functools.cached_property
    def _tree(self) -> igl.AABB:
        tree = igl.AABB()
        tree.init(self.vertices, self.faces)
        return tree

    def nearest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance of each point to the surface, and the nearest face."""
        squared, face, _ = self._tree.squared_distance(self.vertices, self.faces, points)
        return np.sqrt(np.maximum(squared, 0)), face

    def samples(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Points spread evenly over the area, and the face of each."""
        rng = np.random.default_rng(0)
        face = rng.choice(len(self.faces), count, p=self.areas / self.areas.sum())
        t = self.vertices[self.faces[face]]
        a, b = rng.random((2, count, 1))
        flip = a + b > 1
        a, b = np.where(flip, 1 - a, a), np.where(flip, 1 - b, b)
        return np.ascontiguousarray(t[:, 0] + a * (t[:, 1] - t[:, 0]) + b * (t[:, 2] - t[:, 0])), face

    @functools.cached_property
    def _balls(self) -> tuple[np.ndarray, np.ndarray]:
        corners = self.vertices[self.faces]
        middle = corners.mean(axis=1)
        return middle, np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)

    def distance(self, point: np.ndarray, reach: float) -> float:
        """Distance of one point that is known to be within ``reach``, by every triangle that may be nearest."""
        middle, radius = self._balls
        near = np.linalg.norm(middle - point, axis=1) <= radius * (1 + 1e-9) + reach
        return float(_to_triangles(point, self.vertices[self.faces[near]]).min())

    def faces_along(self, point: np.ndarray, normal: np.ndarray, reach: float) -> bool:
        """Whether any face within ``reach`` of a point faces the way that ``normal`` does."""
        middle, radius = self._balls
        near = np.flatnonzero(self.normals @ normal > 0)
        near = near[np.linalg.norm(middle[near] - point, axis=1) <= radius[near] + reach]
        if not len(near):
            return False
        return bool(_to_triangles(point, self.vertices[self.faces[near]]).min() <= reach)


def _to_triangles(point: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Distance of a point to each triangle."""
    edges = np.roll(triangles, -1, axis=1) - triangles
    to = point - triangles
    along = (to * edges).sum(axis=2) / np.maximum((edges**2).sum(axis=2), 1e-300)
    least = np.linalg.norm(to - np.clip(along, 0, 1)[..., None] * edges, axis=2).min(axis=1)
    normal = np.cross(edges[:, 0], edges[:, 1])
    inside = (np.cross(edges, to) * normal[:, None]).sum(axis=2).min(axis=1) >= 0
    height = np.abs((to[:, 0] * normal).sum(axis=1)) / np.maximum(np.linalg.norm(normal, axis=1), 1e-300)
    return np.where(inside, np.minimum(height, least), least)


def edge_counts(vertices: np.ndarray, faces: np.ndarray) -> dict[str, int]:
    """Edges with one face, with more than two, and with two that are folded onto one another, by position."""
    vertices, faces = welded(vertices, faces)
    if not len(faces):
        return {"open": 0, "shared": 0, "folded": 0}
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    key = (np.minimum(start, end) << 32) | np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    _, first, count = np.unique(key[order], return_index=True, return_counts=True)
    pair = order[first[count == 2][:, None] + [0, 1]]
    pair = pair[(start < end)[pair].sum(axis=1) == 1]  # the two go along it in opposite directions
    normals = Surface(vertices, faces).normals[pair // 3]
    return {
        "open": int((count == 1).sum()),
        "shared": int((count > 2).sum()),
        "folded": int(((normals[:, 0] * normals[:, 1]).sum(axis=1) < -0.9).sum()),
    }
