"""Which materials may share an image, and the material that shows it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from nanite_rs._export_parts import textures
from nanite_rs.exceptions import ArgumentError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from nanite_rs.material import Material

_MOST_NUMBERS = 1 << 16


@dataclass(frozen=True)
class Classes:
    """Face materials by what no image can say: whether they have holes, back faces, light, and smooth shading."""

    looks: tuple[Material, ...]
    """For each number of the source, and no fewer than it has."""
    of: dict[int, int]
    """The class of each number that faces have."""
    members: list[list[int]]
    """The numbers of each class."""

    @property
    def first(self) -> int:
        """The first number that no face of the source has."""
        return len(self.looks)

    def look(self, number: int) -> Material:
        """The look of a face material."""
        return self.looks[number if 0 <= number < len(self.looks) else -1]

    def pairs(self) -> list[tuple[int, int]]:
        """Return each number and what it becomes."""
        return [(number, self.first + of) for number, of in self.of.items()]


def of_faces(looks: Sequence[Material], numbers: NDArray[np.integer[Any]] | None) -> Classes:
    """Sort the materials of faces.

    Raises
    ------
    ArgumentError
        Numbers are too large to have new ones behind them.
    """
    used = [0] if numbers is None else np.unique(numbers).tolist()
    most = max([*used, len(looks) - 1])
    if most >= _MOST_NUMBERS:
        raise ArgumentError(
            f"face_materials: {most} leaves no number to rebake with; {_MOST_NUMBERS} are allowed"
        )
    # The last one stands for all further numbers, and for negative ones, which count from the end.
    padded = (*looks, *[looks[-1]] * (most + 1 - len(looks)))
    known: dict[tuple[Any, ...], int] = {}
    of: dict[int, int] = {}
    members: list[list[int]] = []
    for number in used:
        look = padded[number] if number >= 0 else looks[-1]
        cutoff = look.alpha_cutoff if look.alpha_mode == "mask" else 0.0
        key = (look.alpha_mode, cutoff, look.double_sided, look.unlit, look.smooth)
        of[number] = known.setdefault(key, len(known))
        if of[number] == len(members):
            members.append([])
        members[of[number]].append(number)
    return Classes(padded, of, members)


def has_images(looks: Sequence[Material]) -> bool:
    """Whether any of them has a texture."""
    return any(True for look in looks for _ in textures(look))
