"""Settings of many trees in one TOML file, for `nanite-rs foliage`."""

from __future__ import annotations

import sys
from fnmatch import fnmatch
from pathlib import Path
from typing import Any, Final

from nanite_rs import _advice
from nanite_rs._images import read_bytes
from nanite_rs.exceptions import ArgumentError, FormatError

NAMES: Final = ("leaf_materials", "cutoff", "tolerance", "triangles_per_leaf", "textures", "wind", "up")
"""What a tree may be given: arguments of `to_geometry`."""
_FILES: Final = "files"


class Settings:
    """Settings that hold for all trees, and those of single ones by patterns of their files' names."""

    def __init__(self, path: str) -> None:
        self._path = path
        read = _parsed(path)
        files = read.pop(_FILES, {})
        if not isinstance(files, dict) or not all(isinstance(one, dict) for one in files.values()):
            raise FormatError(f'{path}: {_FILES}: expected tables such as [{_FILES}."birch*.obj"]')
        self._all = self._checked(read, "")
        self._files = {name: self._checked(own, f'{_FILES}."{name}".') for name, own in files.items()}

    def _checked(self, given: dict[str, Any], where: str) -> dict[str, Any]:
        for name in given:
            if name not in NAMES:
                allowed = ", ".join(NAMES) + ("" if where else f", {_FILES}")
                raise ArgumentError(f"{self._path}: there is no setting {where}{name}; there are {allowed}")
        out = dict(given)
        if isinstance(out.get("textures"), dict):
            # They lie where the settings lie.
            folder = Path(self._path).parent
            out["textures"] = {name: str(folder / str(image)) for name, image in out["textures"].items()}
        return out

    def of(self, path: Path) -> dict[str, Any]:
        """Return the keyword arguments of a tree; later patterns count more."""
        out = dict(self._all)
        for pattern, own in self._files.items():
            if fnmatch(path.name, pattern) or fnmatch(path.as_posix(), f"*/{pattern}"):
                out |= own
        return out


def _parsed(path: str) -> dict[str, Any]:
    try:
        if sys.version_info >= (3, 11):
            import tomllib as toml
        else:
            import tomli as toml
    except ImportError as error:
        raise _advice.missing("--config", "tomli") from error
    try:
        text = read_bytes(path, "settings").decode("utf-8")
        return dict(toml.loads(text))
    except (UnicodeDecodeError, toml.TOMLDecodeError) as error:
        raise FormatError(f"{path}: no TOML: {error}") from None
