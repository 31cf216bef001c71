"""Which materials are leaves, and why."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from nanite_rs._foliage.inputs import named
from nanite_rs._foliage.masks import Mask, alpha_of
from nanite_rs.exceptions import ArgumentError
from nanite_rs.texture import both_ways

if TYPE_CHECKING:
    from collections.abc import Sequence

    from nanite_rs.material import Material

EMPTY: Final = 0.01
"""The share of empty texels from which an image is taken for that of leaves."""
BLENDED: Final = 0.5
"""The cutoff of materials that blend, and have none."""


@dataclass(frozen=True)
class Role:
    """What a material is taken for."""

    why: str
    mask: Mask | None = None
    """What its image shows, of leaves."""

    @property
    def leaf(self) -> bool:
        """Whether it is one of leaves."""
        return self.mask is not None


def roles(
    materials: Sequence[Material], chosen: Sequence[str] | None, given: Sequence[str], cutoff: float | None
) -> list[Role]:
    """Say what each material is; ``chosen`` are names of leaves, or None to look for them.

    Without names, leaves are materials whose alpha makes holes or blends, of whose image a hundredth and more is
    empty, and those that were ``given`` an image.
    """
    names = named(tuple(materials))
    if chosen is not None:
        for number, name in enumerate(chosen):
            if not any(name in (look.name, names[row]) for row, look in enumerate(materials)):
                raise ArgumentError(
                    f"leaf_materials[{number}]: there is no material {name!r}; there are {', '.join(names)}"
                )
    out = []
    for name, look in zip(names, materials, strict=True):
        wanted = chosen is not None and (name in chosen or look.name in chosen)
        wanted |= chosen is None and look.name in given
        out.append(_role(look, name, wanted, chosen is None, cutoff))
    if not any(role.leaf for role in out):
        found = "; ".join(f"{name}: {role.why}" for name, role in zip(names, out, strict=True))
        raise ArgumentError(
            f"leaf_materials: no material is one of leaves ({found or 'there are none'}); "
            "name them, or give their images: textures={name: image}"
        )
    return out


def _role(look: Material, name: str, wanted: bool, search: bool, cutoff: float | None) -> Role:
    if not wanted and not search:
        return Role("not named")
    if not wanted and look.alpha_mode == "opaque":
        return Role("opaque")
    texture = look.base_color_texture
    alpha = None if texture is None else alpha_of(texture.image)
    if texture is None or alpha is None:
        if wanted:
            what = "it has no image" if texture is None else "its image has no alpha"
            raise ArgumentError(
                f"leaf_materials: {name}: {what}; textures={{{look.name!r}: image}} gives it one"
            )
        return Role("no image with alpha")
    own = look.alpha_cutoff if look.alpha_mode == "mask" else BLENDED
    level = own if cutoff is None else cutoff
    # What alpha is multiplied by changes where it meets the cutoff.
    scale = look.base_color[3] if len(look.base_color) == 4 else 1.0
    # Alpha of 0 has nothing, whatever the cutoff.
    level = max(level / scale if scale > 0.0 else np.inf, 1e-6)
    empty = float((alpha < level).mean())
    if empty == 1.0:
        if wanted:
            raise ArgumentError(f"leaf_materials: {name}: alpha is below the cutoff everywhere")
        return Role("nothing is seen of it")
    if not wanted and empty < EMPTY:
        return Role(f"{empty:.1%} of its image is empty")
    mask = Mask(alpha, both_ways(texture.wrap), texture.filter == "linear", float(level))
    why = "named" if wanted else f"{look.alpha_mode}, {empty:.0%} of its image is empty"
    return Role(why, mask)
