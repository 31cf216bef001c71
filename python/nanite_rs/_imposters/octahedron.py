"""Directions as places in a square: the octahedral map and its upper half.

The map is that of Engelhardt and Dachsbacher ("Octahedron Environment Maps", VMV 2008) and Cigolle et al. ("A
Survey of Efficient Representations for Independent Unit Vectors", JCGT 2014). The half one, turned by 45° to fill
the square, and the three nearest views of a grid are as in Brucks' octahedral impostors (Shaderbits, 2018).
Places are (N, 2), −1 to 1; directions (N, 3) in the axes of the map, whose third points up.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

AXES: Final = {
    "y": np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
    "z": np.eye(3),
}
"""The axes of the map by what is up: rows, in those of the mesh."""


def encode(directions: NDArray[np.float64], *, full: bool) -> NDArray[np.float64]:
    """Return places of directions of any length. Of the half map, what points down is on the horizon."""
    d = np.array(directions, np.float64)
    if not full:
        d[:, 2] = np.maximum(d[:, 2], 0.0)
        d[~d.any(axis=1), 0] = 1.0  # straight down
    x, y, z = (d / np.abs(d).sum(axis=1, keepdims=True)).T
    if not full:
        return np.stack([x + y, x - y], axis=1)
    folded = np.stack([(1.0 - np.abs(y)) * _sign(x), (1.0 - np.abs(x)) * _sign(y)], axis=1)
    return np.where((z < 0.0)[:, None], folded, np.stack([x, y], axis=1))


def decode(places: NDArray[np.float64], *, full: bool) -> NDArray[np.float64]:
    """Return unit directions of places."""
    u, v = np.asarray(places, np.float64).T
    if full:
        x, y, z = u, v, 1.0 - np.abs(u) - np.abs(v)
        below = z < 0.0
        x, y = (
            np.where(below, (1.0 - np.abs(v)) * _sign(u), x),
            np.where(below, (1.0 - np.abs(u)) * _sign(v), y),
        )
    else:
        x, y = (u + v) / 2.0, (u - v) / 2.0
        z = np.maximum(1.0 - np.abs(x) - np.abs(y), 0.0)
    d = np.stack([x, y, z], axis=1)
    return np.asarray(d / np.linalg.norm(d, axis=1, keepdims=True))


def _sign(x: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.where(x < 0.0, -1.0, 1.0)


def grid(views: int, *, full: bool) -> NDArray[np.float64]:
    """Return (views, views, 3) directions of a grid that reaches the border: rows along v, columns along u."""
    side = 2.0 * np.arange(views) / (views - 1) - 1.0
    v, u = np.meshgrid(side, side, indexing="ij")
    return decode(np.stack([u.ravel(), v.ravel()], axis=1), full=full).reshape(views, views, 3)


def nearest(direction: NDArray[np.float64], views: int, *, full: bool) -> list[tuple[int, int, float]]:
    """Return row, column and weight of the corners of the grid's triangle around a direction; weights sum to 1."""
    place = encode(direction[None], full=full)[0]
    at = np.clip((place + 1.0) / 2.0, 0.0, 1.0) * (views - 1)
    column, row = (int(k) for k in np.minimum(np.floor(at), views - 2))
    x, y = float(at[0] - column), float(at[1] - row)
    between = (row, column + 1, x - y) if x > y else (row + 1, column, y - x)
    return [(row, column, 1.0 - max(x, y)), between, (row + 1, column + 1, min(x, y))]


def frame(direction: NDArray[np.float64], axes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return right, up and back of the picture from a unit direction, rows, in the axes of the mesh.

    Up is that of the map; from straight above and below, its second axis.
    """
    up = axes[2] if abs(float(direction @ axes[2])) < 0.999 else axes[1]
    right = np.cross(up, direction)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(direction, right), direction])
