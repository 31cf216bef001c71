"""Texels of views as numbers: what they hold, how they are kept, filled, halved and filtered.

A view is (size, size, CHANNELS) float32. Where alpha is 0 the other channels say what filters may mix in.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from nanite_rs import _colors, _dilation

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

CHANNELS: Final = 11
COLOR, ALPHA, NORMAL, DEPTH, ORM = slice(0, 3), 3, slice(4, 7), 7, slice(8, 11)
"""Linear base colour; coverage; unit normal; radii behind the front plane; occlusion, roughness, metallic."""
LAYERS: Final[dict[str, tuple[int, type[Any]]]] = {
    "base_color": (4, np.uint8),
    "normal": (3, np.uint8),
    "depth": (1, np.uint16),
    "orm": (3, np.uint8),
}
"""The images that are kept: channels and dtype of each."""
DEEPEST: Final = 65_535
"""What stands for a depth of 2 radii."""
_RINGS: Final = 2
"""Texels around what is covered that take the mean of their neighbours; those further off, of larger blocks."""


def packed(view: NDArray[np.float32]) -> dict[str, NDArray[Any]]:
    """Return a view as it is kept: colours as sRGB, normals from −1..1, depths from 0..2."""
    color = np.concatenate([_colors.to_srgb(view[..., COLOR]), view[..., ALPHA, None]], axis=-1)
    normal = view[..., NORMAL] * 0.5 + 0.5
    return {
        "base_color": _rounded(color, 255).astype(np.uint8),
        "normal": _rounded(normal, 255).astype(np.uint8),
        "depth": _rounded(view[..., DEPTH] / 2.0, DEEPEST).astype(np.uint16),
        "orm": _rounded(view[..., ORM], 255).astype(np.uint8),
    }


def _rounded(values: NDArray[np.float32], most: int) -> NDArray[np.float64]:
    return np.rint(np.clip(values.astype(np.float64), 0.0, 1.0) * most)


def unpacked(layers: Mapping[str, NDArray[Any]]) -> NDArray[np.float32]:
    """Return the view that was packed."""
    color = layers["base_color"]
    view = np.empty((*color.shape[:2], CHANNELS), np.float32)
    view[..., COLOR] = _colors.from_srgb(color[..., :3] / 255.0)
    view[..., ALPHA] = color[..., 3] / 255.0
    view[..., NORMAL] = unit(layers["normal"] / 127.5 - 1.0)
    view[..., DEPTH] = layers["depth"] * (2.0 / DEEPEST)
    view[..., ORM] = layers["orm"] / 255.0
    return view


def unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return vectors of length 1, or 0 where they have none."""
    size = np.sqrt((vectors * vectors).sum(axis=-1, keepdims=True))
    return np.asarray(np.divide(vectors, size, out=np.zeros_like(vectors), where=size > 0.0))


def reduced(view: NDArray[np.float32], times: int) -> NDArray[np.float32]:
    """Return means of blocks of ``times``² texels: of alpha, and of the rest by alpha, or all alike without any."""
    whole = np.zeros((len(view) // times, len(view) // times, CHANNELS))
    weighted = np.zeros_like(whole)
    for y, x in np.ndindex(times, times):
        part = view[y::times, x::times]
        whole += part
        weighted += part * part[..., ALPHA, None]
    alpha = whole[..., ALPHA].copy()
    out = whole / times**2
    np.divide(weighted, alpha[..., None], out=out, where=alpha[..., None] > 0.0)
    out[..., ALPHA] = alpha / times**2
    out[..., NORMAL] = unit(out[..., NORMAL])
    return out.astype(np.float32)


def filled(view: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return a view whose empty texels go on as what is next to them; alpha stays."""
    out = _dilation.filled(view, view[..., ALPHA] > 0.0, _RINGS)
    out[..., NORMAL] = unit(out[..., NORMAL].astype(np.float64))
    out[..., ALPHA] = view[..., ALPHA]
    return out


def sampled(view: NDArray[np.float32], places: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return (N, channels) of a view at (N, 2) places, −1 to 1 across it, right and up: bilinear, borders go on.

    Means are plain: multiply by alpha before, where they should be by alpha.
    """
    size = len(view)
    at = (places * [0.5, -0.5] + 0.5) * size - 0.5
    base = np.floor(at)
    part = (at - base).astype(np.float32)
    x0, y0 = (np.clip(base[:, k], 0, size - 1).astype(np.int64) for k in (0, 1))
    x1, y1 = (np.clip(base[:, k] + 1, 0, size - 1).astype(np.int64) for k in (0, 1))
    x, y = part[:, :1], part[:, 1:]
    upper = view[y0, x0] * (1.0 - x) + view[y0, x1] * x
    lower = view[y1, x0] * (1.0 - x) + view[y1, x1] * x
    return np.asarray(upper * (1.0 - y) + lower * y)
