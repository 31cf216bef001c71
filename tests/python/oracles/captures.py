"""Surfaces as photogrammetry makes them: thousands of small charts, painted by where rays meet the surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import trimesh
from scipy.spatial import cKDTree

import nanite_rs as nrs

if TYPE_CHECKING:
    from collections.abc import Callable


@dataclass
class Capture:
    """A closed surface with an atlas: a chart is what is nearest to a direction, seen from there, in a cell."""

    vertices: np.ndarray
    faces: np.ndarray
    """As the surface is, without seams."""
    uvs: np.ndarray
    corners: np.ndarray
    """The rows of ``uvs`` of each face."""
    origins: np.ndarray
    """The vertex of each of those rows."""
    side: int
    """Cells along a side of the atlas."""
    views: np.ndarray
    _across: np.ndarray
    _low: np.ndarray
    _scale: np.ndarray

    def painted(self, size: int, color: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """The image of about so many texels a side of a function from points to numbers of 0 to 1."""
        own = size // self.side
        grid = (np.arange(own) + 0.5) / own
        x, y = np.meshgrid(grid, grid)
        inside = (np.stack([x.ravel(), y.ravel()], axis=1)[None] - 0.1) / 0.8
        places = self._low[:, None] + inside * self._scale[:, None, None]
        starts = np.einsum("nkj,npk->npj", self._across, places) + 4.0 * self.views[:, None]
        starts, rays = starts.reshape(-1, 3), np.repeat(-self.views, own * own, axis=0)
        surface = trimesh.Trimesh(self.vertices, self.faces, process=False)
        points, hit, _ = surface.ray.intersects_location(starts, rays, multiple_hits=False)
        found = starts + 3.0 * rays
        found[hit] = points
        cells = np.rint(255.0 * color(found)).astype(np.uint8).reshape(len(self.views), own, own, -1)
        image = np.zeros((self.side * own, self.side * own, cells.shape[3]), np.uint8)
        for number, cell in enumerate(cells):
            column, row = number % self.side, self.side - 1 - number // self.side
            image[row * own : (row + 1) * own, column * own : (column + 1) * own] = cell[::-1]
        return image

    def arrays(self) -> dict[str, np.ndarray]:
        """What `NaniteMesh.from_arrays` takes."""
        return {"vertices": self.vertices[self.origins], "faces": self.corners, "uvs": self.uvs}


def capture(faces: int, charts: int, seed: int = 3) -> Capture:
    """A stone of so many faces and charts."""
    vertices, triangles = nrs.shapes.displaced_icosphere(faces=faces, seed=seed)
    views = np.random.default_rng(seed + 1).normal(size=(charts, 3))
    views /= np.linalg.norm(views, axis=1, keepdims=True)
    side = int(np.ceil(np.sqrt(charts)))
    centers = vertices[triangles].mean(axis=1)
    _, chart = cKDTree(views).query(centers / np.linalg.norm(centers, axis=1, keepdims=True))
    pairs, corners = np.unique(
        np.repeat(chart, 3) * len(vertices) + triangles.reshape(-1), return_inverse=True
    )
    own, of_vertex = pairs // len(vertices), pairs % len(vertices)
    right = np.cross(views, np.where(np.abs(views[:, 1:2]) < 0.9, [[0.0, 1.0, 0.0]], [[1.0, 0.0, 0.0]]))
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    across = np.stack([right, np.cross(views, right)], axis=1)
    places = np.einsum("nij,nj->ni", across[own], vertices[of_vertex])
    low, high = np.full((charts, 2), np.inf), np.full((charts, 2), -np.inf)
    np.minimum.at(low, own, places)
    np.maximum.at(high, own, places)
    scale = np.maximum((high - low).max(axis=1), 1e-9)
    inside = 0.1 + 0.8 * (places - low[own]) / scale[own, None]
    cell = np.stack([own % side, own // side], axis=1)
    uvs = ((cell + inside) / side).astype(np.float32)
    low = np.where(np.isfinite(low), low, 0.0)
    return Capture(
        vertices, triangles, uvs, corners.reshape(-1, 3), of_vertex, side, views, across, low, scale
    )
