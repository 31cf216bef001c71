"""What an animation of leaves needs of each vertex, as channels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from nanite_rs import _core
from nanite_rs._foliage.cards import islands

if TYPE_CHECKING:
    from numpy.typing import NDArray

PIVOT: Final = "wind_pivot"
"""(3,) where a card hangs on its trunk."""
BRANCH: Final = "wind_branch"
"""The number of the card, from 1; of trunks 0."""
PHASE: Final = "wind_phase"
"""0 to 1: how far a card is behind others."""

BEND: Final = "wind_bend"
"""0 to 1: the square of the height above the foot, relative to the highest vertex."""
FLUTTER: Final = "wind_flutter"
"""How far from the pivot of its card; of trunks 0."""

# Turns of the golden ratio: whatever their number, cards have phases that lie evenly.
_GOLDEN: Final = (5.0**0.5 - 1.0) / 2.0


@dataclass(frozen=True)
class Moving:
    """Channels of leaves, and what trunks have instead."""

    leaves: dict[str, NDArray[Any]]
    """Of all vertices of the source, of which those count that leaves use."""
    trunk: dict[str, NDArray[Any]]
    """Of each a single row."""


def channels(
    vertices: NDArray[np.float64], trunk: NDArray[np.int64], leaves: NDArray[np.int64], up: int
) -> Moving:
    """Return what moves leaves.

    A card is what hangs together by the places of its corners. Its pivot is the vertex nearest to the trunk, or, of
    leaves alone, to the lowest of them.
    """
    used = np.unique(leaves)
    card = np.zeros(len(vertices), np.int32)
    card[leaves] = islands(leaves, vertices)[:, None] + 1
    foot = _base(vertices, trunk if len(trunk) else leaves, up)
    if len(trunk):
        away: NDArray[Any] = _core.closest_points(vertices[used], vertices, trunk)[0]
    else:
        away = np.linalg.norm(vertices[used] - foot, axis=1)
    # The first of each card, when they are sorted by how far away they are.
    order = np.lexsort([away, card[used]])
    _, first = np.unique(card[used][order], return_index=True)
    pivots = np.concatenate([foot[None], vertices[used[order[first]]]])
    numbers = np.arange(len(pivots), dtype=np.int32)
    rows: dict[str, NDArray[Any]] = {
        PIVOT: pivots.astype(np.float32),
        BRANCH: numbers,
        PHASE: (numbers * _GOLDEN % 1.0).astype(np.float32),
    }
    return Moving({name: values[card] for name, values in rows.items()}, {k: v[0] for k, v in rows.items()})


def reaches(
    vertices: NDArray[np.float64], carried: dict[str, NDArray[Any]], up: int
) -> dict[str, NDArray[Any]]:
    """Return how much wind moves vertices that have the channels above: as a part of the tree, and of its card."""
    height = vertices[:, up] - vertices[:, up].min()
    most = float(height.max())
    bend = (height / most) ** 2 if most > 0 else np.zeros(len(height))
    flutter = np.linalg.norm(vertices - carried[PIVOT], axis=1)
    flutter[np.round(carried[BRANCH]) == 0] = 0.0
    return {BEND: bend.astype(np.float32), FLUTTER: flutter.astype(np.float32)}


def _base(vertices: NDArray[np.float64], faces: NDArray[np.int64], up: int) -> NDArray[np.float64]:
    """Return the middle of the lowest hundredth of some faces."""
    own = vertices[np.unique(faces)]
    height = own[:, up]
    low = own[height <= height.min() + 0.01 * np.ptp(height)]
    return np.asarray((low.min(axis=0) + low.max(axis=0)) / 2.0)
