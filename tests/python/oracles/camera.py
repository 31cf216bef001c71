"""Cameras and poses in float64: OpenGL axes, −Z forward, +Y up, row 0 of an image on top."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


def look_at(
    eye: np.ndarray, target: np.ndarray, up: tuple[float, float, float] = (0.0, 1.0, 0.0)
) -> np.ndarray:
    """Camera-to-world pose at ``eye`` looking at ``target``."""
    eye, target = np.asarray(eye, float), np.asarray(target, float)
    back = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross(up, back)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3] = right, np.cross(back, right), back, eye
    return pose


def spread(count: int) -> np.ndarray:
    """Directions spread evenly over the upper half of a sphere, (count, 3)."""
    k = np.arange(count) + 0.5
    y, turn = 1 - k / count, k * np.pi * (3 - np.sqrt(5))
    return np.stack([np.sqrt(1 - y * y) * np.cos(turn), y, np.sqrt(1 - y * y) * np.sin(turn)], axis=1)


def at(x: float, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    """Pose at a place, along the axes."""
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    return pose


@dataclass(frozen=True)
class View:
    """A perspective view of a given size."""

    pose: np.ndarray
    yfov: float = 0.8
    width: int = 1280
    height: int = 720
    znear: float = 0.05

    @property
    def focal(self) -> float:
        """Pixels per unit of tangent."""
        return self.height / 2 / np.tan(self.yfov / 2)

    def with_size(self, width: int, height: int) -> View:
        """The same field of view at another resolution."""
        return View(self.pose, self.yfov, width, height, self.znear)

    def directions(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """World directions through image points, scaled so that one step is one unit of linear depth."""
        local = np.stack(
            [(x - self.width / 2) / self.focal, (self.height / 2 - y) / self.focal, -np.ones_like(x)], -1
        )
        return local @ self.pose[:3, :3].T

    def unproject(self, x: np.ndarray, y: np.ndarray, depth: np.ndarray) -> np.ndarray:
        """World points at image points and linear depths."""
        return self.pose[:3, 3] + self.directions(x, y) * np.asarray(depth, np.float64)[..., None]

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Image x, y and linear depth of world points."""
        local = (np.asarray(points, np.float64) - self.pose[:3, 3]) @ self.pose[:3, :3]
        depth = -local[..., 2]
        return (
            self.width / 2 + self.focal * local[..., 0] / depth,
            self.height / 2 - self.focal * local[..., 1] / depth,
            depth,
        )


def pixel_centers(mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Image coordinates x, y of the centres of the set pixels, row by row."""
    rows, columns = np.nonzero(mask)
    return columns + 0.5, rows + 0.5


def framing(
    vertices: np.ndarray,
    direction: tuple[float, float, float],
    *,
    fill: float = 0.9,
    up: tuple[float, float, float] = (0.0, 1.0, 0.0),
    yfov: float = 0.8,
    width: int = 1280,
    height: int = 720,
) -> View:
    """A view from ``direction`` on the middle of the vertices' box.

    It is as near as all vertices stay within ``fill`` of the image's half sizes; the near plane is at
    half the distance of the nearest vertex.
    """
    v = np.asarray(vertices, np.float64)
    center = (v.min(axis=0) + v.max(axis=0)) / 2
    toward = np.asarray(direction, float) / np.linalg.norm(direction)
    axes = look_at(center + toward, center, up)[:3, :3]
    x, y, z = ((v - center) @ axes).T
    tangent = np.tan(yfov / 2) * fill
    distance = float(np.max(z + np.maximum(np.abs(y), np.abs(x) * height / width) / tangent))
    return View(
        look_at(center + toward * distance, center, up), yfov, width, height, (distance - float(z.max())) / 2
    )
