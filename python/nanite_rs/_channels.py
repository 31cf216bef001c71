"""Named per-vertex channels as words of 32 bits and back."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from nanite_rs._core import ChannelRows
from nanite_rs._face_data import plain
from nanite_rs.exceptions import ArgumentError, DtypeError

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["Channel", "CutChannels", "pack"]


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


class CutChannels(Mapping[str, "NDArray[Any]"]):
    """The channels of a cut by name: each is gathered, and read if it lies in a file, when it is first looked up.

    Until then it keeps that channel of the mesh, in memory or in the open file. Looking up raises FormatError or
    FileError where the file is damaged. Pickles and copies are plain dictionaries of all channels.
    """

    __slots__ = ("_made", "_values")

    def __init__(self, channels: Sequence[ChannelRows]) -> None:
        self._values: dict[str, ChannelRows | NDArray[Any]] = {plain(rows.name): rows for rows in channels}
        self._made: dict[str, NDArray[Any]] = {}

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return the values, the same array each time."""
        value = self._values[name]
        if isinstance(value, ChannelRows):
            # Several threads may unpack it at once; the first array is kept. No thread waits for another, which
            # a forked process would lack.
            value = self._values[name] = self._made.setdefault(name, _unpacked(value))
        return value

    def __contains__(self, name: object) -> bool:
        """Whether there is such a channel; nothing is read."""
        return name in self._values

    def __iter__(self) -> Iterator[str]:
        """Names, in the order in which they were given."""
        return iter(self._values)

    def __len__(self) -> int:
        """Return the number of channels."""
        return len(self._values)

    def __repr__(self) -> str:
        """Names."""
        return f"CutChannels({list(self)})"

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle as a dictionary."""
        return dict, (dict(self),)


def _unpacked(rows: ChannelRows) -> NDArray[Any]:
    """A channel of a cut as an array of its own dtype and number of dimensions."""
    target = np.dtype(rows.dtype)
    stored: type[Any] = {"f": np.float32, "i": np.int32}.get(target.kind, np.uint32)
    values: NDArray[Any] = rows.words().view(stored).astype(target, copy=False)
    return values[:, 0].copy() if rows.columns is None else values
