"""Arrays of a mesh as callers give them, made into what the core takes: dtypes, shapes and ranges are checked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from nanite_rs import _advice, _channels, _colors, _face_data
from nanite_rs.exceptions import ArgumentError, DtypeError, UsageWarning

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray


def as_array(value: object, name: str) -> NDArray[Any]:
    """An array of what is one already; lists become float64 or integers."""
    try:
        array = np.asarray(value)
    except ValueError as error:
        wrong = ArgumentError(f"{name}: {error}")
        raise _advice.advised(wrong, _advice.for_rows(name, value)) from None
    if not isinstance(value, np.ndarray) and name != "faces" and array.dtype.kind in "iu":
        array = array.astype(np.float64)
    return array


def own_copy(array: NDArray[Any]) -> NDArray[Any]:
    """A copy that nobody can change."""
    own = array.copy()
    own.flags.writeable = False
    return own


def core_arrays(
    vertices: NDArray[Any],
    faces: NDArray[Any],
    given: Mapping[str, Any],
    channels: Mapping[str, ArrayLike] | None,
) -> dict[str, Any]:
    """The arrays of a mesh as the core takes them."""
    normals, colors, face_materials = given["normals"], given["colors"], given["face_materials"]
    labels: dict[str, NDArray[Any]] = {}
    if given.get("face_channels"):
        of_faces = _face_data.checked(given["face_channels"], len(faces) if faces.ndim else 0)
        for name in of_faces:
            if name in (channels or ()):
                raise ArgumentError(f"face_channels[{name!r}]: channels has one of that name")
        if _are_rows(vertices, faces):
            labels, blended = _face_data.without_floats(vertices, faces, of_faces)
            _face_data.warn_of_floats(blended)
            channels = {**(channels or {}), **blended}
    arrays = {
        "vertices": vertices,
        "faces": faces,
        "normals": None if normals is None else vertex_floats(normals, "normals"),
        "colors": None if colors is None else _rgba(colors),
        "uvs": _uv_sets(given["uvs"]),
        "face_materials": None if face_materials is None else _materials(face_materials),
        "channels": _channels.pack(channels, len(vertices) if vertices.ndim else 0),
    }
    return _apart(arrays, labels) if labels else arrays


def vertex_floats(value: object, name: str) -> NDArray[np.float32]:
    array = as_array(value, name)
    if array.dtype.kind != "f":
        raise DtypeError(f"{name}: expected a floating-point dtype, not {array.dtype}")
    return array.astype(np.float32, copy=False)


def _rgba(value: object) -> NDArray[Any]:
    """Colours as (N, 4) from uint8, uint16 or floats of 0 to 1, with or without alpha."""
    array = as_array(value, "colors")
    if array.ndim != 2 or array.shape[1] not in (3, 4):
        raise ArgumentError(f"colors: expected shape (N, 3) or (N, 4), found {array.shape}")
    if array.dtype.kind == "f":
        if not np.isfinite(array).all() or array.min(initial=0.0) < 0.0 or array.max(initial=0.0) > 1.0:
            raise ArgumentError("colors: floating-point colours must lie between 0 and 1")
        array = array.astype(np.float32)
    elif array.dtype == np.uint8:
        if len(array) and array.max() == 1:
            _advice.warn(
                "colors: uint8 of 0 and 1 are next to black: give colors * 255, or floats of 0 to 1",
                UsageWarning,
            )
    elif array.dtype == np.uint16:
        if len(array) and 0 < array.max() <= 255:
            _advice.warn(
                "colors: uint16 of 0 to 255 are next to black: give colors.astype(np.uint8)", UsageWarning
            )
    else:
        raise DtypeError(f"colors: expected uint8, uint16 or a floating-point dtype, not {array.dtype}")
    return _colors.opaque(array)


def _uv_sets(value: object) -> list[NDArray[np.float32]]:
    """UV sets as a list from one (N, 2) array or a sequence of them."""
    if value is None:
        return []
    if isinstance(value, np.ndarray) and value.ndim == 2:
        return [vertex_floats(value, "uvs")]
    if not isinstance(value, Sequence | np.ndarray):
        raise DtypeError(f"uvs: expected an (N, 2) array or a sequence of them, not {type(value).__name__}")
    return [vertex_floats(item, "uvs") for item in value]


def _materials(value: object) -> NDArray[np.int32]:
    array = np.asarray(value)
    if array.dtype.kind not in "iu":
        raise DtypeError(f"face_materials: expected an integer dtype, not {array.dtype}")
    if array.ndim != 1:
        raise ArgumentError(f"face_materials: expected shape (M,), found {array.shape}")
    limits = np.iinfo(np.int32)
    outside = np.flatnonzero((array < limits.min) | (array > limits.max))
    if len(outside):
        raise ArgumentError(
            f"face_materials[{outside[0]}]: {array[outside[0]]} is not between {limits.min} and {limits.max}"
        )
    return np.ascontiguousarray(array, np.int32)


def _are_rows(vertices: NDArray[Any], faces: NDArray[Any]) -> bool:
    """Whether faces refer to vertices. Where they do not, the core raises the error."""
    shaped = vertices.ndim == 2 and vertices.shape[1] == 3 and faces.ndim == 2 and faces.shape[1] == 3
    if not shaped or faces.dtype.kind not in "iu" or not faces.size:
        return False
    return bool(faces.min() >= 0 and faces.max() < len(vertices))


def _apart(arrays: dict[str, Any], labels: dict[str, NDArray[Any]]) -> dict[str, Any]:
    """Arrays of the core in which every vertex has the labels of its faces."""
    numbers = arrays["face_materials"]
    if numbers is not None and len(numbers) != len(arrays["faces"]):
        return arrays  # which the core refuses
    copied, faces, core, channels = _face_data.taken_apart(arrays["faces"], numbers, labels)
    count = len(arrays["vertices"])

    def of(rows: NDArray[Any] | None) -> NDArray[Any] | None:
        return rows if rows is None or len(rows) != count else np.ascontiguousarray(rows[copied])

    packed = [(name, kind, words[copied]) for name, kind, words in arrays["channels"]]
    return {
        "vertices": of(arrays["vertices"]),
        "faces": faces,
        "normals": of(arrays["normals"]),
        "colors": of(arrays["colors"]),
        "uvs": [of(uv) for uv in arrays["uvs"]],
        "face_materials": core,
        "channels": packed + _channels.pack(channels, len(copied)),
    }
