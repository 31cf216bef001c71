"""Named per-vertex channels as words of 32 bits and back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from nanite_rs.exceptions import ArgumentError, DtypeError

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["Channel", "pack", "unpack"]


class Channel(NamedTuple):
    """What a mesh knows of one of its channels."""

    dtype: np.dtype[Any]
    """The dtype of its values in cuts: float32, or that of the labels given."""
    width: int
    """Values per vertex."""


def pack(channels: object, vertices: int) -> list[tuple[str, str, NDArray[np.uint32]]]:
    """Name, dtype and words of each channel.

    Raises
    ------
    ArgumentError, DtypeError
        Naming the channel, and the row and value at fault.
    """
    if channels is None:
        return []
    if not isinstance(channels, Mapping):
        raise DtypeError(f"channels: expected a mapping of names to arrays, not {type(channels).__name__}")
    return [_packed(name, value, vertices) for name, value in channels.items()]


def _packed(name: object, value: object, vertices: int) -> tuple[str, str, NDArray[np.uint32]]:
    if not isinstance(name, str):
        raise DtypeError(f"channels: names are strings, not {type(name).__name__}")
    try:
        array = np.asarray(value)
    except ValueError as error:
        raise ArgumentError(f"channels[{name!r}]: {error}") from None
    if array.ndim not in (1, 2) or len(array) != vertices:
        raise ArgumentError(
            f"channels[{name!r}]: expected shape ({vertices},) or ({vertices}, K), found {array.shape}"
        )
    kind = array.dtype.kind
    if kind == "f":
        words = np.ascontiguousarray(array, np.float32).view(np.uint32)
        return name, "float32", words
    if kind not in "biu":
        raise DtypeError(
            f"channels[{name!r}]: expected a floating-point, integer or bool dtype, not {array.dtype}"
        )
    stored = np.int32 if kind == "i" else np.uint32
    limits = np.iinfo(stored)
    if array.dtype.itemsize > 4:
        outside = np.argwhere((array < limits.min) | (array > limits.max))
        if len(outside):
            at = tuple(int(i) for i in outside[0])
            raise ArgumentError(
                f"channels[{name!r}]: labels are stored in 32 bits, {limits.min} to {limits.max} for "
                f"{array.dtype}; row {at[0]} holds {int(array[at])}"
            )
    words = np.ascontiguousarray(array.astype(stored, copy=False)).view(np.uint32)
    return name, array.dtype.newbyteorder("=").name, words


def unpack(
    layout: Sequence[tuple[str, str, int | None]], words: Sequence[NDArray[np.uint32]]
) -> dict[str, NDArray[Any]]:
    """The channels of a cut as arrays of their own dtype and number of dimensions."""
    channels = {}
    for (name, dtype, columns), rows in zip(layout, words, strict=True):
        target = np.dtype(dtype)
        stored: type[Any] = {"f": np.float32, "i": np.int32}.get(target.kind, np.uint32)
        values = rows.view(stored).astype(target, copy=False)
        channels[name] = values[:, 0].copy() if columns is None else values
    return channels
