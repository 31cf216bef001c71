"""Meshes in and out of files and trimesh objects."""

from __future__ import annotations

import errno
import gzip
import json
import os
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from nanite_rs import _advice
from nanite_rs.exceptions import (
    ArgumentError,
    DtypeError,
    FileError,
    FormatError,
    MeshError,
    MissingFileError,
    NaniteError,
)

if TYPE_CHECKING:
    from collections.abc import Iterable

    import trimesh
    from numpy.typing import NDArray

__all__ = ["Source", "from_trimesh", "load"]

#: Suffix of built meshes.
NANITE_SUFFIX: Final = ".nanite"
#: Endings of glTF.
GLTF: Final = ("glb", "gltf")
#: Formats with a module of their own here, by endings.
READERS: Final = {"ply": "_ply", "stl": "_stl", "obj": "_obj", "off": "_off"}


@dataclass
class Source:
    """Arrays of a mesh as `NaniteMesh.from_arrays` takes them."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    normals: NDArray[np.float32] | None = None
    colors: NDArray[np.uint8] | None = None
    uvs: list[NDArray[np.float32]] = field(default_factory=list)
    channels: dict[str, NDArray[Any]] = field(default_factory=dict)
    face_materials: NDArray[Any] | None = None
    face_channels: dict[str, NDArray[Any]] = field(default_factory=dict)
    """What else faces carry, (M,) or (M, K) by name."""

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
        }


def ending(path: Path) -> tuple[str, bool]:
    """What a file holds by its name, in small letters without the dot, and whether it is packed by gzip."""
    packed = path.suffix.lower() == ".gz"
    return (Path(path.stem) if packed else path).suffix.lower().removeprefix("."), packed


def from_file(path: str | os.PathLike[str]) -> Source:
    """Read a file as one mesh of all its parts, with a warning that names what was left out."""
    if ending(Path(path))[0] not in READERS:
        return from_trimesh(load(path))
    from nanite_rs import assets

    asset = assets.read_asset(Path(path), drop_bad_textures=True)
    parts = [part.source for _, number, _ in asset.placed for part in asset.meshes[number]]
    if not parts:
        raise MeshError(f"{asset.name}: there are no triangles in it ({asset.notes})")
    asset.notes.warn(asset.name, stacklevel=3)
    return _concatenated(parts)


def load(path: str | os.PathLike[str]) -> trimesh.Trimesh | trimesh.Scene:
    """Read a mesh file with trimesh, unprocessed, so that vertices stay as they are stored.

    Parameters
    ----------
    path : path
        Any format that trimesh reads; ``.gz`` is unpacked on the way.

    Raises
    ------
    MissingFileError, FileError, FormatError, DependencyError
        Each names the file.
    """
    import trimesh

    path = Path(path)
    suffix, packed = ending(path)
    known = sorted(trimesh.available_formats())
    if path.is_dir():
        raise FileError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not path.exists():
        raise MissingFileError(errno.ENOENT, os.strerror(errno.ENOENT), str(path))
    if suffix not in known:
        found = f"extension .{suffix} is unknown" if suffix else "the name has no extension"
        raise FormatError(f"{path}: {found}; trimesh reads {', '.join(known)}")
    try:
        content = path.read_bytes() if packed or suffix in GLTF else b""
        if packed:
            content = gzip.decompress(content)
        if suffix in GLTF:
            _check_gltf(path, content)
        source = BytesIO(content) if packed else path
        loaded = trimesh.load(source, file_type=suffix if packed else None, process=False)
    except NaniteError:
        raise
    except ImportError as error:
        raise _advice.missing(str(path), error.name or "an optional package") from error
    except OSError as error:
        if isinstance(error, gzip.BadGzipFile) or error.errno is None:
            raise FormatError(f"{path}: cannot be read as .{suffix}: {error}") from error
        raise FileError(error.errno, error.strerror, str(path)) from error
    except Exception as error:  # whatever a loader trips over in a damaged file
        message = f"{type(error).__name__}: {error}"
        raise FormatError(f"{path}: cannot be read as .{suffix}: {message}") from error
    _refuse_empty(path, loaded)
    return loaded


def _refuse_empty(path: Path, loaded: object) -> None:
    """Loaders return point clouds, paths or nothing where there is no triangle; say so with the file's name."""
    import trimesh

    if isinstance(loaded, trimesh.Scene):
        loaded = list(loaded.geometry.values())
    parts = loaded if isinstance(loaded, list) else [loaded]
    if not any(isinstance(part, trimesh.Trimesh) and len(part.faces) for part in parts):
        kinds = ", ".join(sorted({type(part).__name__ for part in parts}))
        raise MeshError(f"{path}: there are no triangles in it" + (f", only {kinds}" if kinds else ""))


def _check_gltf(path: Path, data: bytes) -> None:
    """Refuse compressed glTF that trimesh would read as zeros: it only logs what it cannot decode."""
    try:
        if data[:4] == b"glTF":
            data = data[20 : 20 + int.from_bytes(data[12:16], "little")]
        required = set(json.loads(data).get("extensionsRequired", []))
    except (ValueError, AttributeError):
        return  # not glTF at all: the loader says so
    if "KHR_draco_mesh_compression" in required:
        try:
            import DracoPy  # noqa: F401
        except ImportError as error:
            raise _advice.missing(str(path), "DracoPy") from error
    undecoded = sorted(name for name in required if "compression" in name and "draco" not in name)
    if undecoded:
        raise FormatError(
            f"{path}: it requires {', '.join(undecoded)}, which trimesh does not decode; load_scene reads it"
        )


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

    if isinstance(mesh, trimesh.Trimesh):
        return _single(mesh)
    if not isinstance(mesh, trimesh.Scene):
        advice = "; NaniteMesh.from_file reads files" if isinstance(mesh, str | os.PathLike) else ""
        found = type(mesh).__name__
        raise DtypeError(f"mesh: expected trimesh.Trimesh or trimesh.Scene, not {found}{advice}")
    parts = []
    for node in mesh.graph.nodes_geometry:
        transform, name = mesh.graph[node]
        geometry = mesh.geometry[name]
        if isinstance(geometry, trimesh.Trimesh) and len(geometry.faces):
            parts.append(_transformed(_single(geometry), np.asarray(transform, np.float64)))
    if not parts:
        raise MeshError("mesh: the scene has no triangles")
    return _concatenated(parts)


def _single(mesh: trimesh.Trimesh) -> Source:
    source = Source(np.asarray(mesh.vertices), np.asarray(mesh.faces))
    # Normals that came with the file lie in the cache; asking for `vertex_normals` would compute missing ones.
    stored = mesh._cache.cache.get("vertex_normals")
    if stored is not None and np.shape(stored) == np.shape(source.vertices):
        source.normals = np.asarray(stored, np.float32)
    source.channels = _channels(mesh)
    source.face_materials = _face_materials(mesh)
    visual = mesh.visual
    if visual is None or not visual.defined:
        return source
    if visual.kind == "vertex":
        source.colors = np.asarray(visual.vertex_colors, np.uint8)
    elif visual.kind == "face":
        # One colour per face: every face gets vertices of its own. Equal ones are welded again by the build.
        corners = source.faces.reshape(-1)
        source.vertices = source.vertices[corners]
        if source.normals is not None:
            source.normals = source.normals[corners]
        source.channels = {name: values[corners] for name, values in source.channels.items()}
        source.colors = np.repeat(np.asarray(visual.face_colors, np.uint8), 3, axis=0)
        source.faces = np.arange(len(corners)).reshape(-1, 3)
    elif visual.kind == "texture" and getattr(visual, "uv", None) is not None:
        if len(visual.uv) == len(source.vertices):
            source.uvs = [np.asarray(visual.uv, np.float32)]
        attribute = getattr(visual, "vertex_attributes", {}).get("color")
        if attribute is not None and np.shape(attribute)[0] == len(source.vertices):
            source.colors = _as_rgba(np.asarray(attribute))
    return source


def _channels(mesh: trimesh.Trimesh) -> dict[str, NDArray[Any]]:
    """The vertex attributes that can be channels: a number or a row of numbers for each vertex."""
    channels = {}
    for name, values in mesh.vertex_attributes.items():
        array = np.asarray(values)
        rows = array.ndim in (1, 2) and len(array) == len(mesh.vertices)
        if rows and array.size and array.dtype.kind in "fiub":
            channels[str(name)] = array
    return channels


def _face_materials(mesh: trimesh.Trimesh) -> NDArray[Any] | None:
    """Face materials of a texture with several materials, or the face attribute that `Cut.to_trimesh` makes."""
    found = getattr(mesh.visual, "face_materials", None)
    if found is None:
        found = mesh.face_attributes.get("face_materials")
    array = np.asarray([] if found is None else found)
    return array if array.shape == (len(mesh.faces),) and array.dtype.kind in "iu" else None


def _as_rgba(colors: NDArray[Any]) -> NDArray[np.uint8]:
    if colors.dtype.kind == "f":
        colors = np.rint(np.clip(colors, 0.0, 1.0) * 255.0).astype(np.uint8)
    rgba = np.full((len(colors), 4), 255, np.uint8)
    rgba[:, : min(colors.shape[1], 4)] = colors[:, :4]
    return rgba


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


def _concatenated(parts: list[Source]) -> Source:
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
    out.colors = joined((part.colors for part in parts), np.full(4, 255, np.uint8))
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
            first = max(first, int(numbers[-1].max()) + 1)
        out.face_materials = np.concatenate(numbers)
    for name in {name: None for part in parts for name in part.channels}:
        known = [part.channels[name] for part in parts if name in part.channels]
        if len({array.shape[1:] for array in known}) > 1:
            raise ArgumentError(
                f"mesh: vertex attribute {name!r} has another width in other parts of the scene"
            )
        # A part without it has zeros.
        missing = np.zeros(known[0].shape[1:], np.result_type(*known))
        out.channels[name] = np.concatenate(
            [
                part.channels.get(name, np.broadcast_to(missing, (count, *missing.shape)))
                for part, count in zip(parts, counts, strict=True)
            ]
        )
    return out
