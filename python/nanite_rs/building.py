"""Builds into files: of sources larger than memory, too."""

from __future__ import annotations

import errno
import os
import re
import shutil
import tempfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import as_completed
from contextlib import contextmanager, suppress
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias, get_args
from uuid import uuid4

import numpy as np

from nanite_rs import (
    _advice,
    _checks,
    _material_files,
    _piece_files,
    _pieces,
    _sources,
    _tasks,
    _upload,
    _work_store,
    io,
    terrain,
)
from nanite_rs._asset import Notes
from nanite_rs._core import BlockBuild, build_memory
from nanite_rs._progress import reporter
from nanite_rs._text import megabytes
from nanite_rs.exceptions import (
    ArgumentError,
    DtypeError,
    FileError,
    FormatError,
    MissingFileError,
    NaniteError,
    WorkerError,
)
from nanite_rs.material import Material, several
from nanite_rs.mesh import NaniteMesh
from nanite_rs.options import BuildOptions, no_options

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from numpy.typing import ArrayLike, NDArray

    from nanite_rs._checks import Precision
    from nanite_rs._progress import Progress
    from nanite_rs.material import Look

__all__ = ["build_file", "build_heightfield"]

_ROUNDED: Final = 32
"""Steps of the grid of a file of terrain in a tolerance."""

NumberingName: TypeAlias = Literal["piece", "all"]


def build_file(
    source: object,
    path: io.PathLike,
    *,
    memory: int | str = "4 GiB",
    options: BuildOptions | None = None,
    folder: io.PathLike | None = None,
    resume: bool = False,
    executor: Any = None,
    numbering: NumberingName = "piece",
    precision: Precision = "auto",
    storage_options: Mapping[str, Any] | None = None,
    progress: Progress = None,
) -> NaniteMesh:
    """Build a ``.nanite`` file from a source that may be larger than memory, and open it.

    A source that fits is built in memory, and the file is the same as by `NaniteMesh.from_file` and
    `NaniteMesh.save`. One that does not is put into blocks on disk, by where its faces lie. The levels of each
    block grow in memory, while what blocks share stays as it is. What is left of them, mostly a sixteenth or less,
    is put into other blocks with other borders, until one is left. Errors are proven as in memory, cuts have no
    cracks, and the same source, options and memory give the same bytes on any number of threads. The scheme is that
    of Cignoni et al., "External Memory Management and Simplification of Huge Meshes", IEEE TVCG 9(4), 2003, with
    the groups of a cluster DAG.

    Parameters
    ----------
    source : path, paths, arrays, or iterable of pieces
        A file: PLY, STL, OBJ and glTF are read piece by piece where they do not fit, and everything that
        `NaniteMesh.from_file` reads where it does. Of glTF there are no skins and morph targets then, and what
        is compressed, such as a primitive of Draco, is in memory as a whole; so are images, as they are
        encoded. Several files, or a folder of files, are tiles of one mesh: those of a folder come in the order
        of the numbers in their names, and may be of all formats. What a tile does not have is filled in, as for
        the parts of one file: normals are computed, colours white, UVs and channels zero.

        Arrays: ``(vertices, faces)`` or ``(vertices, faces, attributes)``, where a dict has some of
        ``normals``, ``colors``, ``uvs``, ``channels``, ``face_materials``, ``face_channels`` and ``materials``,
        as `NaniteMesh.from_arrays` takes them. They may be memory maps, and arrays of zarr, h5py or Dask, which
        are read slice by slice.

        Or pieces, each such a pair or triple, whose faces count vertices as ``numbering`` says: all pieces have the
        same attributes.

        Tiles and pieces may touch: vertices that are equal are one.
    path : path or URL
        The file, ending in ``.nanite``; an existing one is replaced in one step or not at all. One of a URL, such
        as ``s3://``, is made on disk and then sent, as by `NaniteMesh.save`: whether it can be written is tried out
        before anything is built, and what could not be sent is kept.
    memory : int or str, default "4 GiB"
        Bytes that the build may take, about, beyond what it started with; a number, or one with a unit such as
        ``"2G"``, ``"500 MB"`` or ``"4 GiB"``. Tables of all vertices come on top: some 4 bytes for each vertex of
        all levels.
    options : BuildOptions, optional
        How to build.
    folder : path or URL, optional
        Where the work folder is made, named after the file with ``.work`` behind it, for what does not fit: some
        150 bytes for each face. It is removed in the end. By default it is beside the file, and of a URL among
        temporary files. The file of a URL is made there, too. A URL, such as ``s3://bucket/work``, is for workers
        that share no disk, and for builds that go on elsewhere: all files are in the store, and each process has
        those that it needs among temporary files.
    resume : bool, default False
        Go on from the last finished block where a build of the same source with the same options and memory was
        stopped or killed, and keep the work folder where this one fails. Without it the work folder of another
        build is removed. With a URL it needs ``folder``.
    executor : an executor, optional
        A `concurrent.futures.Executor` or a ``dask.distributed.Client``: each block is a task, which takes
        ``memory`` where it runs, in a process or on a machine that shares the work folder, or reaches its URL. The
        file has the same bytes. Dask repeats the blocks of a lost worker.
    numbering : {"piece", "all"}, default "piece"
        Which vertices faces of pieces count from 0: those of their piece, or those of all pieces, of which later
        ones may come later. Each is then given once, so that pieces share vertices.
    precision : "auto", "exact" or float, default "auto"
        What positions are rounded to: as for `NaniteMesh.save`.
    storage_options : mapping, optional
        Of URLs: as for `NaniteMesh.open`.
    progress : bool or callable, optional
        As for `NaniteMesh.from_arrays`; of a URL it is told of sending afterwards.

    Returns
    -------
    NaniteMesh
        The file, opened: that of a URL by it.

    Raises
    ------
    FormatError
        The file is of a format, or a kind of it, that is read in memory alone, and does not fit.
    MeshError, ArgumentError, DtypeError
        As `NaniteMesh.from_arrays`.
    FileError
        A file cannot be read or written, as where the disk is full.
    WorkerError
        A worker was lost: always of a `concurrent.futures.ProcessPoolExecutor`, which ends with it; of a cluster
        where the same block lost several.
    MissingFileError, AccessError, ServerError, DependencyError
        Of a URL: as for `NaniteMesh.save`.

    Warns
    -----
    UserWarning
        What of a file read in pieces is not kept, or not as it was, such as floating-point data of faces.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> def pieces():
    ...     for x in range(3):
    ...         vertices, faces = nrs.shapes.icosphere(faces=20_000)
    ...         yield vertices + np.float32([2 * x, 0, 0]), faces
    >>> with TemporaryDirectory() as folder:
    ...     mesh = nrs.build_file(pieces(), f"{folder}/balls.nanite", memory="8 MB")
    ...     mesh.check().clusters == mesh.report.clusters, mesh.report.input_faces
    (True, 61440)
    >>> nrs.build_file("tiles/", "terrain.nanite", memory="8 GiB")  # doctest: +SKIP
    >>> nrs.build_file("city.ply", "s3://bucket/city.nanite", memory="8 GiB")  # doctest: +SKIP
    """
    path = _target(path, options)
    limit = bytes_of(memory)
    resume = _checks.truth(resume, "resume")
    executor = _tasks.executor_of(executor)
    _checks.choice(numbering, "numbering", get_args(NumberingName))
    within = None if folder is None else _checks.path_of(folder, "folder")
    if _sources.is_url(path):
        if resume and within is None:
            raise ArgumentError("resume: with a URL, give folder=, where the work folder stays")
        stored = within is not None and _sources.is_url(within)
        of_folder = storage_options if stored else None
        with _upload.written(
            path, storage_options, folder=None if stored else within, progress=progress
        ) as made:
            build_file(
                source,
                made,
                memory=limit,
                options=options,
                folder=within,
                resume=resume,
                executor=executor,
                numbering=numbering,
                precision=precision,
                storage_options=of_folder,
                progress=progress,
            )
        return NaniteMesh.open(path, storage_options=storage_options)
    target = Path(path)
    shared = numbering == "all"
    if _checks.precision(precision)[1] is None:
        _checks.choice(precision, "precision", ("auto", "exact"))
    with _work_folder(target, within, storage_options) as (work, store):
        _build_in(source, shared, target, limit, options, work, store, resume, executor, precision, progress)
    return NaniteMesh.open(target)


def build_heightfield(
    heights: ArrayLike,
    path: io.PathLike,
    *,
    spacing: float | tuple[float, float] = 1.0,
    tolerance: float,
    nodata: float | None = None,
    fit: bool = True,
    piece: int = 2048,
    memory: int | str = "4 GiB",
    materials: Look | None = None,
    options: BuildOptions | None = None,
    folder: io.PathLike | None = None,
    storage_options: Mapping[str, Any] | None = None,
    progress: Progress = None,
) -> NaniteMesh:
    """Build a ``.nanite`` file of terrain that may be larger than memory, and open it.

    Pieces of the array are triangulated by themselves, as by `heightfield`, and go to disk; `build_file` makes the
    file. Which posts of the border between two pieces are vertices depends on the heights along it alone, and
    they stay where they are: pieces have the same vertices there, bit for bit, and are one surface. Files round
    positions to steps of a thirty-second of the tolerance or less, and posts are kept within what is left of it: no
    post is farther from full detail than the tolerance, unless storing coordinates in single precision takes more.

    Parameters
    ----------
    heights, spacing, tolerance, nodata, fit
        As in `heightfield`; `numpy.memmap` for what does not fit in memory.
    path : path or URL
        The file, ending in ``.nanite``, as in `build_file`.
    piece : int
        Posts of a side of a piece, 2 to 4,096. A piece takes some 100 bytes for each of its posts, 400 MB at 2,048.
    memory, options
        As in `build_file`. Pieces are not counted.
    materials
        As in `NaniteMesh.from_heightfield`.
    folder : path, optional
        Where folders for what does not fit are made: pieces, work folder and the file before its error is in it.
        By default beside the file, and of a URL among temporary files.
    storage_options, progress
        As in `build_file`.

    Returns
    -------
    NaniteMesh
        The file, opened: that of a URL by it.

    Raises
    ------
    ArgumentError, DtypeError, MeshError
        As in `heightfield`.
    FormatError, FileError, MissingFileError, AccessError, ServerError, DependencyError
        As in `build_file`.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> x, y = np.meshgrid(np.linspace(-3, 3, 500), np.linspace(-3, 3, 500))
    >>> hill = np.exp(-x * x - y * y)
    >>> with TemporaryDirectory() as place:
    ...     built = nrs.build_heightfield(hill, f"{place}/hill.nanite", tolerance=0.01, spacing=0.01, piece=200)
    ...     bool(built.cut(error=0).error <= 0.01)
    True
    """
    path = _target(path, options)
    tolerance = _checks.not_negative(tolerance, "tolerance")
    step = tolerance / _ROUNDED
    ground = terrain.Ground(
        heights,
        spacing=spacing,
        # A position moves by half the diagonal of a cell of the grid at most.
        tolerance=tolerance - 0.5 * 3.0**0.5 * step,
        nodata=nodata,
        max_triangles=None,
        fit=fit,
        piece=piece,
    )
    looks = () if materials is None else several(materials, "materials")
    if folder is not None:
        within: str | Path | None = _checks.path_of(folder, "folder")
    else:
        within = None if _sources.is_url(path) else Path(path).parent

    def pieces() -> Iterator[tuple[NDArray[np.float64], NDArray[np.uint32], dict[str, Any]]]:
        for posts, values, faces in ground.parts():
            vertices, uvs = ground.placed(posts, values)
            yield vertices, faces, {"uvs": uvs}

    if within is not None and not Path(within).is_dir():
        raise MissingFileError(errno.ENOENT, os.strerror(errno.ENOENT), str(within))
    with tempfile.TemporaryDirectory(prefix="nanite-", dir=within) as aside:
        made = Path(aside) / f"terrain{io.NANITE_SUFFIX}"
        mesh = build_file(pieces(), made, memory=memory, options=options, precision=step, progress=progress)
        # Known after the last piece.
        mesh._core = mesh._core.with_source_error(ground.error)
        mesh._materials = looks
        # On its grid already, or as it is where f32 is as coarse as the grid would be.
        mesh.save(path, precision="exact", storage_options=storage_options)
    return NaniteMesh.open(path, storage_options=storage_options)


def _target(path: io.PathLike, options: BuildOptions | None) -> str:
    """Where a file is built, and how: both checked."""
    path = _checks.path_of(path)
    if _sources.ending(path) != io.NANITE_SUFFIX:
        raise FormatError(f"{_sources.shown(path)}: the file must end in {io.NANITE_SUFFIX}")
    if not isinstance(options, BuildOptions | None):
        raise no_options(options)
    return path


@contextmanager
def _work_folder(
    target: Path, within: str | None, storage_options: Mapping[str, Any] | None
) -> Iterator[tuple[Path, _work_store.WorkStore | None]]:
    """Yield the work folder, and where its files are, too, if that is a URL."""
    known = _sources.checked_options(target if within is None else within, storage_options)
    if within is None or not _sources.is_url(within):
        yield (target.parent if within is None else Path(within)) / f"{target.name}.work", None
        return
    url = f"{within.rstrip('/')}/{target.name}.work"
    place = Path(tempfile.mkdtemp(prefix="nanite-"))
    try:
        work = place / f"{target.name}.work"
        yield work, _work_store.WorkStore(url, known, work)
    finally:
        shutil.rmtree(place, ignore_errors=True)
        _work_store.forget()


def _build_in(
    source: object,
    shared: bool,
    target: Path,
    limit: int,
    options: BuildOptions | None,
    work: Path,
    store: _work_store.WorkStore | None,
    resume: bool,
    executor: Executor | None,
    precision: Precision,
    progress: Progress,
) -> None:
    """Build with a work folder."""
    done, ours = False, _is_ours(work, store)
    arrays: Mapping[str, Any] = {}
    try:
        if not ours:
            name = work if store is None else _sources.shown(store.url)
            raise FileError(f"{name}: in the way, and no work folder of a build; give another folder")
        _make_folder(work, store, resume=resume)
        file, arrays, looks = _given(source, shared, limit, work)
        if arrays and build_memory(_pieces.core(arrays)) > limit:
            _refuse_rebaking(options)
            if _pieces.has_face_channels(arrays):
                arrays = _pieces.apart(arrays, work / "apart")
            made = _build(arrays, limit, options or BuildOptions(), work, store, executor, progress)
            made.save(target, *_checks.precision(precision), _material_files.encoded(looks))
        elif file is not None:
            mesh = NaniteMesh.from_file(file, options=options, progress=progress)
            mesh.save(target, precision=precision)
        else:
            given = _pieces.arguments(arrays)
            mesh = NaniteMesh.from_arrays(
                **given, materials=looks or None, options=options, progress=progress
            )
            mesh.save(target, precision=precision)
        done = True
    except OSError as error:
        said = str(error)
        if error.errno is not None or not isinstance(error, FileError):
            said = f"{error.filename or work}: {error.strerror or error}"
        if error.errno == errno.ENOSPC:
            said += _of_full(work, arrays)
        raise (type(error) if isinstance(error, FileError) else FileError)(said) from error
    except WorkerError as error:
        kept = "finished blocks are kept, and the same call goes on from there"
        raise _advice.advised(error, kept if resume else f"with resume=True {kept}") from error
    finally:
        if ours and (done or not resume):
            _remove(work, store)


#: Bytes that a work folder takes for each face, about, once all is in it.
_PER_FACE: Final = 150


def _of_full(work: Path, arrays: Mapping[str, Any]) -> str:
    """Say how much space is missing."""
    if not arrays:
        return "; the source does not fit on the disk as arrays"
    files = (path for path in work.rglob("*") if path.is_file())
    used, free = sum(path.stat().st_size for path in files), shutil.disk_usage(work.parent).free
    whole = _PER_FACE * len(arrays["faces"])
    said = f"; the work folder takes some {megabytes(whole)}, and has {megabytes(used)}"
    missing = whole - used - free
    return f"{said}: some {megabytes(missing)} are missing" if missing > 0 else said


#: What every work folder has from the beginning.
_MARKER: Final = "about.txt"


def _is_ours(work: Path, store: _work_store.WorkStore | None) -> bool:
    """Whether a folder is free, or the work folder of a build; one that was killed at once left an empty folder."""
    if store is not None:
        names = store.names()
        return not names or _MARKER in names
    return not work.exists() or (work / _MARKER).exists() or (work.is_dir() and not any(work.iterdir()))


def _make_folder(work: Path, store: _work_store.WorkStore | None, *, resume: bool) -> None:
    """Make the work folder, or empty the one of another build."""
    if not resume:
        _remove(work, store)
    work.mkdir(exist_ok=True)
    _tasks.cancel_all(work)
    (work / _MARKER).write_text(
        "What nanite_rs.build_file works with. Without a build that goes on, it may be deleted.\n"
    )
    if store is not None:
        names = store.names()
        store.drop(name for name in names if name.startswith(_tasks.WANTED))
        store.send([_MARKER])
        store.fetch(name for name in names if not name.startswith(_tasks.WANTED))


def _remove(work: Path, store: _work_store.WorkStore | None) -> None:
    """Remove the work folder."""
    if store is not None:
        # Where that fails, the build is none the worse.
        with suppress(NaniteError):
            store.remove()
    # Under another name first: a task that is about to stop on another machine writes nothing into it any more.
    with suppress(OSError):
        work.rename(work.with_name(f"{work.name}-{uuid4().hex}"))
    # And those of builds that were killed here.
    named = re.compile(rf"{re.escape(work.name)}(-[0-9a-f]{{32}})?")
    with suppress(OSError):
        for path in work.parent.iterdir():
            if named.fullmatch(path.name):
                shutil.rmtree(path, ignore_errors=True)


def _refuse_rebaking(options: BuildOptions | None) -> None:
    if options is not None and options.rebake != "never":
        raise ArgumentError(
            f'options: rebake="{options.rebake}" needs all of a mesh in memory; give more, or leave it out'
        )


def _build(
    arrays: Mapping[str, Any],
    limit: int,
    options: BuildOptions,
    work: Path,
    store: _work_store.WorkStore | None,
    executor: Executor | None,
    progress: Progress,
) -> BlockBuild:
    """Make all blocks from arrays that do not fit."""
    key = _key(arrays)
    if executor is not None or store is not None:
        work = work.absolute()  # workers have working directories of their own
        arrays = _pieces.in_folder(arrays, work, [key])
    how, own = options._core(), _pieces.core(arrays)
    with reporter(progress, "building") as report:
        build = BlockBuild.begin(own, options=how, memory=limit, folder=work, key=key, progress=report)
        total = Total(report, 2 * len(own["faces"]))
        sent: set[str] = set() if store is None else store.names()
        while True:
            if store is not None:
                # What says which build this is comes last.
                new = _files(work) - sent - {_MANIFEST}
                if executor is None:  # whoever goes on has the source
                    new -= _pieces.files(work)
                store.send([*sorted(new), _MANIFEST])
                sent.update(new)
            blocks = build.missing()
            if executor is None:
                for block in blocks:
                    build.make(own, block, total.part())
                    if store is not None:
                        store.send(build.outputs(block))
            else:
                folder = str(work) if store is None else store.url
                tasks = [(folder, {} if store is None else store.options, how, block) for block in blocks]
                tokens = _tasks.FolderTokens(work) if store is None else store
                with _tasks.submitted(executor, make_block, tasks, tokens) as futures:
                    of_future = dict(zip(futures, blocks, strict=True))
                    for future in as_completed(futures):
                        total.add(_tasks.outcome(future))
                        if store is not None:
                            store.fetch(build.outputs(of_future[future]))
            if store is not None:
                sent.update(name for block in blocks for name in build.outputs(block))
            if not build.advance():
                return build


#: What says which build is in a folder.
_MANIFEST: Final = "blocks/manifest.json"


def _files(work: Path) -> set[str]:
    """Return the names of what others need of a work folder."""
    files = (path for path in work.rglob("*") if path.is_file() and path.suffix != ".part")
    names = {path.relative_to(work).as_posix() for path in files}
    return {name for name in names if not name.startswith(_tasks.WANTED)}


def make_block(
    folder: str, storage_options: dict[str, Any], options: dict[str, Any], block: int, token: str
) -> int:
    """Make a block, in any process that sees the work folder; return its progress, counted as that of the build."""
    if not _sources.is_url(folder):
        return _make_block(Path(folder), options, block, _tasks.interrupt_check(token))
    with _work_store.mirrored(folder, storage_options) as store:
        check = store.interrupt_check(token)
        check()
        store.fetch([_MANIFEST], again=True)
        build = BlockBuild.open(store.here, options)
        made = build.outputs(block)
        if store.holds(made[-1]):
            return 0
        of_stage, _ = build.inputs(block)
        store.fetch(of_stage)
        _, others = build.inputs(block)
        # Lists without entries have no file.
        store.fetch(others, optional=True)
        if not of_stage:
            store.fetch([_pieces.LIST])
            store.fetch(_pieces.files(store.here))
        counted = _make_block(store.here, options, block, check)
        store.send(made)
    return counted


def _make_block(work: Path, options: dict[str, Any], block: int, check: Callable[..., None]) -> int:
    counted = 0

    def update(done: int, _: int) -> None:
        nonlocal counted
        check()
        counted = done

    check()
    build = BlockBuild.open(work, options)
    # A stage has a token of its own, so the stage that was opened is that of the task.
    check()
    if block in build.missing():
        # Later stages look at what was left alone.
        arrays = _pieces.opened(work) or {"vertices": np.zeros((0, 3), "f4"), "faces": np.zeros((0, 3), "u4")}
        build.make(_pieces.core(arrays), block, update)
    return counted


def _key(arrays: Mapping[str, Any]) -> str:
    """Return what tells sources apart: a checksum of all arrays."""
    sums = []
    for name, rows in sorted(arrays.items()):
        crc = 0
        for start in range(0, len(rows), _pieces.ROWS):
            crc = zlib.crc32(rows[start : start + _pieces.ROWS].tobytes(), crc)
        sums.append(f"{name} {rows.dtype.str} {rows.shape} {crc:08x}")
    return "; ".join(sums)


class Total:
    """What calls with the progress of all parts together."""

    def __init__(self, report: Callable[[int, int], object] | None, total: int) -> None:
        self._report, self._total, self._done = report, total, 0

    def part(self) -> Callable[[int, int], object] | None:
        """Return what one part calls with its own."""
        if self._report is None:
            return None
        report, before = self._report, self._done

        def update(done: int, _: int) -> None:
            self._done = max(self._done, before + done)
            report(min(self._done, self._total), self._total)

        return update

    def add(self, done: int) -> None:
        """Report a part that has ended."""
        if (update := self.part()) is not None:
            update(done, done)


def _given(
    source: object, shared: bool, limit: int, work: Path
) -> tuple[str | None, dict[str, Any], tuple[Material, ...]]:
    """Return the path of a file that fits, or arrays, which may fit or not, and their materials."""
    if isinstance(source, str | bytes | os.PathLike):
        path = _checks.path_of(source, "source")
        if os.path.isdir(path):
            return _of_paths(_piece_files.files_of(path), limit, work)
        if _piece_files.fits(path, limit):
            return path, {}, ()
        notes = Notes()
        arrays = _piece_files.of_file(path, work, notes)
        notes.warn(path)
        return path, arrays, _pieces.looks(work)
    if isinstance(source, tuple | list):
        if source and isinstance(source[0], str | bytes | os.PathLike):
            return _of_paths(source, limit, work)
        if len(source) == 3 and isinstance(source[2], Mapping):
            attributes = dict(source[2])
            given = attributes.pop("materials", None)
            looks = () if given is None else several(given, "materials")
            return None, _pieces.of_arrays(source[0], source[1], attributes, work, limit), looks
        if len(source) == 2 and not isinstance(source[0], tuple | list):
            return None, _pieces.of_arrays(source[0], source[1], {}, work, limit), ()
    if isinstance(source, Iterable) and not isinstance(source, np.ndarray):
        pieces = iter(source)
        first = next(pieces, None)
        chained = pieces if first is None else chain([first], pieces)
        if isinstance(first, str | bytes | os.PathLike):
            return _of_paths(chained, limit, work)
        return None, _pieces.of_pieces(chained, work, shared=shared), ()
    raise DtypeError(
        "source: expected a path, paths, (vertices, faces), (vertices, faces, attributes) or pieces, "
        f"not {type(source).__name__}"
    )


def _of_paths(
    paths: Iterable[Any], limit: int, work: Path
) -> tuple[None, dict[str, Any], tuple[Material, ...]]:
    """Return what is in several files."""
    names = [_checks.path_of(path, "source") for path in paths]
    notes = Notes()
    arrays = _piece_files.of_files(names, work, limit, notes)
    notes.warn(f"{names[0]} and {len(names) - 1} more" if len(names) > 1 else names[0])
    return None, arrays, _pieces.looks(work)


def bytes_of(memory: int | str) -> int:
    """Return a number of bytes."""
    if isinstance(memory, str):
        match = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([kmgt]?)(i?)b?\s*", memory.lower())
        if not match:
            raise ArgumentError(f"memory: expected bytes, or such as '4 GiB' or '500 MB', not {memory!r}")
        power = " kmgt".index(match[2] or " ")
        return int(float(match[1]) * (1 << 10 * power if match[3] else 10 ** (3 * power)))
    return _checks.whole(memory, "memory", 1)
