"""`rebake`: levels of detail beyond the seams of textures."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from nanite_rs._rebaking import classes
from nanite_rs.exceptions import ArgumentError, DtypeError
from nanite_rs.mesh import NaniteMesh
from nanite_rs.options import BuildOptions, no_options

if TYPE_CHECKING:
    from nanite_rs._progress import Progress

__all__ = ["rebake"]


def rebake(
    mesh: NaniteMesh,
    *,
    texture_size: int = 2048,
    options: BuildOptions | None = None,
    progress: Progress = None,
) -> NaniteMesh:
    """Build a textured mesh anew, with images of their own for levels that seams of its textures would stop.

    Scans have thousands of small charts. A simplifier keeps their seams, and so ends early, or tears textures.
    Here, levels with an eighth of the triangles or fewer, of which a quarter of the vertices lie on seams, are
    simplified as if there were none. What comes of them is cut into charts by xatlas, and each texel shows what
    the source has at the point nearest to it: base colour and emitted light (means in linear light), occlusion,
    roughness and metallic, and normals. Finer levels keep the images of the source, so that a cut may show both,
    without a crack.

    Materials that differ in what no image says (holes, blending, back faces, `unlit`, `smooth`) stay apart; all
    others become one. Vertex colours and channels are carried along as ever.

    **Errors.** `Cut.error` bounds the distance as ever. An image is right up to its texels: their size is part of
    `Cut.attribute_error`, and of the error that renderers go by, so that a level is shown where a texel takes no
    more than a pixel. `BuildReport.rebaked` has them.

    Parameters
    ----------
    mesh : NaniteMesh
        The mesh, with `NaniteMesh.materials` that have textures.
    texture_size : int
        Most texels of a side of the largest image. Coarser levels have as many texels for a triangle.
    options : BuildOptions, optional
        How to build. ``BuildOptions(rebake="auto")`` has the same done where a mesh is made.
    progress : bool or callable, optional
        As for `NaniteMesh.from_arrays`.

    Returns
    -------
    NaniteMesh
        Its `NaniteMesh.materials` are those of the source, and behind them those of levels. Where seams are in
        nobody's way, nothing is baked.

    Raises
    ------
    ArgumentError
        The mesh has no textures, or faces that carry channels; ``texture_size`` is out of range.
    DtypeError
        It is something else.
    DependencyError
        xatlas is missing: the extra ``rebake`` has it.

    Examples
    --------
    >>> vertices, faces = nrs.shapes.displaced_icosphere(faces=8_000)
    >>> corners = vertices[faces].reshape(-1, 3)  # a chart for each triangle
    >>> uvs = np.random.default_rng(0).random((len(corners), 2), np.float32)
    >>> look = nrs.Material(base_color_texture=nrs.Texture(np.full((64, 64, 3), 200, np.uint8)))
    >>> scan = nrs.NaniteMesh.from_arrays(corners, np.arange(len(corners)).reshape(-1, 3), uvs=uvs, materials=look)
    >>> mesh = nrs.rebake(scan, texture_size=256)
    >>> len(mesh.materials) > 1 and len(mesh.cut(error=np.inf)) <= 128
    True
    """
    if not isinstance(mesh, NaniteMesh):
        raise DtypeError(f"mesh: expected a NaniteMesh, not {type(mesh).__name__}")
    if not isinstance(options, BuildOptions | None):
        raise no_options(options)
    if not classes.has_images(mesh.materials) or mesh._core.uv_sets == 0:
        raise ArgumentError("mesh: it has no textures to bake from, or no texture coordinates")
    how = replace(options or BuildOptions(), rebake="auto", texture_size=texture_size)
    source = mesh.cut(error=0.0)
    own = min((part.material for part in mesh.report.rebaked), default=len(mesh.materials))
    # Faces have numbers where levels were baked before.
    numbered = source.face_materials if own > 1 else None
    return NaniteMesh.from_arrays(
        source.vertices,
        source.faces,
        normals=None if mesh.report.computed_normals else source.normals,
        colors=source.fine_colors,
        uvs=source.uvs,
        channels=source._vertex_channels,
        face_materials=numbered,
        face_channels=source.face_channels,
        materials=mesh.materials[:own],
        options=how,
        progress=progress,
    )
