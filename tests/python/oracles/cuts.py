"""Cuts at random, and those that together draw everything."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

import nanite_rs as nrs

from . import camera

if TYPE_CHECKING:
    from .dag import Dag
    from .data import Mesh


def random_cut(mesh, source: Mesh, d: Dag, rng: np.random.Generator):
    """A cut at a random error, around that of a random group, or from a random view near, inside or far away."""
    if rng.random() < 0.2:
        return mesh.cut(error=float(source.diagonal * 10 ** rng.uniform(-4.5, -0.7)))
    if rng.random() < 0.4:
        made = d.group_error[np.isfinite(d.group_error)]
        return mesh.cut(error=float(rng.choice(made)) * rng.uniform(0.9, 1.1) if len(made) else 1.0)
    away = source.diagonal * 10 ** rng.uniform(-1.5, 1.5)
    direction = rng.normal(size=3)
    target = source.center + rng.normal(size=3) * source.diagonal * 0.3
    start = source.used[rng.integers(len(source.used))] if rng.random() < 0.5 else source.center
    pose = camera.look_at(
        start + direction / np.linalg.norm(direction) * away, target, tuple(rng.normal(size=3))
    )
    if rng.random() < 0.2:
        lens = nrs.OrthographicCamera(
            *(source.diagonal * rng.uniform(0.01, 2, 2)), znear=source.diagonal * 1e-3
        )
    else:
        lens = nrs.PerspectiveCamera(
            yfov=rng.uniform(0.1, 2.5), znear=source.diagonal * 10 ** rng.uniform(-5, -1)
        )
    viewport = tuple(int(x) for x in rng.integers(1, 3000, 2))
    return mesh.cut(camera=lens, pose=pose, viewport=viewport, pixel_error=float(10 ** rng.uniform(-1, 1.5)))


def thresholds_that_draw_every_group(d: Dag) -> list[float]:
    """The fewest errors whose cuts together draw every cluster that was made from a group, coarsest first."""
    made = np.flatnonzero(d.origin >= 0)
    thresholds: list[float] = []
    for cluster in made[np.argsort(-d.error[made], kind="stable")]:
        # Drawn from its own error up to that of its group: not yet, if that is no more than the last threshold.
        if not thresholds or d.group_error[d.group[cluster]] <= thresholds[-1]:
            thresholds.append(float(d.error[cluster]))
    return thresholds
