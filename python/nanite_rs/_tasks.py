"""Tasks on other threads, processes and machines, by any executor or a client of dask."""

from __future__ import annotations

import os
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, wait
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final, Protocol
from uuid import uuid4

from nanite_rs.exceptions import ArgumentError, DtypeError, FileError, WorkerError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from pathlib import Path

#: What names of tokens begin with.
WANTED: Final = ".nanite-wanted-"


class Tokens(Protocol):
    """Where tokens are, which all workers see."""

    def set(self, token: str) -> str:
        """Say that tasks are wanted; return what they are given to look at."""

    def clear(self, token: str) -> None:
        """Say that they are not."""


class FolderTokens:
    """Files of a folder."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def set(self, token: str) -> str:
        """Make the file; return its path."""
        path = self._folder / token
        path.touch()
        return str(path)

    def clear(self, token: str) -> None:
        """Remove the file."""
        (self._folder / token).unlink(missing_ok=True)


def executor_of(given: Any) -> Executor | None:
    """Return what runs tasks, as an executor; None for None."""
    if callable(getattr(given, "get_executor", None)):
        if given.asynchronous:
            raise ArgumentError("executor: the client is asynchronous; give one with asynchronous=False")
        # Tasks write files: what dask knows of those with the same arguments is none of theirs.
        wrapped: Executor = given.get_executor(pure=False)
        return wrapped
    if given is not None and not callable(getattr(given, "submit", None)):
        raise DtypeError(f"executor: expected one with submit, not {type(given).__name__}")
    found: Executor | None = given
    return found


@contextmanager
def submitted(
    executor: Executor, function: Callable[..., Any], tasks: Iterable[tuple[Any, ...]], tokens: Tokens
) -> Iterator[list[Future[Any]]]:
    """Submit ``function(*task, token)`` for all tasks and yield their futures; cancel what is left in the end.

    The token is there as long as the tasks are wanted. No executor stops a task that runs: tasks have an
    `interrupt_check` for that. Dask also repeats finished tasks,
    where it loses the worker that has the result: without a token they end before they begin.
    """
    token = f"{WANTED}{uuid4().hex}"
    given = tokens.set(token)
    futures: list[Future[Any]] = []
    try:
        for task in tasks:
            futures.append(_submit(executor, function, *task, given))  # noqa: PERF401
        yield futures
    finally:
        tokens.clear(token)
        wait([future for future in futures if not future.cancel()])


def _submit(executor: Executor, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
    """Submit a task; it fails where the executor is broken, as those before it do."""
    try:
        return executor.submit(function, *arguments)
    except BrokenExecutor as error:
        failed: Future[Any] = Future()
        failed.set_exception(error)
        return failed


def outcome(future: Future[Any]) -> Any:
    """Return what a task returned, or raise what it raised.

    Raises
    ------
    WorkerError
        The task did not end.
    """
    try:
        return future.result()
    except Exception as error:
        # What dask raises itself is of workers and connections.
        of_dask = type(error).__module__.partition(".")[0] == "distributed"
        if of_dask or isinstance(error, BrokenExecutor | CancelledError):
            said = " ".join(str(error).split()) or type(error).__name__
            raise WorkerError(f"a worker was lost: {said}") from error
        raise


def interrupt_check(token: str) -> Callable[..., None]:
    """Return what raises once the file of a token is gone; it takes what calls of progress give."""

    def check(*_: int) -> None:
        if not os.path.exists(token):
            raise FileError(
                f"{token}: not there: the task was cancelled, or its worker does not see the folder, which all "
                "workers must share"
            )

    return check


def cancel_all(folder: Path) -> None:
    """Cancel the tasks of a folder whose process was killed: workers may still run them."""
    for token in folder.glob(f"{WANTED}*"):
        token.unlink(missing_ok=True)
