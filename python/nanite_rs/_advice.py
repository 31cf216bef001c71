"""What to do about plausible mistakes: looked for where something looks like one."""

from __future__ import annotations

import difflib
import os
import re
from typing import Any, TypeVar

import numpy as np

from nanite_rs.exceptions import NaniteError

E = TypeVar("E", bound=NaniteError)


def advised(error: E, advice: str) -> E:
    """Return the error with advice behind its message."""
    return type(error)(f"{error}; {advice}") if advice else error


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
    if name == "trimesh.Trimesh":
        return "NaniteMesh.from_trimesh builds one of it"
    if name == "trimesh.Scene":
        return "load_scene takes it over"
    if name.startswith("pyrender."):
        return "from_pyrender takes over a pyrender.Scene"
    return {
        "NaniteMesh": "put it into a scene: scene.add(mesh)",
        "Cut": "add the mesh itself, a renderer cuts by itself; or NaniteMesh.from_trimesh(cut.to_trimesh())",
        "tuple": "NaniteMesh.from_arrays(vertices, faces) builds one of arrays",
        "list": "add one after the other",
        "type": "make one of it first, with ()",
        "Environment": "assign it: scene.environment = environment",
        "PerspectiveCamera": "cameras go to renderer.render(scene, camera, pose)",
        "IntrinsicsCamera": "cameras go to renderer.render(scene, camera, pose)",
        "OrthographicCamera": "cameras go to renderer.render(scene, camera, pose)",
    }.get(name, "")


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
        return f"its columns are {', '.join(f'{x:.4g}' for x in lengths)} long: divide pose[:3, :3] by these"
    return ""


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
        one_based = array.min() == 1 and array.max() == len(vertices)
        return "they count from 1, and have to from 0: give faces - 1" if one_based else ""
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


def _shape(name: str, array: Any) -> str:
    columns = 2 if name == "uvs" else 3
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
