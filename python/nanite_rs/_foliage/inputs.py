"""What leaves are looked for in, as one mesh with its materials."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from nanite_rs import _advice, _trimesh, io
from nanite_rs._asset import Source
from nanite_rs._flatten import flattened
from nanite_rs.assets import LoadedScene
from nanite_rs.exceptions import ArgumentError, DtypeError, MeshError
from nanite_rs.mesh import NaniteMesh
from nanite_rs.scene import Scene
from nanite_rs.texture import Image, Texture
from nanite_rs.triangle_mesh import TriangleMesh

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from nanite_rs._asset import Asset
    from nanite_rs.material import Material


def source_of(given: Any, format: str | None) -> Source:
    """Return one mesh of what was given, in which materials of other names stay apart."""
    asset: Asset | None = None
    if isinstance(given, Source):
        return _sound(replace(given))
    if isinstance(given, NaniteMesh | TriangleMesh):
        scene = Scene()
        scene.add(given)
        asset = _of_scene(scene)
    elif isinstance(given, Scene | LoadedScene):
        asset = _of_scene(given if isinstance(given, Scene) else given.scene)
    elif type(given).__module__.startswith("trimesh."):
        import trimesh

        if not isinstance(given, trimesh.Trimesh | trimesh.Scene):
            found = _advice.name_of_type(given)
            raise DtypeError(f"source: expected trimesh.Trimesh or trimesh.Scene, not {found}")
        asset = _trimesh.described(given, "source", drop_bad_textures=True)
    else:
        asset = io.read_asset(given, format=format, drop_bad_textures=True)
    out = flattened(asset, by_name=True)
    asset.notes.warn(asset.name)
    return _sound(out)


def _sound(source: Source) -> Source:
    """Refuse what has no place, in space or in an image."""
    places: dict[str, NDArray[Any]] = {"vertices": source.vertices}
    places |= {f"uvs[{k}]": uv for k, uv in enumerate(source.uvs)}
    for name, rows in places.items():
        bad = np.flatnonzero(~np.isfinite(rows).all(axis=1))
        if len(bad):
            raise MeshError(f"source: {name}[{bad[0]}]: must be finite, not {rows[bad[0]].tolist()}")
    wrong = np.flatnonzero(((source.faces < 0) | (source.faces >= len(source.vertices))).any(axis=1))
    if len(wrong):
        row = source.faces[wrong[0]].tolist()
        raise MeshError(
            f"source: faces[{wrong[0]}]: refers to {row}, there are {len(source.vertices)} vertices"
        )
    return source


def _of_scene(scene: Scene) -> Asset:
    # Imported late: it needs most of the package.
    from nanite_rs import _export_scene

    if not any(node.visible for node in scene.instances):
        raise ArgumentError("source: the scene shows no mesh")
    return _export_scene.described("source", scene)


def named(materials: tuple[Material, ...]) -> list[str]:
    """Return what messages call materials, of which some have no name, and some the same."""
    names = [look.name or f"#{number}" for number, look in enumerate(materials)]
    return [f"{name} (#{k})" if names.count(name) > 1 else name for k, name in enumerate(names)]


def with_textures(materials: tuple[Material, ...], textures: Mapping[str, Any]) -> tuple[Material, ...]:
    """Give materials, by name, images of colour and alpha in place of what they have."""
    out, names = list(materials), [look.name for look in materials]
    for name, given in textures.items():
        rows = [row for row, known in enumerate(names) if known == name]
        if not rows:
            raise ArgumentError(
                f"textures: there is no material {name!r}; there are {', '.join(named(materials))}"
            )
        try:
            texture = given if isinstance(given, Texture) else Texture(Image._of(given))
        except ArgumentError as error:
            raise type(error)(f"textures[{name!r}]: {error}") from None
        for row in rows:
            # Colours of materials without an image are what the image is to be seen in.
            own = out[row]
            first = own.base_color_texture is None
            color = (1.0, 1.0, 1.0) if first else own.base_color
            mode = "mask" if own.alpha_mode == "opaque" else own.alpha_mode
            out[row] = replace(
                own, base_color_texture=texture, base_color=color, alpha_mode=mode, double_sided=True
            )
    return tuple(out)


def numbers(source: Source) -> NDArray[np.int64]:
    """Return the row of ``materials`` of each face."""
    own = source.face_materials
    if own is None:
        return np.zeros(len(source.faces), np.int64)
    return np.clip(np.asarray(own, np.int64), 0, max(len(source.materials) - 1, 0))
