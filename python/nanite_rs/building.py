"""Builds into files: of sources larger than memory, too."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from nanite_rs import _checks, _pieces, io
from nanite_rs._arrays import as_array, core_arrays
from nanite_rs._asset import Notes
from nanite_rs._core import BYTES_PER_TRIANGLE
from nanite_rs._core import Mesh as CoreMesh
from nanite_rs._progress import reporter
from nanite_rs.exceptions import ArgumentError, DtypeError, FileError, FormatError
from nanite_rs.mesh import NaniteMesh
from nanite_rs.options import BuildOptions, no_options

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from nanite_rs._progress import Progress

__all__ = ["build_file"]


def build_file(
    source: object,
    path: io.PathLike,
    *,
    memory: int | str = "4 GiB",
    options: BuildOptions | None = None,
    folder: io.PathLike | None = None,
    progress: Progress = None,
) -> NaniteMesh:
    """Build a ``.nanite`` file from a source that may be larger than memory, and open it.

    A source that fits is built in memory, and the file is the same as by `NaniteMesh.from_file` and
    `NaniteMesh.save`. One that does not is put into blocks on disk, by where its faces lie. The levels of each
    block grow in memory, while what blocks share stays as it is. What is left of them, a sixteenth or less, is put
    into other blocks with other borders, until one is left. Errors are proven as in memory, cuts have no cracks,
    and the same source, options and memory give the same bytes on any number of threads. The scheme is that of
    Cignoni et al., "External Memory Management and Simplification of Huge Meshes", IEEE TVCG 9(4), 2003, with the
    groups of a cluster DAG.

    Parameters
    ----------
    source : path, pair of arrays, or iterable of pieces
        A file: binary PLY of triangles and binary STL are read piece by piece, everything that
        `NaniteMesh.from_file` reads where it fits in memory. Two arrays, which may be memory maps, as
        `NaniteMesh.from_arrays` takes them. Or pieces, each ``(vertices, faces)`` or
        ``(vertices, faces, attributes)``, where faces count the vertices of their piece from 0, and a dict has what
        it has of ``normals``, ``colors``, ``uvs`` and ``face_materials``: all pieces have the same. Pieces may
        touch: vertices that are equal are one.
    path : path
        The file, ending in ``.nanite``; an existing one is replaced in one step or not at all.
    memory : int or str, default "4 GiB"
        Bytes that the build may take, about, beyond what it started with; a number, or one with a unit such as
        ``"2G"``, ``"500 MB"`` or ``"4 GiB"``. Tables of all vertices come on top: some 4 bytes for each vertex of
        all levels.
    options : BuildOptions, optional
        How to build. ``preserve_area`` is for sources that fit.
    folder : path, optional
        Where a folder is made for what does not fit, some 150 bytes for each face, and removed in the end; by
        default beside the file.
    progress : bool or callable, optional
        As for `NaniteMesh.from_arrays`.

    Returns
    -------
    NaniteMesh
        The file, opened.

    Raises
    ------
    FormatError
        The file is of a format, or a kind of it, that is read in memory alone, and does not fit.
    MeshError, ArgumentError, DtypeError
        As `NaniteMesh.from_arrays`.
    FileError
        A file cannot be read or written, as where the disk is full.

    Warns
    -----
    UserWarning
        What of a file read in pieces is not kept, such as channels.

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
    """
    path = _checks.path_of(path)
    if os.path.splitext(path)[1].lower() != io.NANITE_SUFFIX:
        raise FormatError(f"{path}: the file must end in {io.NANITE_SUFFIX}")
    if not isinstance(options, BuildOptions | None):
        raise no_options(options)
    limit = _bytes(memory)
    target = Path(path)
    place = target.parent if folder is None else Path(_checks.path_of(folder, "folder"))
    try:
        work = Path(tempfile.mkdtemp(prefix=".nanite-", dir=place))
    except OSError as error:
        raise FileError(f"{place}: {error.strerror or error}") from error
    try:
        given = _given(source, limit, work)
        if isinstance(given, str):
            NaniteMesh.from_file(given, options=options, progress=progress).save(target)
        else:
            _build(given, target, limit, options or BuildOptions(), work, progress)
    except OSError as error:
        raise FileError(f"{error.filename or work}: {error.strerror or error}") from error
    finally:
        shutil.rmtree(work, ignore_errors=True)
    return NaniteMesh.open(target)


def _build(
    arrays: dict[str, Any], target: Path, limit: int, options: BuildOptions, work: Path, progress: Progress
) -> None:
    """Build from arrays, in memory where they fit."""
    vertices, faces = as_array(arrays["vertices"], "vertices"), as_array(arrays["faces"], "faces")
    uvs = [arrays[name] for name in sorted(arrays) if name.startswith("uvs")]
    given = {name: arrays.get(name) for name in ("normals", "colors", "face_materials")} | {"uvs": uvs}
    if faces.ndim and len(faces) * BYTES_PER_TRIANGLE <= limit:
        NaniteMesh.from_arrays(vertices, faces, **given, options=options, progress=progress).save(target)
        return
    with reporter(progress, "building") as report:
        CoreMesh.build_file(
            core_arrays(vertices, faces, given, None),
            target,
            options=asdict(options),
            memory=limit,
            folder=work,
            progress=report,
        )


def _given(source: object, limit: int, work: Path) -> str | dict[str, NDArray[Any]]:
    """Return a path to read in memory, or arrays."""
    if isinstance(source, str | bytes | os.PathLike):
        return _file(_checks.path_of(source, "source"), limit, work)
    if isinstance(source, tuple | list) and len(source) == 2 and not isinstance(source[0], tuple | list):
        return {"vertices": np.asanyarray(source[0]), "faces": np.asanyarray(source[1])}
    if isinstance(source, Iterable) and not isinstance(source, np.ndarray):
        return _pieces.of_pieces(source, work)
    raise DtypeError(f"source: expected a path, (vertices, faces) or pieces, not {type(source).__name__}")


def _file(path: str, limit: int, work: Path) -> str | dict[str, NDArray[Any]]:
    """Return the path where a file fits, else what is in it."""
    try:
        size = os.path.getsize(path)
    except OSError:
        return path  # whoever reads it says why not
    # No format has less than 12 bytes for a face.
    if size // 12 * BYTES_PER_TRIANGLE <= limit:
        return path
    ending, packed = io.ending(Path(path))
    if ending not in _pieces.ENDINGS or packed:
        some = ", ".join(f".{name}" for name in _pieces.ENDINGS)
        raise FormatError(
            f"{path}: {size:,} bytes; of files that may not fit in memory, only {some} are read"
        )
    notes = Notes()
    arrays = _pieces.of_file(path, ending, work, notes)
    notes.warn(path)
    return arrays


def _bytes(memory: int | str) -> int:
    """Return a number of bytes."""
    if isinstance(memory, str):
        match = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([kmgt]?)(i?)b?\s*", memory.lower())
        if not match:
            raise ArgumentError(f"memory: expected bytes, or such as '4 GiB' or '500 MB', not {memory!r}")
        power = " kmgt".index(match[2] or " ")
        return int(float(match[1]) * (1 << 10 * power if match[3] else 10 ** (3 * power)))
    return _checks.whole(memory, "memory", 1)
