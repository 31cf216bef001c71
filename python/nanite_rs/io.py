"""Files, objects of trimesh and descriptions of scenes as the arrays of one mesh."""

from __future__ import annotations

import gzip
import os
import zlib
from dataclasses import dataclass, field, replace
from importlib import import_module
from io import TextIOBase
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np

from nanite_rs import _advice, _colors, _face_data
from nanite_rs._asset import as_labels, has_area
from nanite_rs._checks import path_of
from nanite_rs._images import read_bytes
from nanite_rs.exceptions import ArgumentError, DtypeError, FormatError, MeshError
from nanite_rs.material import Material

if TYPE_CHECKING:
    from collections.abc import Iterable
    from typing import BinaryIO

    import trimesh
    from numpy.typing import NDArray

    from nanite_rs._asset import Asset, Notes, Part

__all__ = ["Source", "from_file", "from_trimesh"]

#: Suffix of built meshes.
NANITE_SUFFIX: Final = ".nanite"
#: Endings of glTF.
GLTF: Final = ("glb", "gltf")

#: Formats with a module of their own here, by endings. Each has
#: ``read(name, data, folder, *, drop_bad_textures) -> Asset``; trimesh reads everything else.
READERS: Final = {
    "glb": "_gltf",
    "gltf": "_gltf",
    "obj": "_obj",
    "off": "_off",
    "ply": "_ply",
    "stl": "_stl",
}

PathLike: TypeAlias = "str | bytes | os.PathLike[str] | os.PathLike[bytes]"
Readable: TypeAlias = "PathLike | bytearray | memoryview | BinaryIO | File"

# Most numbers of a path: what is longer, or has a zero byte, is the content of a file.
_LONGEST: Final = 4096
# How files begin that say themselves what they are.
_STARTS: Final = {
    b"glTF": "glb",
    b"ply\n": "ply",
    b"ply\r": "ply",
    b"{": "gltf",
    b"OFF": "off",
    b"solid": "stl",
}


@dataclass
class Source:
    """Arrays of a mesh as `NaniteMesh.from_arrays` takes them."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    normals: NDArray[np.float32] | None = None
    colors: NDArray[Any] | None = None
    uvs: list[NDArray[np.float32]] = field(default_factory=list)
    channels: dict[str, NDArray[Any]] = field(default_factory=dict)
    face_materials: NDArray[Any] | None = None
    face_channels: dict[str, NDArray[Any]] = field(default_factory=dict)
    """What else faces carry, (M,) or (M, K) by name."""
    materials: tuple[Material, ...] = ()
    """The look of each number of the face materials, of which the last stands for all from there on."""

    def arrays(self) -> dict[str, Any]:
        """Keyword arguments of `NaniteMesh.from_arrays`."""
        return {
            "vertices": self.vertices,
            "faces": self.faces,
            "normals": self.normals,
            "colors": self.colors,
            "uvs": self.uvs,
            "channels": self.channels,
            "face_materials": self.face_materials,
            "face_channels": self.face_channels,
            "materials": self.materials,
        }


# --------------------------------------------------------------------------------------------------- files


def ending(path: Path) -> tuple[str, bool]:
    """What a file holds by its name, in small letters without the dot, and whether it is packed by gzip."""
    packed = path.suffix.lower() == ".gz"
    return (Path(path.stem) if packed else path).suffix.lower().removeprefix("."), packed


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
        from nanite_rs import _trimesh

        return _trimesh.read(file, drop_bad_textures=drop_bad_textures)
    reader = import_module(f"nanite_rs.{module}")
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

    from nanite_rs import _trimesh

    if not isinstance(mesh, trimesh.Trimesh | trimesh.Scene):
        advice = "; NaniteMesh.from_file reads files" if isinstance(mesh, str | os.PathLike) else ""
        found = type(mesh).__name__
        raise DtypeError(f"mesh: expected trimesh.Trimesh or trimesh.Scene, not {found}{advice}")
    asset = _trimesh.described(mesh, "mesh", drop_bad_textures=True)
    out = flattened(asset)
    asset.notes.warn(asset.name)
    return out


# ------------------------------------------------------------------------------------------------ flattening


def flattened(asset: Asset) -> Source:
    """Put all instances of a description where they stand, into one mesh.

    The materials of all parts are rows of one table, in the order in which parts come; where there is one for all,
    face materials keep the numbers that they have, each part's behind those of the part before.
    """
    parts: list[Part] = []
    for node, number, pose in asset.placed:
        for part in asset.meshes[number]:
            source = _transformed(replace(part.source), pose)
            if has_area(source.vertices, source.faces):
                parts.append(replace(part, source=source))
            else:
                asset.notes.add("nodes flattened to nothing", node)
    if not parts:
        lost = f" ({asset.notes})" if str(asset.notes) else ""
        raise MeshError(f"{asset.name}: there are no triangles in it{lost}")
    table: dict[tuple[Any, ...], int] = {}
    rows = []
    for number, part in enumerate(parts):
        looks, own = _looks(part), part.source.face_materials
        own = np.zeros(len(part.source.faces), np.int64) if own is None else np.asarray(own, np.int64)
        keys: list[tuple[Any, ...]] = [(look,) for look in looks]
        own = np.clip(own, 0, len(looks) - 1) if len(looks) > 1 else own
        if len(looks) == 1 and own.any():
            # Numbers that no looks belong to stay apart.
            values, own = np.unique(own, return_inverse=True)
            keys = [(looks[0], number, value) for value in values.tolist()]
        places = np.array([table.setdefault(key, len(table)) for key in keys], np.int32)
        rows.append(places[own.reshape(-1)])
    several = len({key[0] for key in table}) > 1
    materials = tuple(key[0] for key in table) if several else (next(iter(table))[0],)
    if several:
        for part, row in zip(parts, rows, strict=True):
            part.source.face_materials = row
    elif materials == (Material(),):
        materials = ()  # nothing was said
    out = _concatenated([part.source for part in parts], asset.notes, follow=not several)
    out.materials = materials
    settle(out, asset.notes)
    return out


def settle(source: Source, notes: Notes) -> None:
    """Make of what faces carry what a mesh can hold: labels of moderate variety; the rest is noted."""
    renamed = {
        f"face_{name}" if name in source.channels else name: v for name, v in source.face_channels.items()
    }
    labels = {name: as_labels(name, values) for name, values in renamed.items()}
    labels, blended = _face_data.without_floats(source.vertices, source.faces, labels)
    for name, values in blended.items():
        notes.add("floating-point data of faces, averaged to vertices", name)
        source.channels[name] = values
    own = np.zeros(len(source.faces), np.int64) if source.face_materials is None else source.face_materials
    kept: dict[str, NDArray[Any]] = {}
    for name in sorted(labels, key=lambda name: len(np.unique(labels[name], axis=0))):
        if _face_data.combinations([own, *kept.values(), labels[name]])[1] <= _face_data.MOST:
            kept[name] = labels[name]
        else:
            notes.add("data of faces that differ too much to be kept apart", name)
    source.face_channels = {name: labels[name] for name in labels if name in kept}


def _looks(part: Part) -> list[Material]:
    return [part.material] if isinstance(part.material, Material) else list(part.material)


def _transformed(source: Source, transform: NDArray[np.float64]) -> Source:
    if np.array_equal(transform, np.eye(4)):
        return source
    linear = transform[:3, :3]
    source.vertices = source.vertices @ linear.T + transform[:3, 3]
    determinant = np.linalg.det(linear)
    if determinant < 0.0:
        source.faces = source.faces[:, ::-1]
    if source.normals is not None:
        # The cofactor matrix is det · inverse transpose, and exists for flattened parts too.
        rows = [np.cross(linear[(k + 1) % 3], linear[(k + 2) % 3]) for k in range(3)]
        cofactor = np.array(rows) * (-1.0 if determinant < 0.0 else 1.0)
        source.normals = (source.normals @ cofactor.T).astype(np.float32)
    return source


def _concatenated(parts: list[Source], notes: Notes, *, follow: bool) -> Source:
    """Join parts; with ``follow`` the face materials of each follow those of the part before."""
    if len(parts) == 1:
        return parts[0]
    counts = [len(part.vertices) for part in parts]
    offsets = np.concatenate([[0], np.cumsum(counts)[:-1]])
    out = Source(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + offset for part, offset in zip(parts, offsets, strict=True)]),
    )

    def joined(rows: Iterable[NDArray[Any] | None], missing: NDArray[Any]) -> NDArray[Any] | None:
        """Rows of all parts, with a constant where a part has none; None when no part has any."""
        rows = list(rows)
        if all(row is None for row in rows):
            return None
        filled = (
            np.broadcast_to(missing, (count, len(missing))) if row is None else row
            for row, count in zip(rows, counts, strict=True)
        )
        return np.concatenate(list(filled))

    # A zero normal asks the build to compute it; a part without colour is white.
    out.normals = joined((part.normals for part in parts), np.zeros(3, np.float32))
    colors = _colors.alike([part.colors for part in parts])
    kind = next((part.dtype for part in colors if part is not None), np.dtype(np.uint8))
    out.colors = joined(colors, np.full(4, _colors.white(kind), kind))
    for number in range(max(len(part.uvs) for part in parts)):
        sets = joined(
            (part.uvs[number] if number < len(part.uvs) else None for part in parts), np.zeros(2, np.float32)
        )
        if sets is not None:
            out.uvs.append(sets)
    if any(part.face_materials is not None for part in parts):
        first, numbers = 0, []
        for part in parts:
            own = part.face_materials
            own = np.zeros(len(part.faces), np.int64) if own is None else own.astype(np.int64)
            numbers.append(own + first)
            first = max(first, int(numbers[-1].max()) + 1) if follow else 0
        out.face_materials = np.concatenate(numbers)
    out.channels = _joined_channels([part.channels for part in parts], counts, notes)
    out.face_channels = _joined_channels(
        [part.face_channels for part in parts], [len(part.faces) for part in parts], notes
    )
    return out


def _joined_channels(
    parts: list[dict[str, NDArray[Any]]], counts: list[int], notes: Notes
) -> dict[str, NDArray[Any]]:
    """Channels by name, with zeros where a part has none, or one of another width than the first that has one."""
    out = {}
    for name in {name: None for part in parts for name in part}:
        known = [part[name] for part in parts if name in part]
        shape = known[0].shape[1:]
        fitting = [array for array in known if array.shape[1:] == shape]
        if len(fitting) < len(known):
            notes.add("channels of parts where they have another width than elsewhere", name)
        missing = np.zeros(shape, np.result_type(*fitting))
        rows = [
            part[name]
            if name in part and part[name].shape[1:] == shape
            else np.broadcast_to(missing, (count, *shape))
            for part, count in zip(parts, counts, strict=True)
        ]
        out[name] = np.concatenate(rows).astype(missing.dtype, copy=False)
    return out
