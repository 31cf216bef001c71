"""What materials show, by what they hold: two that are read twice are equal here."""

from __future__ import annotations

from collections import Counter
from dataclasses import fields, replace
from typing import Any

import numpy as np

import nanite_rs as nrs


def textures(material: nrs.Material) -> dict[str, nrs.Texture]:
    """The textures of a material by the names of their slots."""
    names = [field.name for field in fields(material) if field.name.endswith("_texture")]
    return {name: getattr(material, name) for name in names if getattr(material, name) is not None}


def key(material: nrs.Material) -> tuple[Any, ...]:
    """All that a material says, with the pixels of its images."""
    found = textures(material)
    bare = replace(material, **dict.fromkeys(found))
    own = [
        (slot, repr(replace(texture, image=_DOT)), texture.image.pixels.shape, texture.image.pixels.tobytes())
        for slot, texture in found.items()
    ]
    return repr(bare), *own


_DOT = nrs.Image(np.zeros((1, 1), np.uint8))


def of_faces(cut: nrs.Cut) -> Counter[tuple[Any, ...]]:
    """How many faces look how."""
    numbers = np.zeros(len(cut.faces), np.int64) if cut.face_materials is None else cut.face_materials
    looks = cut.materials or (
        nrs.Material(base_color=(1.0, 1.0, 1.0)) if cut.colors is not None else nrs.Material(),
    )
    values, counts = np.unique(np.clip(numbers, 0, len(looks) - 1), return_counts=True)
    out: Counter[tuple[Any, ...]] = Counter()
    for value, count in zip(values.tolist(), counts.tolist(), strict=True):
        out[key(looks[value])] += count
    return out
