"""Vertex colours: the dtypes that are kept, and the ways between them.

A colour is linear RGBA, (N, 4), of uint8, uint16 or float32. The dtype says what white is: 255, 65,535 or 1.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

ANY_DIGITS: Final = 0.1
"""How far a number of a text may lie from a byte that was written with three digits, in bytes."""
_ALL_DIGITS: Final = {np.uint8: 1e-4, np.uint16: 1e-2}
ALL_DIGITS: Final = _ALL_DIGITS[np.uint8]
"""How far a number that was stored as float32 may lie from a byte, in bytes."""
# Largest rounding of a byte or 16-bit number that was stored as float32, in its steps.


def white(dtype: Any) -> float:
    """Return what 1 is in a dtype of colours."""
    return 1.0 if np.dtype(dtype).kind == "f" else float(np.iinfo(dtype).max)


def unit(colors: NDArray[Any]) -> NDArray[np.float64]:
    """Return colours from 0 to 1."""
    return np.asarray(colors / white(colors.dtype), np.float64)


def from_srgb(encoded: NDArray[Any]) -> NDArray[Any]:
    """Return linear light of sRGB (IEC 61966-2-1), 0 to 1."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def to_srgb(linear: NDArray[Any]) -> NDArray[Any]:
    """Return sRGB of linear light."""
    return np.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear ** (1.0 / 2.4) - 0.055)


def as_bytes(colors: NDArray[Any]) -> NDArray[np.uint8]:
    """Return colours as uint8, rounded."""
    return colors if colors.dtype == np.uint8 else np.rint(unit(colors) * 255.0).astype(np.uint8)


def is_white(colors: NDArray[Any]) -> bool:
    """Whether colours change nothing."""
    return bool((colors == white(colors.dtype)).all())


def narrowed(colors: NDArray[Any], digits: float = _ALL_DIGITS[np.uint8]) -> NDArray[Any]:
    """Return floats from 0 to 1 as uint8 or uint16 if that is what they were, otherwise as float32.

    ``digits`` is how far from a byte they may lie, in bytes. What is not black stays so.
    """
    for dtype in (np.uint8, np.uint16):
        whole = stepped(colors, dtype, digits)
        if whole is not None:
            return whole
    return np.asarray(colors, np.float32)


def stepped(colors: NDArray[Any], dtype: type[Any], digits: float) -> NDArray[Any] | None:
    """Return floats from 0 to 1 as uint8 or uint16; nothing where they are not what such numbers were."""
    allowed = digits if dtype is np.uint8 else _ALL_DIGITS[dtype]
    scaled = colors * white(dtype)
    rounded = np.rint(scaled)
    lost = (rounded == 0) & (scaled > _ALL_DIGITS[dtype])
    if lost.any() or np.abs(scaled - rounded).max(initial=0.0) > allowed:
        return None
    return np.asarray(rounded.astype(dtype))


def opaque(colors: NDArray[Any]) -> NDArray[Any]:
    """Return (N, 3) or (N, 4) colours as (N, 4), contiguous."""
    if colors.shape[1] == 3:
        alpha = np.full((len(colors), 1), white(colors.dtype), colors.dtype)
        colors = np.concatenate([colors, alpha], axis=1)
    return np.ascontiguousarray(colors[:, :4])


def rgba(colors: NDArray[Any]) -> NDArray[Any]:
    """Return colours of three or more columns, of any type, in the narrowest dtype that holds them."""
    if colors.dtype.kind == "f":
        return opaque(narrowed(np.clip(np.nan_to_num(colors, nan=1.0), 0.0, 1.0)))
    if colors.dtype not in (np.uint8, np.uint16):
        colors = np.clip(colors, 0, 255).astype(np.uint8)
    return opaque(colors)


def alike(parts: Sequence[NDArray[Any] | None]) -> list[NDArray[Any] | None]:
    """Return colours of several meshes in the narrowest dtype that holds all of them."""
    kinds = {part.dtype for part in parts if part is not None}
    if len(kinds) < 2:
        return list(parts)
    if np.dtype(np.float32) in kinds:
        return [None if part is None else unit(part).astype(np.float32) for part in parts]
    steps = np.uint16(65535 // 255)
    return [part if part is None or part.dtype == np.uint16 else part * steps for part in parts]
