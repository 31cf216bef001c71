"""What a ray sees first, by Embree."""

from __future__ import annotations

import numpy as np
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh


class Rays:
    """First hits on a mesh, which is moved to its centre and scaled to about 1: Embree works in float32.

    With ``culled_from``, faces turned away from that point are left out: what a renderer that culls back faces
    shows to an eye there. (Passing through back faces ray by ray would lose fronts that coincide with them.)
    """

    def __init__(
        self, vertices: np.ndarray, faces: np.ndarray, culled_from: np.ndarray | None = None
    ) -> None:
        corners = np.asarray(vertices, np.float64)[faces]
        low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
        self.center = (low + high) / 2
        self.scale = 2.0 ** -np.floor(np.log2(max(np.abs(high - low).max(), 1e-300)))
        self.rows = np.arange(len(faces))
        if culled_from is not None:
            normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            self.rows = np.flatnonzero(np.einsum("ij,ij->i", normal, corners[:, 0] - culled_from) < 0)
        self.triangles = (corners[self.rows] - self.center) * self.scale
        self.scene = rtcore_scene.EmbreeScene()
        self.mesh = TriangleMesh(self.scene, self.triangles.astype(np.float32))

    def first(self, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Face (−1 for none) and distance in units of ``directions``, from the face's plane in float64."""
        d = np.asarray(directions, np.float64)
        o = (np.broadcast_to(np.asarray(origins, np.float64), d.shape) - self.center) * self.scale
        hit = self.scene.run(np.ascontiguousarray(o, np.float32), d.astype(np.float32)).astype(np.int64)
        faces, distance = np.full(len(d), -1, np.int64), np.zeros(len(d))
        found = np.flatnonzero(hit >= 0)
        faces[found] = self.rows[hit[found]]
        t = self.triangles[hit[found]]
        normal = np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0])
        slope = np.einsum("ij,ij->i", normal, d[found])
        offset = np.einsum("ij,ij->i", normal, t[:, 0] - o[found])
        distance[found] = offset / np.where(slope == 0, np.inf, slope) / self.scale
        return faces, distance
