"""Builds of many files, each by itself."""

from __future__ import annotations

import os
import tempfile
import time
from concurrent.futures import as_completed
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, get_args

from nanite_rs import _checks, _sources, _tasks, io
from nanite_rs._notebook import table
from nanite_rs._progress import reporter
from nanite_rs._text import megabytes, seconds
from nanite_rs._text import table as text_table
from nanite_rs.building import build_file, bytes_of
from nanite_rs.exceptions import ArgumentError, DtypeError, FileError, MissingFileError
from nanite_rs.mesh import NaniteMesh
from nanite_rs.options import BuildOptions, no_options

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from concurrent.futures import Future

    from nanite_rs._progress import Progress

__all__ = ["BuildResult", "BuildResults", "build_many"]

ExistingName: TypeAlias = Literal["replace", "skip"]


@dataclass(frozen=True)
class BuildResult:
    """What became of one source of `build_many`."""

    source: str
    """The source."""
    path: str
    """Its ``.nanite`` file."""
    faces: int = 0
    """Faces of the mesh; 0 where building failed."""
    file_bytes: int = 0
    """Size of the file; 0 where building failed."""
    seconds: float = 0.0
    """How long building took, without waiting for a worker."""
    skipped: bool = False
    """Whether the file was there before, and stayed as it was."""
    error: str | None = None
    """Why building failed: the name of the error and its message."""

    def _row(self) -> tuple[str, ...]:
        if self.error is not None:
            return self.source, "", "", seconds(self.seconds), f"failed: {self.error}"
        what = "was there" if self.skipped else "built"
        size = megabytes(self.file_bytes)
        return (
            self.source,
            f"{self.faces:,}",
            size,
            seconds(self.seconds),
            f"{what}: {_sources.shown(self.path)}",
        )


class BuildResults(tuple[BuildResult, ...]):
    """What became of all sources of `build_many`, in their order: a tuple that prints as a table.

    Examples
    --------
    >>> results = nrs.BuildResults([nrs.BuildResult("a.ply", "a.nanite", error="FileError: a.ply: not there")])
    >>> len(results), results.failed[0].source
    (1, 'a.ply')
    """

    __slots__ = ()

    _COLUMNS = ("source", "faces", "size", "time", "result")

    @property
    def failed(self) -> list[BuildResult]:
        """Those that were not built."""
        return [result for result in self if result.error is not None]

    def __repr__(self) -> str:
        """Counts."""
        skipped = sum(result.skipped for result in self)
        built = len(self) - len(self.failed) - skipped
        counts = {"built": built, "skipped": skipped, "failed": len(self.failed)}
        return f"BuildResults({', '.join(f'{count} {what}' for what, count in counts.items())})"

    def __str__(self) -> str:
        """One line for each source, and counts."""
        rows = [self._COLUMNS, *(result._row() for result in self)]
        return f"{text_table(rows, right=(1, 2, 3))}\n{self!r}"

    def _repr_html_(self) -> str:
        return table(self._COLUMNS, [result._row() for result in self], text=(0, 4))


def build_many(
    sources: Iterable[io.PathLike],
    folder: io.PathLike | None = None,
    *,
    memory: int | str = "4 GiB",
    options: BuildOptions | None = None,
    existing: ExistingName = "replace",
    resume: bool = False,
    executor: Any = None,
    client: Any = None,
    storage_options: Mapping[str, Any] | None = None,
    progress: Progress = None,
) -> BuildResults:
    """Build a ``.nanite`` file from each of many files, whatever becomes of the others.

    Each is built as by `build_file`. Where one fails its error is in the result, and the others go on. An interrupt
    stops all.

    Parameters
    ----------
    sources : iterable of paths
        The files: of any format that `NaniteMesh.from_file` reads.
    folder : path or URL, optional
        Where the files are written, named after their sources. It is made where it is not there. By default each is
        beside its source. Files of a URL, such as ``s3://bucket/built``, are made among temporary files where they
        are built, and then sent, as by `build_file`.
    memory : int or str, default "4 GiB"
        Bytes that each build may take, as for `build_file`.
    options : BuildOptions, optional
        How to build.
    existing : {"replace", "skip"}, default "replace"
        What to do with files that are there. ``"skip"`` leaves them as they are, whatever they were built from: the
        same call with it builds what failed before.
    resume : bool, default False
        As for `build_file`: go on where builds in blocks were stopped, and keep their work folders where they fail.
        Not with a URL.
    executor : an executor, optional
        A `concurrent.futures.Executor` or a ``dask.distributed.Client``: each source is a task, in a process or
        on a machine that sees the same folders. Dask repeats the sources of a lost worker. Without it sources are
        built one after another. For one source that is huge give the executor to `build_file`.
    client : dask.distributed.Client, optional
        Another name for ``executor``.
    storage_options : mapping, optional
        Of a URL: as for `NaniteMesh.open`.
    progress : bool or callable, optional
        As for `NaniteMesh.from_arrays`, counting sources.

    Returns
    -------
    BuildResults
        A `BuildResult` for each source, in their order.

    Raises
    ------
    ArgumentError, DtypeError
        Two sources would have the same file; or an argument is none. Nothing was built then.
    FileError
        The folder cannot be made.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import trimesh
    >>> with TemporaryDirectory() as folder:
    ...     _ = trimesh.creation.icosphere(subdivisions=4).export(f"{folder}/ball.ply")
    ...     results = nrs.build_many([f"{folder}/ball.ply", f"{folder}/none.ply"], f"{folder}/built")
    >>> results
    BuildResults(1 built, 0 skipped, 1 failed)
    >>> results[0].faces, results[1].error is None
    (5120, False)
    """
    if not isinstance(options, BuildOptions | None):
        raise no_options(options)
    if executor is not None and client is not None:
        raise ArgumentError("client: is another name for executor; give one")
    run = _tasks.executor_of(executor if client is None else client)
    _checks.choice(existing, "existing", get_args(ExistingName))
    how: dict[str, Any] = {
        "memory": bytes_of(memory),
        "options": options,
        "resume": _checks.truth(resume, "resume"),
    }
    pairs = _paths(sources, folder)
    if not pairs:
        return BuildResults()
    if storage_options is not None or _sources.is_url(pairs[0][1]):
        if how["resume"]:
            raise ArgumentError(
                "resume: with a URL nothing stays to go on from; build those that failed again"
            )
        how["storage_options"] = _sources.checked_options(pairs[0][1], storage_options)
    # Where no folder can be written to, all fail here as they would elsewhere.
    place = next((found for found in _folders(pairs) if os.access(found, os.W_OK)), None)
    results: dict[int, BuildResult] = {}
    with reporter(progress, "building") as report:

        def finish(index: int, result: BuildResult) -> None:
            source, path = pairs[index]
            results[index] = replace(result, source=source, path=path)
            if report is not None:
                report(len(results), len(pairs))

        if run is None or place is None:
            for index, (source, path) in enumerate(pairs):
                finish(index, _build_one(source, path, existing, how))
        else:
            # Workers have working directories of their own.
            tasks = [(os.path.abspath(source), _absolute(path), existing, how) for source, path in pairs]
            with _tasks.submitted(run, _build_one, tasks, _tasks.FolderTokens(place)) as futures:
                indices = {future: index for index, future in enumerate(futures)}
                for future in as_completed(indices):
                    finish(indices[future], _outcome(future))
    return BuildResults(results[index] for index in range(len(pairs)))


def _folders(pairs: list[tuple[str, str]]) -> Iterator[Path]:
    """Folders that all workers see: those of files, or else of sources; temporary files come last."""
    for source, path in pairs:
        yield Path(source if _sources.is_url(path) else path).absolute().parent
    if _sources.is_url(pairs[0][1]):
        yield Path(tempfile.gettempdir())


def _absolute(path: str) -> str:
    return path if _sources.is_url(path) else os.path.abspath(path)


def _paths(sources: Iterable[io.PathLike], folder: io.PathLike | None) -> list[tuple[str, str]]:
    """Return each source with its file; make the folder of these."""
    if isinstance(sources, str | bytes | os.PathLike):
        raise DtypeError("sources: expected several paths; build_file builds one")
    place = None if folder is None else _checks.path_of(folder, "folder")
    known: dict[str, str] = {}
    pairs: list[tuple[str, str]] = []
    for given in sources:
        source = _checks.path_of(given, "sources")
        name = f"{io.stem(source)}{io.NANITE_SUFFIX}"
        if place is not None and _sources.is_url(place):
            path = f"{place.rstrip('/')}/{name}"
            key = path
        else:
            path = os.path.join(os.path.dirname(source) if place is None else place, name)
            key = os.path.normcase(os.path.abspath(path))
        before = known.setdefault(key, source)
        if len(known) == len(pairs):
            raise ArgumentError(
                f"sources: {before} and {source} would both be {_sources.shown(path)}; build them apart"
            )
        pairs.append((source, path))
    if place is not None and not _sources.is_url(place):
        try:
            os.makedirs(place, exist_ok=True)
        except OSError as error:
            raise FileError(f"{place}: {error.strerror or error}") from error
    return pairs


def _build_one(
    source: str, path: str, existing: ExistingName, how: Mapping[str, Any], token: str | None = None
) -> BuildResult:
    """Build one of many, in any process."""
    start = time.perf_counter()
    skipped = False
    try:
        progress: Progress = False
        if token is not None:
            progress = _tasks.interrupt_check(token)
            progress(0, 0)
        if os.path.abspath(source) == _absolute(path):
            raise ArgumentError(f"{source}: is built already")
        options = how.get("storage_options")
        there = _info(path, options) if existing == "skip" else None
        skipped = there is not None
        if there is None:
            build_file(source, path, progress=progress, **how)
            there = NaniteMesh.file_info(path, storage_options=options)
        faces, size = there["faces"], there["bytes"]
    except Exception as error:
        return _failed(error, source, path, time.perf_counter() - start)
    return BuildResult(source, path, faces, size, time.perf_counter() - start, skipped)


def _info(path: str, options: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """What is said of a file that is there."""
    try:
        return NaniteMesh.file_info(path, storage_options=options)
    except MissingFileError:
        return None


def _failed(error: Exception, source: str = "", path: str = "", seconds: float = 0.0) -> BuildResult:
    message = f"{type(error).__name__}: {' '.join(str(error).split())}"
    return BuildResult(source, path, seconds=seconds, error=message)


def _outcome(future: Future[BuildResult]) -> BuildResult:
    """Return the result of a task; that of a lost worker is one, too."""
    try:
        result: BuildResult = _tasks.outcome(future)
    except Exception as error:
        return _failed(error)
    return result
