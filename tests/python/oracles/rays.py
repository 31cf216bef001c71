"""What a ray sees first, by Embree."""

from __future__ import annotations

import numpy as np
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh


class Rays:
    """First hits on a mesh, which is moved to its centre and scaled to about 1: Embree works in float32."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        used = np.asarray(vertices, np.float64)
        low, high = used[faces].min(axis=(0, 1)), used[faces].max(axis=(0, 1))
        self.center = (low + high) / 2
        self.scale = 2.0 ** -np.floor(np.log2(max(np.abs(high - low).max(), 1e-300)))
        self.triangles = (used[faces] - self.center) * self.scale
        self.scene = rtcore_scene.EmbreeScene()
        self.mesh = TriangleMesh(self.scene, self.triangles.astype(np.float32))

    def first(
        self, origins: np.ndarray, directions: np.ndarray, cull_back: bool = False
    ) -> tuple[np.ndarray, np.ndarray]:
        """Face (−1 for none) and distance in units of ``directions``.

        With ``cull_back``, rays pass through back faces. The distance is recomputed in float64 from the plane
        of the face.
        """
        o = (np.broadcast_to(np.asarray(origins, np.float64), directions.shape) - self.center) * self.scale
        d = np.asarray(directions, np.float64)
        faces = np.full(len(d), -1, np.int64)
        distance = np.zeros(len(d))
        live = np.arange(len(d))
        at = o.copy()
        for _ in range(64):
            hit = self.scene.run(at[live].astype(np.float32), d[live].astype(np.float32))
            live, hit = live[hit >= 0], hit[hit >= 0]
            if not len(live):
                break
            t = self.triangles[hit]
            normal = np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0])
            slope = np.einsum("ij,ij->i", normal, d[live])
            flat = slope == 0
            along = np.einsum("ij,ij->i", normal, t[:, 0] - o[live]) / np.where(flat, 1, slope)
            along = np.where(flat, np.linalg.norm(at[live] - o[live], axis=1), along)
            keep = (slope < 0) | (not cull_back)
            faces[live[keep]] = hit[keep]
            distance[live[keep]] = along[keep] / self.scale
            live, along = live[~keep], along[~keep]
            if not len(live):
                break
            length = np.linalg.norm(d[live], axis=1)
            at[live] = o[live] + d[live] * (along + 1e-6 / length)[:, None]
        return faces, distance
