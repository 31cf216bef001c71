"""What a device shades beside what the CPU shades: equal on some adapters, and near on others.

What is seen is equal everywhere, as its arithmetic is written out (`shaders/shared/exact.wgsl`). Shading is not: a
device may be off by units in the last place in roots and powers.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import nanite_rs as nrs

_ADAPTERS = json.loads(Path(__file__).with_suffix(".json").read_text())["adapters"]


def _of(renderer: nrs.Renderer) -> dict[str, Any]:
    name = renderer.backend_reason.rpartition(": ")[2] if renderer.backend == "gpu" else "llvmpipe"
    return next(a for a in _ADAPTERS if name.startswith(a["name"]))


def same_colors(renderer: nrs.Renderer, ours: np.ndarray, theirs: np.ndarray, what: str = "color") -> None:
    """Bytes that a renderer shaded, and those of the CPU."""
    may = _of(renderer)["plain"]
    steps = np.abs(ours.astype(int) - theirs)
    assert steps.max(initial=0) <= may["color"], f"{what}: {steps.max()} steps"
    assert (steps > 0).mean() <= may["share"], f"{what}: {(steps > 0).sum()} of {steps.size}"


def same_normals(renderer: nrs.Renderer, ours: np.ndarray, theirs: np.ndarray) -> None:
    """Unit vectors that a renderer made, and those of the CPU."""
    away = np.linalg.norm(ours.astype(np.float64) - theirs, axis=-1)
    assert away.max(initial=0.0) <= _of(renderer)["normal"], f"normals: {away.max()}"
