"""Trees made of cards, as geometry: leaves that need no alpha test, in any level of detail."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from nanite_rs import _advice, _checks, _text
from nanite_rs._foliage import convert, inputs, masks, pictures
from nanite_rs._foliage import wind as wind_channels
from nanite_rs._foliage.roles import roles
from nanite_rs._notebook import table
from nanite_rs.exceptions import ArgumentError, DtypeError
from nanite_rs.mesh import NaniteMesh
from nanite_rs.options import BuildOptions, no_options
from nanite_rs.swaying_mesh import Wave

if TYPE_CHECKING:
    import os
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

    from nanite_rs._asset import Source
    from nanite_rs._progress import Progress
    from nanite_rs.material import Material
    from nanite_rs.texture import Image, Texture

__all__ = ["Foliage", "FoliageReport", "MaterialReport", "breeze", "to_geometry"]

Up = Literal["x", "y", "z"]


@dataclass(frozen=True)
class MaterialReport:
    """What was made of the faces of one material."""

    name: str
    """The material's name, or its number."""
    leaf: bool
    """Whether it is one of leaves; all others stay as they are."""
    why: str
    """What spoke for it."""
    before: int
    """Triangles of the source."""
    after: int
    """Triangles of the result."""
    cards: int = 0
    """Connected parts of the source."""
    distinct: int = 0
    """Facets that show something else of the image than others: each was cut and divided once."""
    outlines: int = 0
    """Parts of the image that are seen."""
    dropped: int = 0
    """Parts smaller than the tolerance, whose area the others have."""
    tolerance: float = 0.0
    """Texels by which outlines were simplified."""
    deviation: float = 0.0
    """Texels, a bound: no point of an outline is farther from the contour of alpha, nor the contour from it."""
    error: float = 0.0
    """The same in units of the mesh, where a texel is largest."""
    area: float = 1.0
    """Area inside outlines against that inside the contours."""


@dataclass(frozen=True)
class FoliageReport:
    """What `to_geometry` found and made, material by material."""

    materials: tuple[MaterialReport, ...]
    """In the order of the source's."""

    @property
    def triangles(self) -> int:
        """Triangles of the result."""
        return sum(one.after for one in self.materials)

    @property
    def error(self) -> float:
        """Units of the mesh: how far an outline may be from the contour that it stands for."""
        return max(one.error for one in self.materials)

    def _table(self) -> tuple[list[str], list[list[str]]]:
        head = "material", "taken for", "triangles", "made", "cards", "distinct", "outlines", "off by", "area"
        rows = [
            [
                one.name,
                f"{'leaves' if one.leaf else 'trunk'} ({one.why})",
                f"{one.before:,}",
                f"{one.after:,}",
                *(
                    [
                        f"{one.cards:,}",
                        f"{one.distinct:,}",
                        f"{one.outlines:,}",
                        f"{one.deviation:.2f} texels",
                        f"{one.area:.2%}",
                    ]
                    if one.leaf
                    else [""] * 5
                ),
            ]
            for one in self.materials
        ]
        return list(head), rows

    def __str__(self) -> str:
        head, rows = self._table()
        return _text.table([head, *rows], right=range(2, len(head)))

    def _repr_html_(self) -> str:
        return table(*self._table())


@dataclass(frozen=True)
class Foliage:
    """A tree whose leaves are geometry; made by `to_geometry`."""

    vertices: NDArray[np.float64]
    """(N, 3)."""
    faces: NDArray[np.int64]
    """(M, 3)."""
    normals: NDArray[np.float32] | None
    """(N, 3), those of the cards; nothing where the source has none."""
    colors: NDArray[Any] | None
    """(N, 3) or (N, 4)."""
    uvs: tuple[NDArray[np.float32], ...]
    """(N, 2) each, those of the cards."""
    channels: dict[str, NDArray[Any]]
    """What else vertices carry, by name; ``wind_pivot``, ``wind_branch`` and ``wind_phase`` where they were asked
    for."""
    face_materials: NDArray[np.int32]
    """(M,), the rows of ``materials``."""
    face_channels: dict[str, NDArray[Any]]
    """What else faces carry."""
    materials: tuple[Material, ...]
    """Those of the source; leaves are opaque, and their colours go on beyond the outlines."""
    report: FoliageReport
    """What was found and made."""
    _source: Source = field(repr=False)
    _converted: tuple[convert.Converted, ...] = field(repr=False)

    def arrays(self) -> dict[str, Any]:
        """Return the keyword arguments of `NaniteMesh.from_arrays`; `TriangleMesh` takes all without channels."""
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

    def build(self, *, options: BuildOptions | None = None, progress: Progress = None) -> NaniteMesh:
        """Build levels of detail that cover as much as the leaves do.

        Parameters
        ----------
        options : BuildOptions, optional
            How to build; by default with ``preserve_area=True``.
        progress : bool or callable, optional
            As for `NaniteMesh.from_arrays`.

        Raises
        ------
        MeshError, DtypeError
            As `NaniteMesh.from_arrays` does.
        """
        if not isinstance(options, BuildOptions | None):
            raise no_options(options)
        how = BuildOptions(preserve_area=True) if options is None else options
        return NaniteMesh.from_arrays(**self.arrays(), options=how, progress=progress)

    def save_previews(self, folder: str | os.PathLike[str], *, size: int = 800) -> list[str]:
        """Write pictures by which to judge the result.

        Parameters
        ----------
        folder : str or os.PathLike
            Where ``cards.png``, ``geometry.png`` and ``triangles.png`` go, and ``outline_NAME.png`` of each image
            of leaves; it is made if it is not there.
        size : int
            Pixels of a side.

        Returns
        -------
        list of str
            The paths.
        """
        size = _checks.whole(size, "size", 16, 8192)
        where = Path(_checks.path_of(folder, "folder"))
        where.mkdir(parents=True, exist_ok=True)
        shown = pictures.of_tree(self._source, self.arrays(), size)
        names = inputs.named(self._source.materials)
        for one in self._converted:
            look = self._source.materials[one.material]
            shown[f"outline_{pictures.file_name(names[one.material])}"] = pictures.of_outlines(
                look, one, size
            )
        return pictures.write(shown, where)


def to_geometry(
    source: Any,
    *,
    leaf_materials: Literal["auto"] | Sequence[str] = "auto",
    cutoff: float | None = None,
    tolerance: float = 0.5,
    triangles_per_leaf: float | None = None,
    textures: Mapping[str, Texture | Image | ArrayLike | str | os.PathLike[str]] | None = None,
    wind: bool = False,
    up: Up = "y",
    format: str | None = None,
) -> Foliage:
    """Replace leaves that are holes in images by triangles.

    Cards with alpha cost a texture lookup for every pixel that they could cover, several times where they lie
    behind each other, and cannot be simplified: what they show is in their images. Here alpha is traced at the
    cutoff, between texels where it is filtered; outlines are simplified, keep their area, and are cut to what each
    card shows of the image. What comes of it lies on the card's own surface, be it bent, with its normals, UVs,
    colours and channels, and is seen from the same sides. Neighbouring triangles of a bent card stay connected, to
    the last bit.

    Outlines are contours of the bilinear alpha between texels, simplified after D. Douglas and T. Peucker (1973),
    and divided by constrained Delaunay triangulation.

    Parameters
    ----------
    source : path, binary file, bytes, trimesh object, NaniteMesh, TriangleMesh, Scene or LoadedScene
        The tree with its materials. Several meshes become one.
    leaf_materials : "auto" or sequence of str
        Names of the materials of leaves, or ``"#3"`` for the number of one. With ``"auto"`` these are materials
        whose alpha makes holes or blends, of whose image at least a hundredth is empty, and those of ``textures``.
    cutoff : float, optional
        Alpha below it is a hole, above 0 up to 1; by default the material's, or 0.5 for one that blends.
    tolerance : float
        Texels that outlines may be simplified by, 0 to 64.
    triangles_per_leaf : float, optional
        So many triangles each part of an image may have in the mean, at least 1: the tolerance grows until it is
        so, up to 64 texels.
    textures : mapping of names of materials to images, optional
        Images with alpha for materials that have none, as OBJ files from stores often leave them out. These are
        seen from both sides.
    wind : bool
        Give vertices channels for an animation: ``wind_pivot`` (3,), where a card hangs on the trunk,
        ``wind_branch``, its number from 1, and ``wind_phase``, 0 to 1; of the trunk its foot, 0 and 0. And how
        much it moves them: ``wind_bend``, 0 to 1, the square of the height, and ``wind_flutter``, the distance from
        the pivot, of the trunk 0. `breeze` makes waves of them.
    up : "x", "y" or "z"
        The axis that points up: the trunk's foot is its lowest part.
    format : str, optional
        Ending of such files, where ``source`` is bytes or a file without a name.

    Returns
    -------
    Foliage
        The arrays, a report, and `Foliage.build`.

    Raises
    ------
    ArgumentError
        No material is one of leaves, or one that was named has no image with alpha; a number is out of range.
    DtypeError
        An argument is of another type.
    FormatError, MeshError
        The source cannot be read, or has no triangles.
    DependencyError
        shapely or contourpy is missing: the extra ``foliage`` has them.

    Examples
    --------
    A card with a round leaf:

    >>> y, x = np.mgrid[-1:1:64j, -1:1:64j]
    >>> image = np.full((64, 64, 4), (60, 120, 40, 255), np.uint8)
    >>> image[..., 3] = 255 * (x**2 + y**2 < 0.8)
    >>> leaf = nrs.Material(base_color_texture=nrs.Texture(image), alpha_mode="mask", double_sided=True)
    >>> corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
    >>> faces = [[0, 1, 2], [0, 2, 3]]
    >>> card = nrs.TriangleMesh(np.pad(corners, [(0, 0), (0, 1)]), faces, uvs=corners, materials=leaf)
    >>> made = nrs.foliage.to_geometry(card)
    >>> a, b, c = made.vertices[made.faces].swapaxes(0, 1)
    >>> area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
    >>> bool(abs(area / (np.pi * 0.8 / 4 * (63 / 64) ** 2) - 1) < 0.01)
    True
    >>> mesh = made.build(progress=False)
    """
    masks.libraries()
    chosen = _names(leaf_materials)
    if cutoff is not None:
        cutoff = _checks.unit(cutoff, "cutoff")
        if cutoff == 0.0:
            raise ArgumentError("cutoff: must be above 0, where all is a leaf")
    tolerance = _between(tolerance, "tolerance", 0.0, masks.MOST_TOLERANCE)
    if triangles_per_leaf is not None:
        triangles_per_leaf = _between(triangles_per_leaf, "triangles_per_leaf", 1.0, np.inf)
    _checks.choice(up, "up", get_args(Up))
    _checks.truth(wind, "wind")
    given = {} if textures is None else _images(textures)
    tree = inputs.source_of(source, format)
    tree = replace(tree, materials=inputs.with_textures(tree.materials, given))
    what = roles(tree.materials, chosen, list(given), cutoff)
    axis = get_args(Up).index(up) if wind else None
    out, made = convert.converted(tree, what, tolerance=tolerance, triangles=triangles_per_leaf, wind_up=axis)
    channels = out.channels
    if axis is not None:
        channels = channels | wind_channels.reaches(np.asarray(out.vertices, np.float64), channels, axis)
    return Foliage(
        out.vertices,
        out.faces,
        out.normals,
        out.colors,
        tuple(out.uvs),
        channels,
        np.asarray(out.face_materials, np.int32),
        out.face_channels,
        out.materials,
        _report(tree, what, out, made),
        tree,
        tuple(made),
    )


def breeze(
    mesh: NaniteMesh, *, strength: float = 1.0, direction: ArrayLike = (1.0, 0.0, 0.0), up: Up = "y"
) -> list[Wave]:
    """Make waves of wind for a tree that `to_geometry` gave channels for it.

    The tree leans and sways across, by the square of the height, and its leaves flutter about their pivots, each
    with a phase of its own.

    Parameters
    ----------
    mesh : NaniteMesh
        The tree, built of `to_geometry` with ``wind=True``.
    strength : float
        1 is a breeze, in which the top of the tree goes by a thirtieth of its height.
    direction : (3,)
        Where the wind blows, of any length but 0.
    up : "x", "y" or "z"
        The axis that points up.

    Returns
    -------
    list of Wave
        For `SwayingMesh`.

    Raises
    ------
    ArgumentError, DtypeError
        The mesh has no such channels; not finite, or a direction of length 0.

    Examples
    --------
    >>> y, x = np.mgrid[-1:1:32j, -1:1:32j]
    >>> image = np.full((32, 32, 4), 255, np.uint8)
    >>> image[..., 3] = 255 * (x**2 + y**2 < 0.8)
    >>> leaf = nrs.Material(base_color_texture=nrs.Texture(image), alpha_mode="mask", double_sided=True)
    >>> corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
    >>> faces = [[0, 1, 2], [0, 2, 3]]
    >>> card = nrs.TriangleMesh(np.pad(corners, [(0, 0), (0, 1)]), faces, uvs=corners, materials=leaf)
    >>> mesh = nrs.foliage.to_geometry(card, wind=True).build(progress=False)
    >>> tree = nrs.SwayingMesh(mesh, nrs.foliage.breeze(mesh))
    >>> tree.move(0.4)
    >>> 0 < tree.largest < 0.25
    True
    """
    if not isinstance(mesh, NaniteMesh):
        raise DtypeError(f"mesh: expected a NaniteMesh, not {type(mesh).__name__}")
    missing = {wind_channels.BEND, wind_channels.FLUTTER, wind_channels.PHASE} - set(mesh.info["channels"])
    if missing:
        raise ArgumentError(f"mesh: has no channel {min(missing)!r}; to_geometry(wind=True) gives trees some")
    strength = _checks.finite(strength, "strength")
    _checks.choice(up, "up", get_args(Up))
    way = _checks.numbers(direction, (3,), "direction")
    length = float(np.linalg.norm(way))
    if length == 0.0:
        raise ArgumentError("direction: must not be 0")
    number = get_args(Up).index(up)
    axis = np.eye(3)[number]
    way = way / length
    across = np.cross(way, axis)
    top = strength * float(np.ptp(mesh.bounds[:, number])) / 30.0

    def wave(vector: NDArray[np.float64], frequency: float, weight: str, offset: str | None = None) -> Wave:
        x, y, z = vector.tolist()
        return Wave((x, y, z), frequency, weight=weight, offset=offset)

    return [
        wave(top * way, 0.23, wind_channels.BEND),
        wave(0.4 * top * across, 0.37, wind_channels.BEND),
        wave(0.1 * strength * axis, 1.3, wind_channels.FLUTTER, wind_channels.PHASE),
        wave(0.06 * strength * way, 1.9, wind_channels.FLUTTER, wind_channels.PHASE),
    ]


def _report(tree: Source, found: list[Any], out: Source, made: list[convert.Converted]) -> FoliageReport:
    count = len(tree.materials)
    before = np.bincount(inputs.numbers(tree), minlength=count)
    after = np.bincount(np.asarray(out.face_materials), minlength=count)
    leaves = {one.material: one for one in made}
    rows = []
    for number, (name, role) in enumerate(zip(inputs.named(tree.materials), found, strict=True)):
        row = MaterialReport(name, role.leaf, role.why, int(before[number]), int(after[number]))
        if (one := leaves.get(number)) is not None:
            lines = one.outlines
            row = replace(
                row,
                cards=one.cards,
                distinct=one.distinct,
                outlines=len(lines.polygons),
                dropped=lines.dropped,
                tolerance=lines.tolerance,
                deviation=lines.deviation,
                error=one.error,
                area=lines.kept / lines.area if lines.area > 0.0 else 1.0,
            )
        rows.append(row)
    return FoliageReport(tuple(rows))


def _names(leaf_materials: object) -> list[str] | None:
    if leaf_materials == "auto" and isinstance(leaf_materials, str):
        return None
    if isinstance(leaf_materials, str):
        raise ArgumentError(f"leaf_materials: must be 'auto' or a list of names, not {leaf_materials!r}")
    try:
        names: list[Any] = list(leaf_materials)  # type: ignore[call-overload]
    except TypeError:
        found = _advice.name_of_type(leaf_materials)
        raise DtypeError(f"leaf_materials: expected 'auto' or names, not {found}") from None
    for number, name in enumerate(names):
        if not isinstance(name, str):
            raise DtypeError(f"leaf_materials[{number}]: expected a name, not {_advice.name_of_type(name)}")
    if not names:
        raise ArgumentError("leaf_materials: names at least one material")
    return names


def _images(textures: object) -> dict[str, Any]:
    if not isinstance(textures, Mapping):
        found = _advice.name_of_type(textures)
        raise DtypeError(f"textures: expected images by names of materials, not {found}")
    return dict(textures)


def _between(value: object, name: str, least: float, most: float) -> float:
    number = _checks.finite(value, name)
    if not least <= number <= most:
        upto = "" if most == np.inf else f" to {most:g}"
        raise ArgumentError(f"{name}: must be {least:g}{upto or ' or more'}, not {number:g}")
    return number
