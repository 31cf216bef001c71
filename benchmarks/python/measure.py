"""Timing: medians of interleaved runs, so that what slows the machine slows every contestant alike."""

from __future__ import annotations

import gc
import statistics
import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable


def interleaved(
    contestants: dict[str, Callable[[int], object]], *, runs: int, warm_up: int = 1, budget: float = 60.0
) -> dict[str, dict[str, float]]:
    """Median, least and greatest seconds of each contestant, called in turn with the number of the run.

    Stops before ``runs`` when ``budget`` seconds are spent and every contestant ran three times.
    """
    times: dict[str, list[float]] = {name: [] for name in contestants}
    for run in range(-warm_up, 0):
        for call in contestants.values():
            call(run)
    start = time.perf_counter()
    for run in range(runs):
        if run >= 3 and time.perf_counter() - start > budget:
            break
        for name, call in contestants.items():
            gc.collect()
            before = time.perf_counter()
            result = call(run)
            times[name].append(time.perf_counter() - before)
            del result
    return {
        name: {"median": statistics.median(t), "min": min(t), "max": max(t), "runs": len(t)}
        for name, t in times.items()
    }
