"""Virtualized geometry: any mesh as a cluster LOD DAG, true cuts, and a renderer whose cost follows the pixels."""

from __future__ import annotations

from nanite_rs._core import __version__
from nanite_rs.exceptions import (
    ArgumentError,
    BackendError,
    DependencyError,
    DtypeError,
    FileError,
    FormatError,
    InternalError,
    InvariantError,
    MeshError,
    MissingFileError,
    NaniteError,
    StaleHandleError,
)

__all__ = [
    "ArgumentError",
    "BackendError",
    "DependencyError",
    "DtypeError",
    "FileError",
    "FormatError",
    "InternalError",
    "InvariantError",
    "MeshError",
    "MissingFileError",
    "NaniteError",
    "StaleHandleError",
    "__version__",
]
