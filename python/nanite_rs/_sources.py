"""What is read from: objects of stores, files of file systems, and file objects of Python.

A `Source` says how one range is read and when what it reads from has become something else. `_remote` says what is
asked of it, and when.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Protocol
from urllib.parse import parse_qsl, urlencode, urlsplit, urlunsplit

from nanite_rs import _advice
from nanite_rs.exceptions import (
    AccessError,
    ArgumentError,
    ChangedFileError,
    DependencyError,
    DtypeError,
    FileError,
    ForkError,
    MissingFileError,
    NaniteError,
    ServerError,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from contextlib import AbstractContextManager

# Seconds until a server that says nothing counts as a passing error.
_TIMEOUTS: Final = {"timeout": "30s", "connect_timeout": "5s"}
# What obstore takes of the environment, such as AWS_ALLOW_HTTP, where it is given no options of its client.
_CLIENT: Final = (
    "allow_http",
    "allow_invalid_certificates",
    "connect_timeout",
    "proxy_ca_certificate",
    "proxy_excludes",
    "proxy_url",
    "timeout",
    "user_agent",
)

# Parts of a URL that allow reading it for a while, and say nothing of what is there.
_SIGNATURE: Final = re.compile(
    r"(?i)^(x-(amz|goog)-.*|sig|signature|expires|policy|key-pair-id|awsaccesskeyid|googleaccessid|s[eprtv]|sk.+|spr|token)$"
)
STORES: Final = frozenset({"http", "https", "s3", "s3a", "gs", "az", "abfs", "abfss", "adl", "azure"})

# Whoever lends a machine says there for whom it runs. obstore asks where nothing else has credentials.
_LENDER: Final = re.compile(r"169\.254\.169\.254|metadata\.google\.internal|://[^/\s]+/latest/api/token")


class Refusal(Exception):  # noqa: N818
    """Why a range could not be read."""

    def __init__(self, kind: type[NaniteError], message: str, *, passing: bool = False) -> None:
        super().__init__(message)
        self.kind, self.passing = kind, passing


def raised(refusal: Refusal, name: str) -> NaniteError:
    """Return the error that a refusal is, with the name of what it is about."""
    return refusal.kind(f"{name}: {refusal}")


@dataclass(frozen=True)
class Identity:
    """What tells a file from another one that has taken its place."""

    size: int
    tag: str | None
    """An ETag, or what else there is, such as the time of the last change."""

    def require(self, other: Identity) -> None:
        """Raise a refusal where another one differs, which says how."""
        if self.size != other.size:
            how = f"it had {self.size} bytes and has {other.size}"
        elif self.tag is not None and self.tag != other.tag:
            how = f"its ETag or time of change was {self.tag} and is {other.tag}"
        else:
            return
        raise Refusal(ChangedFileError, f"the file changed after it was opened: {how}")


class Source(Protocol):
    """What ranges are read from, by several threads."""

    name: str
    """What errors call it."""

    def first(self, end: int) -> tuple[Identity, bytes]:
        """Read the first bytes, as many as there are up to ``end``."""

    def read(self, start: int, end: int, expected: Identity) -> bytes:
        """Read a range of the file that was opened; raise `Refusal`."""


# ---------------------------------------------------------------------------------------------------- URLs


def is_url(value: object) -> bool:
    """Whether it is a string with a scheme."""
    return (
        isinstance(value, str) and re.match(r"[A-Za-z][A-Za-z0-9+.-]*(::[a-z0-9+.-]+)*://", value) is not None
    )


def ending(where: str) -> str:
    """Return how the name of the file ends that a path or a URL says, with the dot, in small letters."""
    return os.path.splitext(where.partition("?")[0] if is_url(where) else where)[1].lower()


def written_scheme(url: str) -> str:
    """Return the scheme of a URL that something can be written to, or raise."""
    scheme = url.partition("://")[0].lower()
    if scheme in {"http", "https"}:
        raise FileError(
            f"{shown(url)}: what has a URL of {scheme} is read and not written; "
            "give that of a store, such as s3://, or a path"
        )
    return scheme


def shown(where: str) -> str:
    """Return a URL without user, password and signature: for messages and as a name. A path stays as it is."""
    if not is_url(where):
        return where
    parts = urlsplit(where)
    place = parts.netloc.rpartition("@")[2]
    query = [pair for pair in parse_qsl(parts.query, keep_blank_values=True) if not _SIGNATURE.match(pair[0])]
    return urlunsplit((parts.scheme, place, parts.path, urlencode(query), ""))


def _missing(name: str, package: str, install: str) -> DependencyError:
    return DependencyError(f"{name}: it needs {package}: pip install {install}")


_owner: int | None = None
"""The process that used obstore first: its threads are not in processes that are forked from it."""


class ObjectStore:
    """An object of a store that obstore knows."""

    use, absent = "reading", "there is no such file"
    """What errors say."""

    def __init__(
        self, url: str, options: Mapping[str, Any], timeouts: Mapping[str, str] | None = None
    ) -> None:
        self.name = shown(url)
        try:
            import obstore
        except ImportError:
            raise _missing(self.name, "obstore", '"nanite_rs[cloud]"') from None
        self._obstore = obstore
        parts = urlsplit(url)
        client = {
            **_TIMEOUTS,
            **(timeouts or {}),
            **_environment(parts.scheme),
            **options.get("client_options", {}),
        }
        if parts.scheme == "http":
            client.setdefault("allow_http", True)
        # Trying again is the core's business.
        known = {"retry_config": {"max_retries": 0}, **options, "client_options": client}
        # Of HTTP the whole URL is the store, with its query; of the others the bucket.
        if parts.scheme in {"http", "https"}:
            base, self._path = url, ""
            # By itself obstore takes the hosts of Amazon and others for their stores, which ask for credentials.
            make = obstore.store.HTTPStore.from_url
        else:
            base, _, self._path = url.partition("://" + parts.netloc + "/")
            base += f"://{parts.netloc}"
            make = obstore.store.from_url
        self._claim()
        try:
            self._store = make(base, **known)
        except BaseException as error:
            # Whatever options it does not take; of some it panics, which is no Exception.
            if not isinstance(error, Exception) and type(error).__name__ != "PanicException":
                raise
            raise FileError(f"{self.name}: {_first_line(error, url)}") from None

    def _claim(self) -> None:
        global _owner  # noqa: PLW0603
        if _owner is None:
            _owner = os.getpid()
        if _owner != os.getpid():
            raise ForkError(
                f"{self.name}: obstore was used before this process was forked, and does not work here: start "
                'workers with "spawn" or "forkserver"'
            )

    def _get(self, start: int, end: int, match: str | None) -> tuple[Any, bytes]:
        try:
            self._claim()
        except ForkError as error:
            raise Refusal(ForkError, str(error).partition(": ")[2]) from None
        options: dict[str, Any] = {"range": (start, end)}
        if match is not None:
            options["if_match"] = match
        try:
            result = self._obstore.get(self._store, self._path, options=options)
            return result, bytes(result.bytes())
        except Exception as error:  # obstore's own and Python's
            raise self._refusal(error) from None

    def first(self, end: int) -> tuple[Identity, bytes]:
        result, data = self._get(0, end, None)
        identity = _identity(result.meta)
        if len(data) != min(end, identity.size):
            raise Refusal(ServerError, f"the server sent {len(data)} bytes of {min(end, identity.size)}")
        return identity, data

    def read(self, start: int, end: int, expected: Identity) -> bytes:
        # Weak ETags match nothing; what comes back is compared anyway.
        tag = expected.tag
        strong = tag if tag is not None and tag.startswith('"') else None
        try:
            result, data = self._get(start, end, strong)
        except Refusal as refusal:
            if refusal.kind is ServerError and not refusal.passing:
                self._look(expected)
            raise
        expected.require(_identity(result.meta))
        if tuple(result.range) != (start, end) or len(data) != end - start:
            raise Refusal(ServerError, f"the server sent {len(data)} bytes of bytes {start} to {end}")
        return data

    def _look(self, expected: Identity) -> None:
        """Find out whether what is wrong is another file."""
        try:
            found = _identity(self._obstore.head(self._store, self._path))
        except Exception:  # what was wrong before is
            return
        expected.require(found)

    def _refusal(self, error: Exception) -> Refusal:
        kinds = self._obstore.exceptions
        text = _first_line(error, self.name)
        found = re.search(r"status code: (\d{3}[^:\n]*)", str(error))
        status = found[1].strip() if found else ""
        if _LENDER.search(str(error)):
            return Refusal(AccessError, "no credentials were found, in storage_options or elsewhere")
        if isinstance(error, FileNotFoundError | kinds.NotFoundError) or status.startswith("404"):
            return Refusal(MissingFileError, f"{self.absent} ({status or '404 Not Found'})")
        if isinstance(error, kinds.PermissionDeniedError | kinds.UnauthenticatedError):
            what = f"credentials are missing, wrong or expired, or do not allow {self.use} it"
            return Refusal(AccessError, f"{what} ({status})")
        if isinstance(error, kinds.PreconditionError):
            return Refusal(ChangedFileError, "the file changed after it was opened: its ETag is another one")
        if isinstance(error, kinds.NotSupportedError):
            return Refusal(
                ServerError, f"the server does not send ranges of bytes, which reading needs ({text})"
            )
        if "UnexpectedRange" in str(error) or "object was only" in str(error):
            return Refusal(ServerError, f"the server sent another range than was asked for ({text})")
        if status:
            number = int(status[:3])
            passing = number in {408, 425, 429} or (number >= 500 and number not in {501, 505})
            return Refusal(ServerError, f"the server answered {status}", passing=passing)
        return Refusal(ServerError, text, passing=True)


def _environment(scheme: str) -> dict[str, str]:
    """What the environment says of the client of a store."""
    prefix = {"s3": "AWS_", "s3a": "AWS_", "gs": "GOOGLE_"}.get(scheme, "AZURE_")
    known = {name: os.environ.get(f"{prefix}{name.upper()}") for name in _CLIENT}
    return {name: value for name, value in known.items() if value is not None}


def _identity(meta: Mapping[str, Any]) -> Identity:
    changed = meta.get("last_modified")
    return Identity(int(meta["size"]), meta.get("e_tag") or (None if changed is None else str(changed)))


def _first_line(error: BaseException, url: str) -> str:
    """What an error says, without the URL and what debuggers want."""
    text = str(error).partition("\n")[0].strip() or type(error).__name__
    text = re.sub(r"Error performing \w+ \S+ in \S+ - ", "", text)
    return (
        text.replace(url, shown(url)).removeprefix("Generic HTTP error: ").removeprefix("Generic S3 error: ")
    )


class FileSystem:
    """A file of a file system that fsspec knows."""

    use, absent = ObjectStore.use, ObjectStore.absent

    def __init__(self, url: str, options: Mapping[str, Any]) -> None:
        self.name = shown(url)
        try:
            import fsspec
        except ImportError:
            raise _missing(self.name, "fsspec", "fsspec") from None
        try:
            self._files, self._path = fsspec.core.url_to_fs(url, **options)
        except ImportError as error:
            raise DependencyError(f"{self.name}: {error}") from None
        except Exception as error:
            raise FileError(f"{self.name}: {type(error).__name__}: {error}") from None

    def _plain_errors(self) -> AbstractContextManager[None]:
        return _plain_errors(self.use, self.absent)

    def _identity(self) -> Identity:
        self._files.invalidate_cache()
        info = self._files.info(self._path)
        size = info.get("size")
        if size is None:
            raise Refusal(ServerError, "the file system does not say how large the file is")
        names = (
            "ETag",
            "etag",
            "e_tag",
            "mtime",
            "LastModified",
            "last_modified",
            "modified",
            "created",
            "md5Hash",
        )
        tags = [f"{name}={info[name]}" for name in names if info.get(name) is not None]
        return Identity(int(size), " ".join(tags) or None)

    def first(self, end: int) -> tuple[Identity, bytes]:
        with self._plain_errors():
            identity = self._identity()
            data = bytes(self._files.cat_file(self._path, start=0, end=min(end, identity.size)))
            return identity, data

    def read(self, start: int, end: int, expected: Identity) -> bytes:
        with self._plain_errors():
            data = bytes(self._files.cat_file(self._path, start=start, end=end))
            # Afterwards: what was read before it changed is of the file that was opened.
            found = self._identity()
        expected.require(found)
        if len(data) != end - start:
            raise Refusal(ServerError, f"{len(data)} bytes came of bytes {start} to {end}")
        return data


@contextlib.contextmanager
def _plain_errors(use: str = "reading", absent: str = "there is no such file") -> Iterator[None]:
    """What file systems raise, as refusals."""
    try:
        yield
    except (Refusal, NaniteError):
        raise
    except FileNotFoundError:
        raise Refusal(MissingFileError, absent) from None
    except PermissionError as error:
        raise Refusal(AccessError, f"{use} is not allowed: {error}") from None
    except (OSError, TimeoutError) as error:
        raise Refusal(ServerError, f"{type(error).__name__}: {error}", passing=True) from None
    except Exception as error:
        raise Refusal(ServerError, f"{type(error).__name__}: {error}") from None


# -------------------------------------------------------------------------------------------- file objects


class _FileObject:
    """A file of Python, of which the position is changed and not relied upon."""

    def __init__(self, file: Any) -> None:
        name = getattr(file, "name", None)
        self.name = (
            os.fsdecode(name) if isinstance(name, str | bytes) and name else f"<{type(file).__name__}>"
        )
        self._file = file
        self._lock = threading.Lock()
        self._process = os.getpid()
        # Of plain files the system reads ranges, whatever others do with the position, forked processes too.
        raw = file.raw if type(file) is io.BufferedReader else file
        self._at: int | None = file.fileno() if type(raw) is io.FileIO and hasattr(os, "pread") else None

    def _guarded(self) -> Any:
        if self._process == os.getpid():
            return self._lock
        if self._at is None and not isinstance(self._file, io.BytesIO):
            raise Refusal(
                ForkError,
                "its position is shared with the process that this one was forked from: open it here",
            )
        # The lock may be held by a thread that is not here.
        self._lock, self._process = threading.Lock(), os.getpid()
        return self._lock

    def _identity(self) -> Identity:
        if self._at is not None:
            status = os.fstat(self._at)
            return Identity(status.st_size, str(status.st_mtime_ns))
        size = self._file.seek(0, io.SEEK_END)
        return Identity(self._file.tell() if size is None else size, None)

    def _bytes(self, start: int, end: int) -> bytes:
        parts, at = [], start
        if self._at is None:
            self._file.seek(start)
        else:
            self._file.fileno()  # of a closed file an error
        while at < end:
            part = self._file.read(end - at) if self._at is None else os.pread(self._at, end - at, at)
            if isinstance(part, str):
                raise Refusal(DtypeError, 'it is opened as text: open it with "rb"')
            if not part:
                break
            parts.append(bytes(part))
            at += len(part)
        return b"".join(parts)

    def first(self, end: int) -> tuple[Identity, bytes]:
        with _plain_errors(), self._guarded():
            identity = self._identity()
            return identity, self._bytes(0, min(end, identity.size))

    def read(self, start: int, end: int, expected: Identity) -> bytes:
        with _plain_errors(), self._guarded():
            data = self._bytes(start, end)
            found = self._identity()
        expected.require(found)
        if len(data) != end - start:
            raise Refusal(ServerError, f"it ended at byte {start + len(data)}, before byte {end}")
        return data


def is_file(value: object) -> bool:
    """Whether it is a file object."""
    return hasattr(value, "read") and hasattr(value, "seek")


# ------------------------------------------------------------------------------------------------- opening


def checked_options(
    where: Any, storage_options: Mapping[str, Any] | None, cache_dir: Any = None
) -> dict[str, Any]:
    """Return the options of a URL; nothing else has any, or a cache."""
    if not is_url(where):
        for name, value in (("cache_dir", cache_dir), ("storage_options", storage_options)):
            if value is not None:
                raise ArgumentError(f"{name}: goes with a URL")
    if storage_options is None:
        return {}
    if not hasattr(storage_options, "items"):
        raise DtypeError(f"storage_options: expected a mapping, not {_advice.name_of_type(storage_options)}")
    return dict(storage_options)


def source_of(where: object, options: Mapping[str, Any]) -> Source:
    """Return what reads a URL or a file object."""
    if isinstance(where, str):
        scheme = where.partition("://")[0].lower()
        return ObjectStore(where, options) if scheme in STORES else FileSystem(where, options)
    if is_file(where):
        return _FileObject(where)
    raise DtypeError(
        f"path: expected a path, a URL or a binary file with seek and read, not {_advice.name_of_type(where)}"
    )
