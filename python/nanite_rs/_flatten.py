"""Flattening descriptions of scenes into one mesh: every instance in place, one table of materials."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from nanite_rs import _colors, _face_data
from nanite_rs._asset import Source, as_labels, has_area
from nanite_rs.exceptions import MeshError
from nanite_rs.material import Material

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from nanite_rs._asset import Asset, Notes, Part


def flattened(asset: Asset, *, by_name: bool = False) -> Source:
    """Put all instances of a description where they stand, into one mesh.

    The materials of all parts are rows of one table, in the order in which parts come; where there is one for all,
    face materials keep the numbers that they have, each part's behind those of the part before. Equal materials are
    one; ``by_name`` those of other names stay apart.
    """
    for animation in asset.rig.animations if asset.rig is not None else ():
        asset.notes.add("animations, which are not played", animation.name)
    parts: list[Part] = []
    for node, number, pose in asset.placed:
        for part in asset.meshes[number]:
            source = _transformed(replace(part.source), pose)
            if has_area(source.vertices, source.faces):
                parts.append(replace(part, source=source))
            else:
                asset.notes.add("nodes flattened to nothing", node)
        if number in asset.strokes:
            asset.notes.add("points and lines")
    if not parts:
        lost = f" ({asset.notes})" if str(asset.notes) else ""
        lost += "; load_scene has its points and lines" * bool(asset.strokes)
        raise MeshError(f"{asset.name}: there are no triangles in it{lost}")
    table: dict[tuple[Any, ...], int] = {}
    rows = []
    for number, part in enumerate(parts):
        looks, own = _looks(part), part.source.face_materials
        own = np.zeros(len(part.source.faces), np.int64) if own is None else np.asarray(own, np.int64)
        keys: list[tuple[Any, ...]] = [(look, look.name if by_name else "") for look in looks]
        own = np.clip(own, 0, len(looks) - 1) if len(looks) > 1 else own
        if len(looks) == 1 and own.any():
            # Numbers without a material stay distinct.
            values, own = np.unique(own, return_inverse=True)
            keys = [(*keys[0], number, value) for value in values.tolist()]
        places = np.array([table.setdefault(key, len(table)) for key in keys], np.int32)
        rows.append(places[own.reshape(-1)])
    several = len({key[:2] for key in table}) > 1
    materials = tuple(key[0] for key in table) if several else (next(iter(table))[0],)
    if several:
        for part, row in zip(parts, rows, strict=True):
            part.source.face_materials = row
    elif materials == (Material(),):
        materials = ()  # nothing was said
    out = concatenated([part.source for part in parts], asset.notes, follow=not several)
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


def concatenated(parts: list[Source], notes: Notes, *, follow: bool) -> Source:
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
