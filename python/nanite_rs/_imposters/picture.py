"""The picture of an imposter: rays that are met by the depths of the three nearest views, and mixed."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from nanite_rs._imposters import octahedron, texels
from nanite_rs.camera import OrthographicCamera

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from nanite_rs.camera import Camera
    from nanite_rs.imposters import Imposter

_GRAZING = 1e-3
"""Least cosine between a ray and the direction of a view; views that are farther off have no weight."""


def rays(
    camera: Camera, pose: NDArray[np.float64], width: int, height: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return origins and directions of the pixels' rays, (N, 3), in world units.

    Directions have a length of 1 along the view axis, and origins a distance of 0: what is met at a multiple of a
    direction has that depth.
    """
    inverse = np.linalg.inv(camera.projection_matrix(width, height))
    x = (np.arange(width) + 0.5) * (2.0 / width) - 1.0
    y = 1.0 - (np.arange(height) + 0.5) * (2.0 / height)
    places = np.stack(np.broadcast_arrays(x, y[:, None]), axis=-1).reshape(-1, 2)
    ends = []
    for z in (-1.0, 0.0):
        clip = np.column_stack([places, np.full(len(places), z), np.ones(len(places))])
        at = clip @ inverse.T
        ends.append(at[:, :3] / at[:, 3:])
    along = ends[1] - ends[0]
    along /= -along[:, 2:]
    start = ends[0] + along * ends[0][:, 2:]
    return start @ pose[:3, :3].T + pose[:3, 3], along @ pose[:3, :3].T


def drawn(
    imposter: Imposter, camera: Camera, pose: NDArray[np.float64], width: int, height: int, iterations: int
) -> NDArray[np.float32]:
    """Return (height, width, channels) as views have them, the mean depth in world units along the view axis."""
    axes = octahedron.AXES[imposter.up]
    straight = isinstance(camera, OrthographicCamera)
    away = pose[:3, 3] - imposter.center
    toward = pose[:3, 2] if straight else away / np.linalg.norm(away)
    start, along = rays(camera, pose, width, height)
    start, along = (start - imposter.center) / imposter.radius, along / imposter.radius
    scale = camera.projection_matrix(width, height)
    distance = 1.0 if straight else float(away @ pose[:3, 2])
    pixel = min(2.0 / (scale[0, 0] * width), 2.0 / (scale[1, 1] * height)) * abs(distance) / imposter.radius
    # The smaller mip level of the two between which a pixel's size lies, as far as there are any.
    level = math.floor(math.log2(max(pixel * imposter.size / 2.0, 1.0)) + 1e-6)
    level = min(level, imposter.size.bit_length() - 1)
    total = np.zeros((len(start), texels.CHANNELS))
    near = octahedron.nearest(axes @ toward, imposter.views, full=imposter.full_sphere)
    for row, column, weight in near:
        if weight <= 0.0:
            continue
        view = texels.unpacked({name: imposter._layers[name][row, column] for name in texels.LAYERS})
        if level:
            view = texels.reduced(view, 1 << level)
        frame = octahedron.frame(imposter.directions[row, column], axes)
        total += weight * _seen(view, start @ frame.T, along @ frame.T, iterations)
    alpha = total[:, texels.ALPHA].copy()
    np.divide(total, alpha[:, None], out=total, where=alpha[:, None] > 0.0)
    total[:, texels.ALPHA] = alpha
    total[:, texels.NORMAL] = texels.unit(total[:, texels.NORMAL])
    return total.astype(np.float32).reshape(height, width, texels.CHANNELS)


def _seen(
    view: NDArray[np.float32], start: NDArray[np.float64], along: NDArray[np.float64], iterations: int
) -> NDArray[np.float64]:
    """Return what rays, in the frame of a view, show of it: all times alpha, its depth along the rays."""
    slope = np.minimum(along[:, 2], -_GRAZING * np.linalg.norm(along, axis=1))
    depth = np.ones(len(start))  # the plane through the centre
    for _ in range(iterations):
        found = texels.sampled(view[..., texels.DEPTH, None], _met(start, along, slope, depth))
        depth = found[:, 0].astype(np.float64)
    places = _met(start, along, slope, depth)
    weighted = view * view[..., texels.ALPHA, None]
    weighted[..., texels.ALPHA] = view[..., texels.ALPHA]
    inside = np.abs(places).max(axis=1) <= 1.0
    out = texels.sampled(weighted, places).astype(np.float64)
    out *= inside[:, None]
    alpha = out[:, texels.ALPHA]
    # Of depth d, at height 1 - d: linear, so that the mean by alpha is that of what was met.
    out[:, texels.DEPTH] = (alpha * (1.0 - start[:, 2]) - out[:, texels.DEPTH]) / slope
    return out


def _met(
    start: NDArray[np.float64],
    along: NDArray[np.float64],
    slope: NDArray[np.float64],
    depth: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return where rays are at a depth."""
    times = (1.0 - depth - start[:, 2]) / slope
    return np.asarray(start[:, :2] + along[:, :2] * times[:, None])
