"""Colours by what pixels show: those of ``Frame.view``, and others that are made of the same ids.

The numbers are those of ``src/cpu/output.rs``; a test holds both together.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Ids = NDArray[np.uint32]
    Picture = NDArray[np.uint8]

PAGE_BITS: Final = 8
"""Low bits of a cluster's address, which are its place in its page."""

#: What tells the colours of one kind from those of another: the last word that is hashed.
CLUSTERS, GROUPS, PAGES, INSTANCES = (1 << bits for bits in (8, 9, 10, 11))

MOST_PIXELS: Final = 1024
"""Pixels of a triangle from which on the view of sizes has one colour."""


def hues(a: Ids, b: Ids, c: Ids | int) -> NDArray[np.float32]:
    """A bright colour for each triple of numbers, (N, 3) of 0 to 1."""
    bits = np.full(a.shape, 0x9E3779B9, np.uint32)
    for word in (a, b, np.uint32(c) if isinstance(c, int) else c):
        bits = (bits ^ word) * np.uint32(0x85EBCA6B)
        bits ^= bits >> np.uint32(15)
        bits *= np.uint32(0xC2B2AE35)
        bits ^= bits >> np.uint32(13)
    hue = (bits & np.uint32(0xFFFF)).astype(np.float32) / np.float32(65536)
    value = np.float32(0.7) + np.float32(0.3) * ((bits >> np.uint32(16)) & np.uint32(255)).astype(
        np.float32
    ) / np.float32(255)
    saturation = np.float32(0.45) + np.float32(0.4) * (bits >> np.uint32(24)).astype(np.float32) / np.float32(
        255
    )
    shifts = np.array([0.0, 1.0 / 3.0, 2.0 / 3.0], np.float32)
    t = np.abs((hue[:, None] + shifts) % np.float32(1) * np.float32(6) - np.float32(3)) - np.float32(1)
    colors: NDArray[np.float32] = value[:, None] * (1 - saturation[:, None] * (1 - t.clip(0, 1)))
    return colors


def ramp(t: NDArray[np.floating]) -> NDArray[np.float32]:
    """Red, orange, yellow, green, cyan, blue over 0 to 1: (N, 3)."""
    h = np.clip(t, 0.0, 1.0).astype(np.float32) * np.float32(4.2)
    shifts = np.array([0.0, 4.0, 2.0], np.float32)
    channels = np.clip(np.abs((h[:, None] + shifts) % np.float32(6) - np.float32(3)) - np.float32(1), 0, 1)
    colors: NDArray[np.float32] = np.float32(0.12) + np.float32(0.85) * channels
    return colors


def levels(level: NDArray[np.integer]) -> NDArray[np.float32]:
    """The colour of each level: red is the finest."""
    return ramp(level.astype(np.float32) / np.float32(14))


def sizes(instance: Ids, cluster: Ids, triangle: Ids) -> NDArray[np.float32]:
    """Colours by how many of the pixels show the same triangle: red is one, blue `MOST_PIXELS` or more."""
    key = (
        (instance.astype(np.uint64) << np.uint64(39)) | (cluster.astype(np.uint64) << np.uint64(7)) | triangle
    )
    _, which, counts = np.unique(key, return_inverse=True, return_counts=True)
    return ramp(np.log2(counts)[which] / np.log2(MOST_PIXELS))


def faced(colors: NDArray[np.float32], facing: NDArray[np.float32]) -> Picture:
    """Colours darkened where the surface turns away, as 8 bits."""
    lit = colors * (np.float32(0.35) + np.float32(0.65) * np.abs(facing))[:, None]
    return (lit * np.float32(255) + np.float32(0.5)).astype(np.uint8)
