"""Progress bars that appear only where somebody is waiting."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeAlias

Progress: TypeAlias = bool | Callable[[int, int], object] | None

#: Seconds after which a bar appears by itself.
_DELAY = 1.0


@contextmanager
def reporter(progress: Progress, description: str) -> Iterator[Callable[[int, int], object] | None]:
    """Yield what the core calls with ``(done, total)`` about twenty times a second, or None.

    None asks for a bar when the work takes longer than a second and stderr is a terminal, True for a bar in any
    case, False for none; a callable is called as it is.
    """
    if callable(progress):
        yield progress
        return
    if progress is False or (progress is None and not sys.stderr.isatty()):
        yield None
        return
    # A third of the time that importing nanite_rs takes beyond NumPy.
    from tqdm import tqdm

    delay = 0.0 if progress else _DELAY
    with tqdm(
        desc=description,
        total=100,
        delay=delay,
        leave=bool(progress),
        bar_format="{desc}: {percentage:3.0f}% {bar} {elapsed}",
    ) as bar:

        def update(done: int, total: int) -> None:
            bar.update(100.0 * done / max(total, 1) - bar.n)

        yield update
