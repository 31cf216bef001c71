"""Reading: paths, open files, bytes and objects of trimesh, as descriptions or as one mesh."""

from __future__ import annotations

import gzip
import os
import zlib
from dataclasses import dataclass
from importlib import import_module
from io import TextIOBase
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from nanite_rs import _advice, _trimesh
from nanite_rs._asset import Source
from nanite_rs._checks import path_of
from nanite_rs._flatten import flattened
from nanite_rs._images import read_bytes
from nanite_rs.exceptions import ArgumentError, DtypeError, FormatError

if TYPE_CHECKING:
    from typing import BinaryIO

    import trimesh

    from nanite_rs._asset import Asset

__all__ = ["Source", "from_file", "from_trimesh"]

#: Suffix of built meshes.
NANITE_SUFFIX: Final = ".nanite"
#: Endings of glTF.
GLTF: Final = ("glb", "gltf")

#: Formats with a module of their own here, by endings. Each has
#: ``read(name, data, folder, *, drop_bad_textures) -> Asset``; trimesh reads everything else.
READERS: Final = {
    "glb": "nanite_rs._gltf",
    "gltf": "nanite_rs._gltf",
    "obj": "nanite_rs._obj",
    "off": "nanite_rs._off",
    "ply": "nanite_rs._ply",
    "stl": "nanite_rs._stl",
}

PathLike: TypeAlias = "str | bytes | os.PathLike[str] | os.PathLike[bytes]"
Readable: TypeAlias = "PathLike | bytearray | memoryview | BinaryIO | File"

# The longest path. Longer bytes, or bytes with a zero, are the content of a file.
_LONGEST: Final = 4096
# The first bytes of formats that identify themselves.
_STARTS: Final = {
    b"glTF": "glb",
    b"ply\n": "ply",
    b"ply\r": "ply",
    b"{": "gltf",
    b"OFF": "off",
    b"solid": "stl",
}


# --------------------------------------------------------------------------------------------------- files


def ending(path: Path) -> tuple[str, bool]:
    """What a file holds by its name, in small letters without the dot, and whether it is packed by gzip."""
    packed = path.suffix.lower() == ".gz"
    return (Path(path.stem) if packed else path).suffix.lower().removeprefix("."), packed


def stem(path: str) -> str:
    """The name of a file without folder and endings, for what is made of it."""
    name = Path(path).name
    return (name[:-3] if name.lower().endswith(".gz") else name).rsplit(".", 1)[0]


@dataclass(frozen=True)
class File:
    """What a user gave to read: its name in errors, and its content, which is read when it is asked for."""

    name: str
    path: Path | None
    """Where it lies, or where an open file says that it does."""
    format: str
    """Ending without the dot, in small letters."""
    packed: bool
    given: bytes | None

    @property
    def folder(self) -> Path | None:
        """Where files lie that it refers to."""
        return None if self.path is None else self.path.parent

    def raw(self) -> bytes:
        """Return the content as it lies there."""
        if self.given is not None or self.path is None:
            return self.given or b""
        return read_bytes(self.path)

    def data(self) -> bytes:
        """Return the content, unpacked."""
        raw = self.raw()
        if not self.packed:
            return raw
        try:
            return gzip.decompress(raw)
        except (OSError, EOFError, ValueError, zlib.error) as error:
            raise FormatError(f"{self.name}: cannot be unpacked: {error}") from None


def given_file(source: object, format: str | None = None, name: str = "path") -> File:
    """Take a path, an open binary file, or the content of one.

    Parameters
    ----------
    source : str, bytes, os.PathLike, bytearray, memoryview or binary file
        ``bytes`` are a path, unless ``format`` is given or they can be none.
    format : str, optional
        Ending of such files, such as ``"glb"`` or ``"ply.gz"``, instead of that of the name.
    name : str
        What errors call the argument.

    Raises
    ------
    DtypeError, ArgumentError
        It is nothing of that.
    """
    if isinstance(source, File):
        return source
    if format is not None and not isinstance(format, str):
        raise DtypeError(f"format: expected an ending such as 'glb', not {_advice.name_of_type(format)}")
    known = None if format is None else Path("x." + format.strip().lower().lstrip("."))
    content: bytes | None = None
    path: Path | None = None
    if isinstance(source, bytes) and (known is not None or b"\0" in source or len(source) > _LONGEST):
        content = source
    elif isinstance(source, bytearray | memoryview):
        content = bytes(source)
    elif isinstance(source, str | bytes | os.PathLike):
        path = Path(path_of(source, name))
    elif hasattr(source, "read"):
        content, path = _read(source, name)
    else:
        raise DtypeError(
            f"{name}: expected a path, an open binary file or bytes, not {_advice.name_of_type(source)}"
        )
    label = "bytes" if path is None else str(path)
    kind, packed = ending(known or path or Path("bytes"))
    if content is not None:
        packed = packed or content.startswith(b"\x1f\x8b")
        if not kind:
            start = File(label, path, "", packed, content).data()[:16].lstrip()
            kind = next((kind for begin, kind in _STARTS.items() if start.startswith(begin)), "")
        if not kind:
            raise ArgumentError(f"{name}: nothing says what these bytes are; give format='glb' or the like")
    return File(label, path, kind, packed, content)


def _read(source: Any, name: str) -> tuple[bytes, Path | None]:
    """Read an open file to its end."""
    if isinstance(source, TextIOBase):
        raise DtypeError(f"{name}: it is open as text; open the file with mode 'rb'")
    try:
        content = source.read()
    except OSError as error:
        raise ArgumentError(f"{name}: the file cannot be read: {error}") from error
    except Exception as error:  # closed, or an object of any kind that has such a method
        raise ArgumentError(f"{name}: the file cannot be read: {error}") from None
    if not isinstance(content, bytes | bytearray | memoryview):
        found = type(content).__name__
        raise DtypeError(f"{name}: reading gives {found} and not bytes; open the file with mode 'rb'")
    label = getattr(source, "name", None)
    return bytes(content), Path(os.fsdecode(label)) if isinstance(label, str | bytes) and label else None


def read_asset(
    source: Readable, *, format: str | None = None, drop_bad_textures: bool = False, name: str = "source"
) -> Asset:
    """Read a file, building nothing."""
    file = given_file(source, format, name)
    module = READERS.get(file.format)
    if module is None:
        return _trimesh.read(file, drop_bad_textures=drop_bad_textures)
    reader = import_module(module)
    asset: Asset = reader.read(file.name, file.data(), file.folder, drop_bad_textures=drop_bad_textures)
    return asset


def from_file(
    source: Readable, *, format: str | None = None, bad_textures: str = "drop", name: str = "path"
) -> Source:
    """Read a file as one mesh: what `load_scene` makes of it, flattened.

    What is left out or changed is said in one warning.
    """
    if bad_textures not in ("raise", "drop"):
        raise ArgumentError(f"bad_textures: must be 'raise' or 'drop', not {bad_textures!r}")
    asset = read_asset(source, format=format, drop_bad_textures=bad_textures == "drop", name=name)
    out = flattened(asset)
    asset.notes.warn(asset.name)
    return out


def from_trimesh(mesh: trimesh.Trimesh | trimesh.Scene) -> Source:
    """Take the arrays out of a trimesh object; a Scene is flattened with its transforms.

    Parameters
    ----------
    mesh : trimesh.Trimesh or trimesh.Scene
        The mesh.

    Raises
    ------
    MeshError
        No triangles in it.
    DtypeError
        It is something else.
    """
    import trimesh

    if not isinstance(mesh, trimesh.Trimesh | trimesh.Scene):
        advice = "; NaniteMesh.from_file reads files" if isinstance(mesh, str | os.PathLike) else ""
        found = type(mesh).__name__
        raise DtypeError(f"mesh: expected trimesh.Trimesh or trimesh.Scene, not {found}{advice}")
    asset = _trimesh.described(mesh, "mesh", drop_bad_textures=True)
    out = flattened(asset)
    asset.notes.warn(asset.name)
    return out
