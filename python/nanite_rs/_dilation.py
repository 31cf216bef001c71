"""Images whose empty pixels go on as what is next to them, so that filters mix in nothing foreign."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


def filled(pixels: NDArray[np.float32], known: NDArray[np.bool_], rings: int) -> NDArray[np.float32]:
    """Return an image (H, W, C) whose unknown pixels have what is around them.

    The first ``rings`` around what is known have the mean of their neighbours; all else is known from smaller and
    smaller images, so that halving mixes no other colour in (pull-push, Gortler et al. 1996).
    """
    pixels, known = pixels.copy(), known.copy()
    for _ in range(rings):
        if known.all():
            return pixels
        weight, total = _around(known.astype(np.float32)), _around(np.where(known[..., None], pixels, 0.0))
        new = ~known & (weight > 0.0)
        pixels[new] = total[new] / weight[new][:, None]
        known |= new
    return _pushed(pixels, known)


def _around(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return sums over nine pixels."""
    pad = [(1, 1), (1, 1), *[(0, 0)] * (values.ndim - 2)]
    wide = np.pad(values, pad)
    rows = wide[:-2] + wide[1:-1] + wide[2:]
    return np.asarray(rows[:, :-2] + rows[:, 1:-1] + rows[:, 2:])


def _pushed(pixels: NDArray[np.float32], known: NDArray[np.bool_]) -> NDArray[np.float32]:
    height, width = known.shape
    if known.all() or not known.any() or (height == 1 and width == 1):
        return pixels
    odd = [(0, height % 2), (0, width % 2)]
    weight = np.pad(known.astype(np.float32), odd)
    total = np.pad(np.where(known[..., None], pixels, 0.0), [*odd, (0, 0)])
    weight = weight[::2, ::2] + weight[1::2, ::2] + weight[::2, 1::2] + weight[1::2, 1::2]
    total = total[::2, ::2] + total[1::2, ::2] + total[::2, 1::2] + total[1::2, 1::2]
    small = _pushed(total / np.maximum(weight, 1.0)[..., None], weight > 0.0)
    large = small.repeat(2, axis=0).repeat(2, axis=1)[:height, :width]
    return np.where(known[..., None], pixels, large)
