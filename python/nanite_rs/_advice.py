"""What to do about plausible mistakes: looked for where something looks like one."""

from __future__ import annotations

import difflib
import functools
import inspect
import os
import re
import sys
import warnings
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from nanite_rs.exceptions import DependencyError, FileError, NaniteError

E = TypeVar("E", bound=NaniteError)
F = TypeVar("F", bound=Callable[..., Any])
T = TypeVar("T")

# Modules whose lines no warning names: this package, and modules that call its properties.
_INNER = {"nanite_rs", "functools"}

_ONE_LEVEL = "a mesh holds all levels of detail; of one of them, cut = mesh.cut(error=0) gives cut.{}"
_AS_IMAGE = "PIL.Image.fromarray(frame.color)"
_ADD = "scene.add(mesh, pose=pose) adds meshes and lights"
# Names of other packages for attributes that are elsewhere here, by type.
_ELSEWHERE = {
    "NaniteMesh": {
        **{name: _ONE_LEVEL.format(name) for name in ("vertices", "faces", "normals", "colors", "uvs")},
        **dict.fromkeys(("points", "verts"), _ONE_LEVEL.format("vertices")),
        "triangles": _ONE_LEVEL.format("faces"),
        **{
            f"to_{name}": _ONE_LEVEL.format(f"to_{name}()")
            for name in ("trimesh", "pyvista", "open3d", "meshio")
        },
        **dict.fromkeys(("simplify", "decimate"), "mesh.cut(target_reduction=0.9) removes 90 %"),
        **dict.fromkeys(("show", "view", "plot"), "nanite_rs.view(mesh) opens it in a window or a notebook"),
        **dict.fromkeys(("extents", "center", "centroid", "box"), "mesh.bounds has the corners of its box"),
        "levels": "mesh.report.levels says what each has",
    },
    "TriangleMesh": {
        **dict.fromkeys(
            ("simplify", "decimate", "levels", "check", "report", "save"),
            "it has no levels of detail; NaniteMesh.from_arrays(mesh.vertices, mesh.faces) builds them",
        ),
        **dict.fromkeys(("export", "to_trimesh"), "mesh.cut(error=0) has export(path) and to_trimesh()"),
        **dict.fromkeys(("points", "verts"), "these are mesh.vertices"),
        "triangles": "these are mesh.faces",
        **dict.fromkeys(("show", "view", "plot"), "nanite_rs.view(mesh) opens it in a window or a notebook"),
        **dict.fromkeys(("move", "set_vertices", "deform"), "mesh.update(vertices) moves them"),
        **dict.fromkeys(("extents", "center", "centroid", "box"), "mesh.bounds has the corners of its box"),
    },
    "Points": {
        **dict.fromkeys(("points", "vertices", "verts"), "these are points.positions"),
        **dict.fromkeys(("size", "point_size"), "points.radius is half of it"),
        **dict.fromkeys(("color", "vertex_colors"), "these are points.colors"),
        **dict.fromkeys(("move", "set_positions"), "points.update(positions) moves them"),
        **dict.fromkeys(
            ("show", "view", "plot"), "nanite_rs.view(points) opens it in a window or a notebook"
        ),
    },
    "Lines": {
        **dict.fromkeys(("points", "vertices", "verts"), "these are lines.positions"),
        **dict.fromkeys(("edges", "indices", "lines"), "these are lines.segments"),
        **dict.fromkeys(("color", "vertex_colors"), "these are lines.colors"),
        **dict.fromkeys(("move", "set_positions"), "lines.update(positions) moves them"),
        **dict.fromkeys(("show", "view", "plot"), "nanite_rs.view(lines) opens it in a window or a notebook"),
    },
    "Cut": {
        "save": "cut.export(path) writes it",
        "show": "cut.to_trimesh().show() opens it",
        **dict.fromkeys(("points", "verts"), "these are cut.vertices"),
        "triangles": "these are cut.faces",
        "vertex_normals": "these are cut.normals",
        **dict.fromkeys(("mesh", "trimesh"), "cut.to_trimesh() makes one"),
    },
    "Frame": {
        **dict.fromkeys(("image", "rgb", "pixels"), "that is frame.color"),
        "show": f"{_AS_IMAGE}.show(), or plt.imshow(frame.color)",
        **dict.fromkeys(("to_pil", "to_image"), _AS_IMAGE),
        "mask": "frame.depth > 0 says where a mesh is",
    },
    "Scene": {
        **dict.fromkeys(("add_node", "add_mesh", "add_light", "add_geometry"), _ADD),
        **dict.fromkeys(("show", "view"), "nanite_rs.view(scene) opens it in a window or a notebook"),
    },
    "Renderer": {"delete": "renderer.close()"},
    "nanite_rs": {
        **dict.fromkeys(
            ("load", "open", "read", "load_mesh"),
            "NaniteMesh.from_file(path) builds a mesh of a file, NaniteMesh.open(path) opens a .nanite file",
        ),
        **dict.fromkeys(
            ("Mesh", "build"), "NaniteMesh.from_arrays(vertices, faces), from_trimesh and from_file"
        ),
        "simplify_mesh": "decimate(mesh, target_reduction=0.9)",
        "OffscreenRenderer": "Renderer(width, height)",
        "Node": "scene.add(mesh, pose=pose) returns one",
    },
}


def absent(owner: object, name: str) -> AttributeError:
    """Return the error of a name that is not there, with where to look instead."""
    kind = owner if isinstance(owner, str) else type(owner).__name__
    what = f"module {kind!r}" if isinstance(owner, str) else f"{kind!r} object"
    advice = _ELSEWHERE.get(kind, {}).get(name, "")
    message = f"{what} has no attribute {name!r}{'; ' if advice else ''}{advice}"
    return (
        AttributeError(message) if isinstance(owner, str) else AttributeError(message, name=name, obj=owner)
    )


class Teaching:
    """A base of classes whose absent attributes are errors with advice."""

    __slots__ = ()

    if not TYPE_CHECKING:  # for checkers an absent attribute is one

        def __getattr__(self, name: str) -> Any:
            raise absent(self, name)


def _like(name: str, known: list[str]) -> str:
    """Return the name that is most like another, including spellings of glTF such as ``baseColorFactor``."""
    snake = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower().removesuffix("_factor")
    return " or ".join(
        f"{near}=" for near in difflib.get_close_matches(snake, known, 1 if snake in known else 3)
    )


def teaches(*, otherwise: str = "", **keywords: str) -> Callable[[F], F]:
    """Decorate what says more than Python does where arguments do not fit: of a keyword, or ``otherwise``."""

    def decorate(function: F) -> F:
        @functools.wraps(function)
        def call(*arguments: Any, **named: Any) -> Any:
            try:
                return function(*arguments, **named)
            except TypeError as error:
                # What comes from inside the function has a line there.
                if error.__traceback__ is None or error.__traceback__.tb_next is not None:
                    raise
                found = re.search(r"keyword argument '(\w+)'", str(error))
                advice = otherwise
                if found:
                    like = _like(found[1], list(inspect.signature(function).parameters))
                    advice = keywords.get(found[1], f"did you mean {like}?" if like else otherwise)
                message = f"{error}; {advice}" if advice else str(error)
            raise TypeError(message)

        return call  # type: ignore[return-value]

    return decorate


def teaching(kind: type[T]) -> type[T]:
    """Decorate a dataclass that does so."""
    kind.__init__ = teaches()(kind.__init__)  # type: ignore[method-assign]
    return kind


def warn(message: str, category: type[Warning]) -> None:
    """Warn, at the line outside of this package that led here."""
    frame, level = sys._getframe(1), 2
    while frame.f_back and frame.f_globals.get("__name__", "").split(".")[0] in _INNER:
        frame, level = frame.f_back, level + 1
    warnings.warn(message, category, stacklevel=level)


def advised(error: E, advice: str) -> E:
    """Return the error with advice behind its message."""
    if not advice:
        return error
    if isinstance(error, FileError):
        return type(error)(error.errno, f"{error.strerror}; {advice}", error.filename)
    return type(error)(f"{error}; {advice}")


# Packages whose distributions have another name.
_DISTRIBUTIONS = {"collada": "pycollada", "distributed": "'nanite_rs[dask]'", "usd-core": "'nanite_rs[usd]'"}


def missing(what: str, package: str, otherwise: str = "") -> DependencyError:
    """Return the error of an optional package that ``what`` needs."""
    advice = f"pip install {_DISTRIBUTIONS.get(package, package)}{otherwise}"
    return DependencyError(f"{what}: {package} is needed; {advice}", name=package)


# What to do about a texture that cannot be read.
WITHOUT_TEXTURE = 'load_scene(..., bad_textures="drop") goes on without it'


def name_of_type(value: object) -> str:
    """Return the name of a type with its package, where that is another one: ``trimesh.Scene``."""
    kind = type(value)
    package = kind.__module__.split(".")[0]
    return kind.__name__ if package in ("builtins", "nanite_rs", "numpy") else f"{package}.{kind.__name__}"


def near(error: E) -> E:
    """Suggest the nearest of the quoted names of a message that ends in ``not "name"``."""
    *allowed, found = re.findall(r'"([^"]*)"', str(error)) or [""]
    if not allowed or not str(error).endswith(f'not "{found}"'):
        return error
    names = {name.lower(): name for name in allowed}
    best = difflib.get_close_matches(found.lower(), list(names), 1)
    return advised(error, f'did you mean "{names[best[0]]}"?' if best else "")


def is_of_bytes(color: tuple[float, ...]) -> bool:
    """Whether a colour looks like one of 0 to 255. Light may exceed 1, but seldom by so much in whole numbers."""
    return 16 < max(color) <= 255 and all(x.is_integer() for x in color)


def for_item(item: object) -> str:
    """How to get a mesh, or whatever a scene takes, of something else."""
    name = name_of_type(item)
    if isinstance(item, str | os.PathLike):
        return "NaniteMesh.from_file reads files"
    if isinstance(item, tuple) and item and name_of_type(item[0]) == "Scene":
        return "of what load_scene and from_pyrender return: renderer.render(*loaded)"
    if name == "trimesh.Trimesh":
        return "NaniteMesh.from_trimesh builds one of it"
    if name == "trimesh.Scene":
        return "load_scene takes it over"
    if name.startswith("pyrender."):
        return "from_pyrender takes over a pyrender.Scene"
    return {
        "NaniteMesh": "put it into a scene: scene.add(mesh)",
        "Cut": "add the mesh itself, a renderer cuts by itself; or NaniteMesh.from_trimesh(cut.to_trimesh())",
        "tuple": "TriangleMesh(vertices, faces) makes a mesh of arrays, NaniteMesh.from_arrays builds one",
        "list": "add one after the other",
        "type": "make one of it first, with ()",
        "Environment": "assign it: scene.environment = environment",
        "PerspectiveCamera": "cameras go to renderer.render(scene, camera, pose)",
        "IntrinsicsCamera": "cameras go to renderer.render(scene, camera, pose)",
        "OrthographicCamera": "cameras go to renderer.render(scene, camera, pose)",
    }.get(name, "")


def for_texture(value: object) -> str:
    """How to make a texture of something else."""
    if isinstance(value, str | os.PathLike):
        return f"give nanite_rs.Texture({os.fspath(value)!r})"
    return (
        "give nanite_rs.Texture(image)"
        if isinstance(value, np.ndarray) or name_of_type(value) == "Image"
        else ""
    )


def for_pose(pose: object) -> str:
    """What is wrong with a matrix that was refused as a pose."""
    try:
        array = np.asarray(pose, np.float64)
    except (TypeError, ValueError):
        return "give one matrix: pose = np.eye(4); pose[:3, :3] = rotation; pose[:3, 3] = translation"
    if array.shape == (3, 4):
        return "give np.vstack([pose, [0, 0, 0, 1]])"
    if array.shape in {(3,), ()}:
        return "for a translation: pose = np.eye(4); pose[:3, 3] = translation"
    if array.shape == (4, 4) and not array[:3, 3].any() and array[3, 3] == 1.0 and array[3, :3].any():
        return "the translation is in the last row: the matrix is transposed, give pose.T"
    if array.shape == (4, 4) and np.isfinite(array).all() and np.linalg.det(array[:3, :3]):
        lengths = np.linalg.norm(array[:3, :3], axis=0)
        straight = array[:3, :3] / lengths
        if np.abs(straight.T @ straight - np.eye(3)).max() < 0.01:
            return (
                f"its columns are {', '.join(f'{x:.4g}' for x in lengths)} long: divide pose[:3, :3] by these"
            )
        return (
            "its columns are not at right angles; the nearest rotation is u @ vt of "
            "u, _, vt = np.linalg.svd(pose[:3, :3])"
        )
    return ""


# Largest deviation of a pose from a rotation without a warning: poses in single precision deviate less.
_ROUNDED = 1e-4


def of_rounded_pose(off: float) -> str:
    """What to say of a pose that is off a rotation, if it is worth saying."""
    if off <= _ROUNDED:
        return ""
    return f"pose: it is off a rotation by {off:.1g}; the nearest rotation is taken"


def for_arrays(message: str, vertices: Any, faces: Any, given: dict[str, Any]) -> str:
    """What is wrong with arrays that were refused; ``given`` holds those beside vertices and faces."""
    name = re.split(r"[:\[ ]", message)[0]
    rows = {"vertices": vertices, "faces": faces, **given}
    value = rows.get(name)
    array = value if isinstance(value, np.ndarray) else np.empty(0)
    if name in ("vertices", "faces") and array.dtype.kind in "OU" and array.ndim == 0:
        return for_item(array.item())
    if "expected shape" in message:
        return _shape(name, array)
    if name in ("vertices", "normals") and "finite" in message:
        return f"leave out such rows, and the faces that use them: np.isfinite({name}).all(axis=1)"
    if name == "vertices" and array.dtype.kind in "iu":
        swapped = isinstance(faces, np.ndarray) and faces.dtype.kind == "f"
        return "are vertices and faces swapped?" if swapped else "give vertices.astype(np.float32)"
    if name == "faces" and array.dtype.kind == "f":
        return "give faces.astype(np.int64)"
    if name == "faces" and "refers to" in message and array.size:
        return _out_of_range(array, len(vertices))
    if name == "colors":
        if "between 0 and 1" in message:
            return "of 0 to 255, give colors / 255 or colors.astype(np.uint8)"
        if "dtype" in message:
            return "give colors.astype(np.uint8)"
    found = re.search(r"each of the (\d+) (vertices|faces), found (\d+)", message)
    if found and found[2] == "vertices" and int(found[3]) == len(faces):
        return "that is one for each face: give each face vertices of its own, vertices[faces.ravel()]"
    if found and found[2] == "faces" and int(found[3]) == len(vertices):
        return f"that is one for each vertex: give {name}[faces[:, 0]]"
    return ""


def _out_of_range(faces: Any, vertices: int) -> str:
    if faces.min() == 1 and faces.max() == vertices:
        return "they count from 1, and have to from 0: give faces - 1"
    if faces.min() < 0:
        return "where that marks an empty place, leave such rows out: faces[(faces >= 0).all(axis=1)]"
    return ""


def for_rows(name: str, rows: object) -> str:
    """Which of some rows, of which no array could be made, is of another length than most."""
    if not isinstance(rows, list | tuple) or not rows:
        return ""
    lengths = [len(row) if hasattr(row, "__len__") else 0 for row in rows]
    usual = max(set(lengths), key=lengths.count)
    other = next((i for i, length in enumerate(lengths) if length != usual), None)
    return "" if other is None else f"{name}[{other}] has {lengths[other]} numbers and not {usual}"


def _shape(name: str, array: Any) -> str:
    columns = 2 if name == "uvs" else 3
    if not array.size:
        return "there is nothing in it"
    if name == "faces" and array.ndim == 1 and array.size and not array.size % 4 and (array[::4] == 3).all():
        return "of PyVista, give faces.reshape(-1, 4)[:, 1:]"
    if name == "faces" and array.ndim == 2 and array.shape[1] == 4:
        if (array[:, 0] == 3).all():
            return "of PyVista, give faces[:, 1:]"
        return "split quads: np.concatenate([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]])"
    if array.ndim == 2 and array.shape[0] == columns:
        return f"transposed, give {name}.T"
    if array.ndim == 1 and array.size and not array.size % columns:
        return f"give {name}.reshape(-1, {columns})"
    if array.ndim == 2 and array.shape[1] > columns:
        return f"give {name}[:, :{columns}]"
    return ""


def for_file(path: object) -> str:
    """What a file is that is no ``.nanite`` file."""
    name = os.fsdecode(path)  # type: ignore[arg-type]
    try:
        with open(name, "rb") as file:
            start = file.read(64)
    except OSError:
        return ""
    if start.startswith(b"version https://git-lfs"):
        return "it is a pointer of Git LFS: git lfs pull fetches the file"
    suffix = os.path.splitext(name)[1].lower()
    if suffix != ".nanite" and not start.startswith(b"NANITE"):
        return f"of a mesh in another format, NaniteMesh.from_file builds one ({suffix or 'no ending'})"
    if start and all(byte in b"\t\r\n" or 32 <= byte < 127 for byte in start):
        return f"it is text, which begins {start[:24].decode()!r}: write it with mesh.save(path)"
    return "write it with mesh.save(path)"
