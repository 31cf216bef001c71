"""Files that other files name, as their writers wrote them: in any encoding or case, and from other systems."""

from __future__ import annotations

import errno
import os
import unicodedata
from typing import TYPE_CHECKING

from nanite_rs import _advice
from nanite_rs._images import read_bytes, read_image
from nanite_rs.exceptions import FileError, FormatError, MissingFileError
from nanite_rs.texture import Image

if TYPE_CHECKING:
    from pathlib import Path

    from nanite_rs._asset import Notes


def text(raw: bytes) -> str:
    """Return what bytes of unknown encoding say: UTF-8 if they can be that, otherwise Latin-1."""
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError:
        return raw.decode("latin-1")


def find(folder: Path, name: str) -> Path | None:
    """Return the file of a folder that a name means, or nothing.

    The whole name is tried first, then its ends: paths of another machine end in what lies beside. Names are
    compared as texts, whatever their encoding on the disk, and where none is equal without regard to case.
    """
    plain = name.strip().strip('"').replace("\\", "/")
    if "\0" in plain or not plain:
        return None
    whole = folder / plain
    if os.path.isfile(whole):
        return whole
    parts = [part for part in plain.split("/") if part not in ("", ".")]
    for first in range(len(parts)):
        found = _walk(folder, parts[first:])
        if found is not None:
            return found
    return None


def _walk(folder: Path, parts: list[str]) -> Path | None:
    at = folder
    for part in parts:
        if part == "..":
            at = at / part
            continue
        if not os.path.lexists(at / part):
            try:
                entries = sorted(os.listdir(at))
            except OSError:
                return None
            wanted = _key(part)
            same = next((entry for entry in entries if _key(text(os.fsencode(entry))) == wanted), None)
            if same is None:
                return None
            at = at / same
        else:
            at = at / part
    return at if os.path.isfile(at) else None


def _key(name: str) -> str:
    return unicodedata.normalize("NFC", name).casefold()


class Pictures:
    """Images that a file names, each read once. Those that cannot be read are errors, or noted."""

    def __init__(self, folder: Path | None, drop: bool, notes: Notes) -> None:
        self.folder, self._drop, self._notes = folder, drop, notes
        self._known: dict[Path, Image | None] = {}

    def get(self, what: str, *names: str) -> Image | None:
        """Return the first image that is there under one of the names; ``what`` asks for it in errors."""
        try:
            return self._read(what, names)
        except (FileError, FormatError) as error:
            if not self._drop:
                raise _advice.advised(error, _advice.WITHOUT_TEXTURE) from None
            self._notes.add("textures left out, as they cannot be read", str(error))
            return None

    def _read(self, what: str, names: tuple[str, ...]) -> Image | None:
        if self.folder is None:
            reason = "it lies in a file of its own, and nothing says in which folder; give the path"
            raise MissingFileError(errno.ENOENT, reason, f"{what}: {names[0]}")
        found = next((path for name in names if (path := find(self.folder, name)) is not None), None)
        path = self.folder / names[0].replace("\\", "/") if found is None else found
        if path not in self._known:
            self._known[path] = None
            self._known[path] = Image(read_image(read_bytes(path, what), f"{what}: {path}"))
        return self._known[path]
