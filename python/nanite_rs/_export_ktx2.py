"""KTX 2.0 of Basis Universal: what ``KHR_texture_basisu`` of glTF has, with all smaller versions of an image.

The encoder writes files of its own, whose parts are put in the order of KTX here (https://registry.khronos.org/KTX).
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from nanite_rs import _core

if TYPE_CHECKING:
    from numpy.typing import NDArray

KTX2: Final = b"\xabKTX 20\xbb\r\n\x1a\n"
"""What a file begins with."""

# What is read of the head of a .basis file, and of a slice of it, which is a level of an image or its alpha.
_HEAD: Final = struct.Struct("<14x3s3xB18xHI3sHI3sIII")
_SLICE: Final = struct.Struct("<3xBBHH4xII2x")
_HAS_ALPHA: Final = 1
_ETC1S: Final = 0
# Of the data format descriptor.
_MODELS: Final = {"etc1s": 163, "uastc": 166}
_BT709, _LINEAR, _SRGB = 1, 1, 2
_RGB, _RGBA, _ALPHA = 0, 3, 15
_BASIS_LZ, _ZSTD = 1, 2
_BLOCK: Final = 4


def encoded(levels: list[NDArray[np.uint8]], color: bool) -> bytes:
    """Encode an image and its halvings, each (H, W, 4): colours, sRGB, as ETC1S, everything else as UASTC."""
    return _ordered(_core.encode_basis(levels, color), color)


def in_blocks(pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return an image whose sides are multiples of four, as glTF asks for."""
    height, width = pixels.shape[:2]
    size = tuple(max(_BLOCK * round(side / _BLOCK), _BLOCK) for side in (width, height))
    if size == (width, height):
        return np.ascontiguousarray(pixels)
    from PIL import Image

    # Alpha by itself: colours stay as they are where it is 0.
    parts = [
        Image.fromarray(np.ascontiguousarray(pixels[..., k])).resize(size, Image.Resampling.BICUBIC)
        for k in range(4)
    ]
    return np.ascontiguousarray(np.stack([np.asarray(part) for part in parts], axis=2))


def _ordered(basis: bytes, color: bool) -> bytes:
    """Return the parts of a .basis file as KTX 2.0."""
    (
        slices,
        kind,
        endpoints,
        endpoints_at,
        endpoints_size,
        selectors,
        selectors_at,
        selectors_size,
        tables_at,
        tables_size,
        slices_at,
    ) = _HEAD.unpack_from(basis)
    etc1s = kind == _ETC1S
    levels: dict[int, dict[str, Any]] = {}
    for k in range(_number(slices)):
        level, flags, width, height, at, size = _SLICE.unpack_from(basis, slices_at + k * _SLICE.size)
        own = levels.setdefault(level, {"size": (width, height), "color": b"", "alpha": b""})
        own["alpha" if etc1s and flags & _HAS_ALPHA else "color"] = basis[at : at + size]
    order = [levels[level] for level in range(len(levels))]
    alpha = any(level["alpha"] for level in order)
    shared = b""
    if etc1s:
        images = b"".join(
            struct.pack(
                "<5I",
                0,
                0,
                len(level["color"]),
                len(level["color"]) if level["alpha"] else 0,
                len(level["alpha"]),
            )
            for level in order
        )
        books = [
            basis[endpoints_at : endpoints_at + _number(endpoints_size)],
            basis[selectors_at : selectors_at + _number(selectors_size)],
            basis[tables_at : tables_at + tables_size],
        ]
        shared = struct.pack("<HH4I", endpoints, selectors, *map(len, books), 0) + images + b"".join(books)
    data = [level["color"] + level["alpha"] for level in order]
    return _file(order[0]["size"], _described(etc1s, alpha, color), shared, data, etc1s)


def _number(three: bytes) -> int:
    return int.from_bytes(three, "little")


def _described(etc1s: bool, alpha: bool, color: bool) -> bytes:
    """Return the data format descriptor."""

    def sample(bit: int, bits: int, channel: int) -> bytes:
        return struct.pack("<HBB4BII", bit, bits - 1, channel, 0, 0, 0, 0, 0, 0xFFFFFFFF)

    if etc1s:
        samples = [sample(0, 64, _RGB)] + [sample(64, 64, _ALPHA)] * alpha
    else:
        samples = [sample(0, 128, _RGBA)]
    size = 24 + sum(map(len, samples))
    model = _MODELS["etc1s" if etc1s else "uastc"]
    transfer = _SRGB if color else _LINEAR
    planes = bytes(8)  # of data that are compressed once more
    block = bytes([_BLOCK - 1, _BLOCK - 1, 0, 0])
    head = struct.pack("<IHH4B", 0, 2, size, model, _BT709, transfer, 0) + block + planes
    return struct.pack("<I", 4 + size) + head + b"".join(samples)


def _file(size: tuple[int, int], described: bytes, shared: bytes, levels: list[bytes], etc1s: bool) -> bytes:
    """Return a file; its levels come smallest first, so that something is seen early."""
    writer = b"KTXwriter\0nanite_rs\0"
    values = struct.pack("<I", len(writer)) + writer
    values += b"\0" * (-len(values) % 4)
    index = 80 + 24 * len(levels)
    values_at = index + len(described)
    at = values_at + len(values)
    shared_at = at + (-at % 8) if shared else 0
    end = shared_at + len(shared) if shared else at
    body, places = bytearray(), [0] * len(levels)
    packed = levels if etc1s else [_core.compressed(level) for level in levels]
    for k in reversed(range(len(levels))):
        places[k] = end + len(body)
        body += packed[k]
    head = KTX2 + struct.pack("<9I", 0, 1, *size, 0, 0, 1, len(levels), _BASIS_LZ if etc1s else _ZSTD)
    head += struct.pack("<4I2Q", index, len(described), values_at, len(values), shared_at, len(shared))
    for place, level, own in zip(places, levels, packed, strict=True):
        # Of BasisLZ, what a level takes without it is not said.
        head += struct.pack("<3Q", place, len(own), 0 if etc1s else len(level))
    front = head + described + values
    return front + b"\0" * ((shared_at or end) - len(front)) + shared + bytes(body)
