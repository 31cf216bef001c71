"""Meshes of PyVista, Open3D and meshio, in and out. Their packages are imported only to make their objects.

Signatures say `Any` and docstrings the type: following PyVista's own types takes a type checker most of a minute.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from nanite_rs import _advice, _colors
from nanite_rs._asset import Notes, Source
from nanite_rs._export_parts import integers, rows_of_looks
from nanite_rs._flatten import settle
from nanite_rs.exceptions import DependencyError, DtypeError, MeshError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from types import ModuleType

    from numpy.typing import NDArray

    from nanite_rs.cut import Cut
    from nanite_rs.texture import Texture

NORMALS: Final = "Normals"
"""Point data that holds normals, as VTK's filters name it."""
COLORS: Final = "RGBA"
UVS: Final = "Texture Coordinates"
MATERIALS: Final = "face_materials"


def _refused(mesh: object, expected: str) -> DtypeError:
    error = DtypeError(f"mesh: expected {expected}, not {_advice.name_of_type(mesh)}")
    return _advice.advised(error, _advice.for_item(mesh))


def _needed(package: str) -> ModuleType:
    try:
        return __import__(package)
    except ImportError as error:
        raise DependencyError(f"{package} cannot be imported ({error}): pip install {package}") from None


def _taken(source: Source, point_data: Mapping[str, Any]) -> Source:
    """Add point data to a source: normals and UVs by their names, colours, everything else as channels."""
    for name, values in point_data.items():
        array = np.asarray(values)
        columns = array.shape[1] if array.ndim == 2 else 0
        if name.lower() == NORMALS.lower() and columns == 3:
            source.normals = np.asarray(array, np.float32)
        elif name == UVS and columns == 2:
            source.uvs = [np.asarray(array, np.float32)]
        elif name.upper() in ("RGB", "RGBA", "COLORS") and columns in (3, 4) and source.colors is None:
            source.colors = _colors.rgba(array)
        elif array.ndim in (1, 2) and array.size and array.dtype.kind in "fiub":
            source.channels[str(name)] = array
    return source


def _with_cells(source: Source, cell_data: Mapping[str, Any]) -> Source:
    """Add cell data to a source, without materials and normals: labels, and the rest as means at points."""
    for name, values in cell_data.items():
        array = np.asarray(values)
        numbers = array.dtype.kind in "fiub" and array.ndim in (1, 2) and len(array) == len(source.faces)
        # VTK's filters name the original faces in such an array.
        if numbers and name not in (MATERIALS, NORMALS) and not str(name).startswith("vtkOriginal"):
            source.face_channels[str(name)] = array
    notes = Notes()
    settle(source, notes)
    notes.warn("mesh")
    return source


def from_pyvista(mesh: Any) -> Source:
    """Take the arrays out of any PyVista data set: the triangles of its surface."""
    if not hasattr(mesh, "point_data") or not hasattr(mesh, "triangulate"):
        raise _refused(mesh, "a PyVista data set")
    surface: Any = (
        mesh if hasattr(mesh, "regular_faces") else mesh.extract_surface(algorithm="dataset_surface")
    )
    if not surface.is_all_triangles:
        surface = surface.triangulate()
    faces = np.asarray(surface.regular_faces)
    if not len(faces):
        raise MeshError("mesh: it has no triangles")
    source = _taken(Source(np.asarray(surface.points), faces), surface.point_data)
    uvs, normals = surface.point_data.active_texture_coordinates, surface.point_data.active_normals
    if uvs is not None:
        source.uvs = [np.asarray(uvs, np.float32)]
        source.channels.pop(surface.point_data.active_texture_coordinates_name, None)
    if normals is not None:
        source.normals = np.asarray(normals, np.float32)
        source.channels.pop(surface.point_data.active_normals_name, None)
    materials = np.asarray(surface.cell_data.get(MATERIALS, ()))
    source.face_materials = materials if materials.shape == (len(faces),) else None
    return _with_cells(source, surface.cell_data)


def to_pyvista(cut: Cut) -> Any:
    """Make a PolyData that carries all that a cut does."""
    pyvista = _needed("pyvista")
    out = pyvista.PolyData.from_regular_faces(cut.vertices, cut.faces)
    out.point_data[NORMALS] = cut.normals
    out.point_data.active_normals_name = NORMALS
    if cut.uvs:
        out.point_data.active_texture_coordinates = cut.uvs[0]
    for name, values in _carried(cut).items():
        out.point_data[name] = values
    if cut.face_materials is not None:
        out.cell_data[MATERIALS] = cut.face_materials
    for name, values in cut.face_channels.items():
        out.cell_data[name] = values
    return out


def to_pyvista_parts(cut: Cut) -> list[tuple[Any, Any]]:
    """Make a PolyData for each material, with the texture of its base colour."""
    pyvista = _needed("pyvista")
    whole, notes = to_pyvista(cut), Notes()
    if not cut.materials:
        return [(whole, None)]
    out = []
    rows = rows_of_looks(cut)
    for number in np.unique(rows).tolist():
        # Cells in their order, with the points that they use.
        part = whole.extract_cells(np.flatnonzero(rows == number)).extract_surface(
            algorithm="dataset_surface"
        )
        for name in ("vtkOriginalPointIds", "vtkOriginalCellIds"):
            part.point_data.pop(name, None)
            part.cell_data.pop(name, None)
        texture = cut.materials[number].base_color_texture
        uvs, pixels = _laid(cut, texture, notes)
        if uvs is None or pixels is None:
            out.append((part, None))
            continue
        used = np.unique(cut.faces[rows == number])
        # Points are in the order of the cut.
        part.point_data.active_texture_coordinates = uvs[used]
        out.append((part, pyvista.Texture(np.ascontiguousarray(pixels))))
    notes.warn("cut")
    return out


def _laid(
    cut: Cut, texture: Texture | None, notes: Notes
) -> tuple[NDArray[np.float32] | None, NDArray[np.uint8] | None]:
    """The coordinates by which a texture lies, and its pixels as bytes, rows from the top."""
    if texture is None or texture.uv_set >= len(cut.uvs):
        return None, None
    places = (
        np.column_stack([cut.uvs[texture.uv_set], np.ones(len(cut.vertices))]) @ np.array(texture._rows()).T
    )
    pixels = integers(texture.image, True, notes)
    if pixels.dtype == np.uint16:
        pixels = np.rint(pixels / 257.0).astype(np.uint8)
    if pixels.shape[2] == 2:
        pixels = pixels[..., [0, 0, 0, 1]]
    if pixels.shape[2] == 1:
        pixels = np.repeat(pixels, 3, axis=2)
    return np.column_stack([places[:, 0], 1.0 - places[:, 1]]).astype(np.float32), pixels


def _carried(cut: Cut) -> dict[str, NDArray[Any]]:
    """Colours and channels of vertices by name."""
    colors = cut.fine_colors
    if colors is None:
        return dict(cut._vertex_channels)
    # Colours that are not bytes are numbers of 0 to 1 there.
    fine = colors if colors.dtype == np.uint8 else _colors.unit(colors).astype(np.float32)
    return {COLORS: fine} | cut._vertex_channels


def from_open3d(mesh: Any) -> Source:
    """Take the arrays out of an Open3D mesh, of either of its kinds."""
    legacy: Any = mesh.to_legacy() if hasattr(mesh, "to_legacy") else mesh
    if not hasattr(legacy, "triangles") or not hasattr(legacy, "vertex_normals"):
        raise _refused(mesh, "an Open3D TriangleMesh")
    source = Source(np.asarray(legacy.vertices), np.asarray(legacy.triangles))
    if not len(source.faces):
        raise MeshError("mesh: it has no triangles")
    if legacy.has_vertex_normals():
        source.normals = np.asarray(legacy.vertex_normals, np.float32)
    if legacy.has_vertex_colors():
        source.colors = _colors.rgba(np.asarray(legacy.vertex_colors))
    if legacy.has_triangle_material_ids():
        source.face_materials = np.asarray(legacy.triangle_material_ids)
    if legacy.has_triangle_uvs():
        # One UV for each corner: every face gets vertices of its own. Equal ones are welded again by the build.
        corners = source.faces.reshape(-1)
        source.vertices = source.vertices[corners]
        source.normals = None if source.normals is None else source.normals[corners]
        source.colors = None if source.colors is None else source.colors[corners]
        source.faces = np.arange(len(corners)).reshape(-1, 3)
        source.uvs = [np.asarray(legacy.triangle_uvs, np.float32)]
    return source


def to_open3d(cut: Cut) -> Any:
    """Make an Open3D mesh with normals, colours, the first UV set, face materials and textures of base colours."""
    o3d: Any = _needed("open3d")
    rows, numbers = o3d.utility.Vector3dVector, o3d.utility.Vector3iVector
    out = o3d.geometry.TriangleMesh(
        rows(cut.vertices.astype(np.float64)), numbers(cut.faces.astype(np.int32))
    )
    out.vertex_normals = rows(cut.normals.astype(np.float64))
    if cut.fine_colors is not None:
        out.vertex_colors = rows(_colors.unit(cut.fine_colors[:, :3]))
    ids, uvs = cut.face_materials, cut.uvs[0].copy() if cut.uvs else None
    if uvs is not None and any(look.base_color_texture for look in cut.materials):
        # Numbers count textures there, so each material has one.
        ids, notes, images = rows_of_looks(cut).astype(np.int32), Notes(), []
        for number, look in enumerate(cut.materials):
            own, pixels = _laid(cut, look.base_color_texture, notes)
            used = np.unique(cut.faces[ids == number])
            if own is not None:
                uvs[used] = own[used]
            if pixels is None:
                color = _colors.to_srgb(np.asarray(look.base_color[:3], np.float64))
                pixels = np.rint(255.0 * color).astype(np.uint8).reshape(1, 1, 3)
            # Open3D has rows from below.
            images.append(o3d.geometry.Image(np.ascontiguousarray(pixels[::-1, :, :3])))
        notes.warn("cut")
        out.textures = images
    if uvs is not None:
        out.triangle_uvs = o3d.utility.Vector2dVector(uvs[cut.faces.reshape(-1)].astype(np.float64))
    if ids is not None:
        out.triangle_material_ids = o3d.utility.IntVector(ids)
    return out


def from_meshio(mesh: Any) -> Source:
    """Take the arrays out of a meshio mesh: its triangles and quadrilaterals."""
    if not hasattr(mesh, "points") or not hasattr(mesh, "cells_dict"):
        raise _refused(mesh, "a meshio.Mesh")
    points = np.asarray(mesh.points)
    if points.ndim == 2 and points.shape[1] == 2:
        points = np.column_stack([points, np.zeros(len(points), points.dtype)])
    faces: list[Any] = []
    carried: dict[str, list[Any]] = {name: [] for name in mesh.cell_data}
    for at, block in enumerate(mesh.cells):
        if block.type not in ("triangle", "quad"):
            continue
        data = np.asarray(block.data)
        parts = 1 if block.type == "triangle" else 2
        faces.append(data if parts == 1 else data[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3))
        for name, blocks in mesh.cell_data.items():
            carried[name].append(np.repeat(np.asarray(blocks[at]), parts, axis=0))
    if not sum(map(len, faces)):
        kinds = ", ".join(sorted({block.type for block in mesh.cells})) or "none"
        raise MeshError(f"mesh: it has no triangles or quads; its cells are: {kinds}")
    source = _taken(Source(points, np.concatenate(faces)), mesh.point_data)
    of_faces = {str(name): np.concatenate(rows) for name, rows in carried.items()}
    source.face_materials = of_faces.get(MATERIALS)
    return _with_cells(source, of_faces)


def to_meshio(cut: Cut) -> Any:
    """Make a meshio mesh that carries all that a cut does, but for materials."""
    if cut.materials:
        notes = Notes()
        notes.add("materials and their textures, for which meshio has no place")
        notes.warn("cut")
    point_data = {NORMALS: cut.normals} | ({UVS: cut.uvs[0]} if cut.uvs else {}) | _carried(cut)
    cell_data = {} if cut.face_materials is None else {MATERIALS: [cut.face_materials]}
    cell_data |= {name: [values] for name, values in cut.face_channels.items()}
    return _needed("meshio").Mesh(
        cut.vertices, [("triangle", cut.faces)], point_data=point_data, cell_data=cell_data
    )
