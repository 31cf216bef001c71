"""STL as meshes: solids by name, and the colours that some programs hide in attributes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from nanite_rs import _core
from nanite_rs._asset import Asset, Source
from nanite_rs._faces import add, plain

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray


def read(name: str, data: bytes, folder: Path | None, *, drop_bad_textures: bool) -> Asset:
    """Read an STL file, of bytes or of text, which is told by its size.

    Solids are instances of their names. Attributes are colours where they say so, as Materialise Magics and VisCAM
    write them, otherwise the face channel ``attributes``. Normals of facets are left out: they follow from corners.
    """
    del folder, drop_bad_textures  # it refers to nothing
    found = _core.read_stl(name, data)
    asset = Asset(name)
    corners: NDArray[np.float64] = found["corners"]
    if found["behind"] and data[-found["behind"] :].strip(b"\0 \t\r\n"):
        asset.notes.add(f"{found['behind']} bytes behind the last triangle")
    solids = found["solids"] or [("", 0)]
    ends = [first for _, first in solids[1:]] + [len(corners) // 3]
    names: set[str] = set()
    for (label, first), end in zip(solids, ends, strict=True):
        source = Source(corners[3 * first : 3 * end], np.arange(3 * (end - first)).reshape(-1, 3))
        attributes = found["attributes"]
        if attributes is not None and attributes.any():
            colors = face_colors(attributes, found["header"], marked=is_marked(attributes))
            if colors is None:
                source.face_channels["attributes"] = attributes
            else:
                source.colors = np.repeat(colors, 3, axis=0)
        solid = unique(label.strip() or "mesh", names)
        add(asset, solid, [(solid, source, plain(source))])
    return asset


def is_marked(attributes: NDArray[np.uint16]) -> bool:
    """Whether all attributes but zeros have the highest bit, as colours of VisCAM have."""
    return bool((attributes[attributes != 0] & 0x8000).all())


def face_colors(attributes: NDArray[np.uint16], header: bytes, *, marked: bool) -> NDArray[np.uint8] | None:
    """Return (M, 4) colours of faces; nothing where attributes are something else.

    ``marked`` tells of those of the whole file what `is_marked` does.
    """
    place = header.find(b"COLOR=")
    whole = header[place + 6 : place + 10] if place >= 0 else b""
    own = (attributes & 0x8000) != 0
    channels = [(attributes >> shift & 31).astype(np.float64) * (255 / 31) for shift in (0, 5, 10)]
    if len(whole) == 4:
        # Materialise: red in the lowest bits, and the highest bit asks for the colour of the whole.
        own, rgb, rest = ~own, channels, np.frombuffer(whole, np.uint8)
    elif marked:
        rgb, rest = channels[::-1], np.full(4, 255, np.uint8)
    else:
        return None
    colors: NDArray[np.uint8] = np.full((len(attributes), 4), 255, np.uint8)
    colors[:, :3] = np.rint(np.stack(rgb, axis=1))
    colors[~own] = rest
    return colors


def unique(name: str, used: set[str]) -> str:
    """Return a name that is not in use yet: with a number behind it where it is."""
    found, number = name, 1
    while found in used:
        number += 1
        found = f"{name}_{number}"
    used.add(found)
    return found
