"""Every error of nanite_rs, and the warning of likely mistakes.

`NaniteError` is the base of all errors; each also derives from the built-in that a caller would catch.

Examples
--------
>>> import nanite_rs as nrs
>>> issubclass(nrs.FormatError, nrs.NaniteError) and issubclass(nrs.FormatError, ValueError)
True
"""

from __future__ import annotations

__all__ = [
    "AccessError",
    "ArgumentError",
    "BackendError",
    "ChangedFileError",
    "DependencyError",
    "DtypeError",
    "FileError",
    "ForkError",
    "FormatError",
    "InternalError",
    "InvariantError",
    "MeshError",
    "MissingFileError",
    "NaniteError",
    "ServerError",
    "StaleHandleError",
    "UsageWarning",
    "WorkerError",
]


class NaniteError(Exception):
    """Base of every error that nanite_rs raises."""


class ArgumentError(NaniteError, ValueError):
    """An argument has the wrong shape, range or combination; the message begins with its name."""


class DtypeError(ArgumentError, TypeError):
    """An argument has the wrong type or dtype."""


class MeshError(ArgumentError):
    """A mesh that cannot be built: not finite, an index out of range, empty, or too large."""


class FileError(NaniteError, OSError):
    """The operating system refused a file operation."""


class MissingFileError(FileError, FileNotFoundError):
    """A file or its folder does not exist."""


class AccessError(FileError, PermissionError):
    """Reading or writing is not allowed: credentials are missing, or a server does not take them."""


class ChangedFileError(FileError):
    """A file is not the one that was opened any more; nothing of the new one is used. Open it again."""


class ServerError(FileError):
    """A server is not there, or does not answer as it must: without ranges, or with other lengths."""


class FormatError(NaniteError, ValueError):
    """A file or byte string is not what it should be; the message says where and why."""


class DependencyError(NaniteError, ImportError):
    """An optional package is needed; the message has the line that installs it."""


class StaleHandleError(NaniteError, RuntimeError):
    """A handle refers to something that was removed from its scene."""


class BackendError(NaniteError, RuntimeError):
    """The requested rendering backend is not available here; the message says what is missing."""


class WorkerError(NaniteError, RuntimeError):
    """A worker of an executor or a cluster was lost, and what it did with it."""


class ForkError(NaniteError, RuntimeError):
    """Another thread used it when this process was forked; the message says what it is and what to do."""


class UsageWarning(UserWarning):
    """What was asked for can be done, but is seldom meant; the message says what to do."""


class InternalError(NaniteError, RuntimeError):
    """A fault of nanite_rs itself. The process goes on; please report it."""


class InvariantError(InternalError):
    """A built mesh breaks an invariant: a fault of the builder, or a damaged file."""
