"""Pictures against pictures."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_SQUARE = np.ones((3, 3), bool)


def outside_by_more_than_a_pixel(a: np.ndarray, b: np.ndarray) -> int:
    """Pixels set in one mask that lie outside the other grown by one pixel in every direction, both ways."""
    return int(
        (a & ~ndimage.binary_dilation(b, _SQUARE)).sum() + (b & ~ndimage.binary_dilation(a, _SQUARE)).sum()
    )


def holes(a: np.ndarray, b: np.ndarray) -> int:
    """Pixels unset in one mask but inside the other shrunk by a pixel, both ways: the same test for gaps."""
    return outside_by_more_than_a_pixel(~a, ~b)


def silhouettes(depth: np.ndarray, footprint: float, steps: float = 12.0) -> np.ndarray:
    """Pixels that touch the background or a jump in depth.

    A jump is a step between neighbours of more than ``steps`` pixel footprints (``footprint`` = pixel size at
    unit depth): surfaces seen at less than about 5 degrees count as silhouettes too.
    """
    mask = depth > 0
    edge = np.zeros_like(mask)
    for axis in (0, 1):
        a = np.moveaxis(depth.astype(np.float64), axis, 0)
        m = np.moveaxis(mask, axis, 0)
        step = np.diff(a, axis=0)
        small = np.minimum(a[:-1], a[1:]) * footprint * steps
        both = m[:-1] & m[1:]
        jump = both & (np.abs(step) > small)
        e = np.moveaxis(edge, axis, 0)
        boundary = m[:-1] ^ m[1:]
        e[:-1] |= jump | boundary
        e[1:] |= jump | boundary
    return edge & mask


def away_from_silhouettes(depth: np.ndarray, footprint: float, pixels: int = 2) -> np.ndarray:
    """Covered pixels more than ``pixels`` away from any silhouette, inner ones included."""
    near = ndimage.binary_dilation(silhouettes(depth, footprint), _SQUARE, iterations=pixels)
    return (depth > 0) & ~near


def psnr(a: np.ndarray, b: np.ndarray, where: np.ndarray | None = None) -> float:
    """Peak signal to noise ratio in dB of 8-bit-scaled images over the given pixels."""
    assert a.shape == b.shape, (a.shape, b.shape)
    assert np.isfinite(np.asarray(a, float)).all()
    assert np.isfinite(np.asarray(b, float)).all()
    difference = np.asarray(a, np.float64) - np.asarray(b, np.float64)
    if where is not None:
        assert where.any(), "no pixels to compare"
        difference = difference[where]
    mse = float(np.mean(difference**2))
    return float("inf") if mse == 0 else 10 * np.log10(255**2 / mse)


def average_linear(image: np.ndarray, factor: int, gamma: float = 2.2) -> np.ndarray:
    """Averages blocks of encoded pixels in linear light and encodes again; float64 on the 0–255 scale."""
    linear = (np.asarray(image, np.float64) / 255) ** gamma
    h, w = image.shape[0] // factor, image.shape[1] // factor
    mean = linear.reshape(h, factor, w, factor, -1).mean(axis=(1, 3))
    return mean ** (1 / gamma) * 255


def save_png(path: Path, image: np.ndarray) -> Path:
    """Writes an image or a mask."""
    from PIL import Image

    path.parent.mkdir(parents=True, exist_ok=True)
    image = np.asarray(image)
    if image.dtype == bool:
        image = image.astype(np.uint8) * 255
    Image.fromarray(np.clip(np.round(image), 0, 255).astype(np.uint8)).save(path)
    return path


@contextlib.contextmanager
def evidence(path: Path, a: np.ndarray, b: np.ndarray) -> Iterator[None]:
    """When what is inside fails, both images and their difference are written to be looked at."""
    try:
        yield
    except AssertionError as failure:
        raise AssertionError(f"{failure}\nsee {save_difference(path, a, b)}") from failure


def save_difference(path: Path, a: np.ndarray, b: np.ndarray, gain: float = 8.0) -> Path:
    """Writes both images and their amplified difference side by side."""
    a, b = (np.repeat(x[..., None] * 255, 3, -1) if x.dtype == bool else np.asarray(x, float) for x in (a, b))
    return save_png(path, np.concatenate([a, b, np.abs(a - b) * gain], axis=1))
