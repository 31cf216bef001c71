"""Virtualized geometry: a mesh of any size as a cluster LOD DAG, true cuts of it, and a renderer."""

from __future__ import annotations

from nanite_rs import shapes
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
    "shapes",
]
