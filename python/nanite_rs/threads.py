"""The number of threads that calls use.

Each call has its threads to itself while it runs: calls from several Python threads do not wait for each other.
Results never depend on their number. In order of precedence it is what a call names (``BuildOptions(threads=)``,
``Renderer(threads=)``, `decimate`'s ``threads=``), what `set_num_threads` was given, the environment variables
``NANITE_NUM_THREADS`` and ``RAYON_NUM_THREADS``, and one for each core.

A process that was forked has threads of its own: everything works there, whatever the parent has called before.
What another thread of the parent was using at that moment raises `ForkError`, and a GPU does not work on both sides
of a fork: there renderers with ``backend="gpu"`` raise `BackendError`, and those with ``"auto"`` draw on the CPU.
"""

from __future__ import annotations

from nanite_rs import _checks, _core

__all__ = ["get_num_threads", "set_num_threads"]


def set_num_threads(threads: int) -> None:
    """Set how many threads calls have that name no number, in this process from now on.

    Parameters
    ----------
    threads : int
        1 to 1024; 0 leaves it to the environment again.

    Raises
    ------
    ArgumentError, DtypeError
        For another number, or something else.

    Examples
    --------
    >>> nrs.set_num_threads(1)
    >>> nrs.get_num_threads()
    1
    >>> nrs.set_num_threads(0)
    """
    _core.set_num_threads(_checks.whole(threads, "threads", 0, _core.MOST_THREADS))


def get_num_threads() -> int:
    """Return how many threads calls have that name no number.

    Examples
    --------
    >>> nrs.get_num_threads() >= 1
    True
    """
    return _core.num_threads()
