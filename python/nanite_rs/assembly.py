"""`Assembly`: placed meshes as one thing that is itself placed, such as leaves as a tree and trees as a forest."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Final, NamedTuple

import numpy as np

from nanite_rs import _advice, _checks, _core
from nanite_rs._asset import Asset, Part, Source
from nanite_rs._flatten import flattened
from nanite_rs._geometry import Shape
from nanite_rs.exceptions import ArgumentError, DtypeError
from nanite_rs.material import several
from nanite_rs.mesh import NaniteMesh
from nanite_rs.options import BuildOptions

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from numpy.typing import ArrayLike, NDArray

    from nanite_rs._progress import Progress
    from nanite_rs.cut import Cut
    from nanite_rs.material import Look, Material

__all__ = ["Assembly", "AssemblyPart"]

_STEPS: Final = 16
"""Halvings of the range of errors, which is 2^24 wide: the last is a step of less than 2^(24 / 65536)."""
_RANGE: Final = 2.0**-24


class AssemblyPart(NamedTuple):
    """One thing in many places of an assembly."""

    item: NaniteMesh | Assembly
    """The thing."""
    poses: NDArray[np.float64]
    """Where it stands: (K, 4, 4) matrices to the frame of the assembly. Read-only."""
    material: Look
    """The look of a mesh; empty for an assembly, whose parts have their own."""


class Assembly(Shape):
    """Meshes in many places as one thing that scenes place: leaves as a tree, trees as a forest.

    Each mesh, and each list of places, is held once, however many trees there are. A renderer first walks the
    assemblies of a scene: from far away one mesh is drawn for all of an assembly, which was built of cuts of its
    parts; near by its parts are drawn, each with its own level of detail. The rule is that of cuts: parts are
    drawn where, in some view of the call, the error of the one mesh projects above ``pixel_error``. An assembly
    can be a part of another; then each decides for itself.

    ``len(assembly)`` is the number of meshes that it consists of, those of assemblies in it one by one. Assemblies
    do not change; they can be pickled.

    Parameters
    ----------
    parts : sequence of tuples
        Each ``(item, poses)`` or ``(item, poses, material)``. ``item`` is a `NaniteMesh` or an `Assembly`,
        ``poses`` a (K, 4, 4) array of matrices from its frame to that of this assembly (one (4, 4) matrix will
        do), any invertible affine maps. ``material`` is the look of a mesh as for `Scene.add`.
    far : NaniteMesh, optional
        What is drawn from far away, instead of a mesh that is built of the parts.
    far_error : float, optional
        With ``far``: how far its full detail may be from the parts, in the unit of the assembly, beyond what it
        states itself: 0 for the `far` of another assembly of the same parts. Nobody checks it.
    far_triangles : int
        Triangles of which the mesh is built, at most: all parts are cut for the smallest error with so few.
    options : BuildOptions, optional
        Of that build; by default ``BuildOptions(preserve_area=True)``, so that crowns of leaves do not thin out.
    progress : Progress
        Of that build, as for `NaniteMesh.from_arrays`.

    Raises
    ------
    ArgumentError
        There are no parts or no poses; a pose is not finite, not affine or not invertible; the coarsest cuts have
        more than ``far_triangles`` triangles; assemblies are nested more than 32 deep. The message names part and
        pose.
    DtypeError
        A part is something else.

    Notes
    -----
    The far mesh carries no channels but vertex colours and texture coordinates. Its error counts the cuts that it
    was built of, in shape and in what they carry, as `NaniteMesh.from_heightfield` counts what terrain is off:
    every cut of it, and what is drawn of it, states both together. Two levels of hierarchies of instances, with a
    mesh for the far field of each, are what SpeedTree's forests and Unreal Engine's "Nanite Assemblies" have.

    Examples
    --------
    >>> leaf = nrs.NaniteMesh.from_arrays(*nrs.shapes.displaced_icosphere(faces=2_000))
    >>> poses = np.tile(np.eye(4), (100, 1, 1))
    >>> poses[:, :3, 3] = np.random.default_rng(0).uniform(-20, 20, (100, 3))
    >>> tree = nrs.Assembly([(leaf, poses)], far_triangles=20_000)
    >>> len(tree), tree.far_error > 0.0
    (100, True)
    >>> places = np.tile(np.eye(4), (9, 1, 1))
    >>> places[:, 0, 3] = 50.0 * np.arange(9)
    >>> scene = nrs.Scene(ambient_light=(1, 1, 1))
    >>> nodes = scene.add_many(tree, places)
    >>> len(scene)
    9
    """

    __slots__ = ("_far", "_parts")

    _ELEMENTS: ClassVar[str] = "parts"
    _core: Any
    _far: NaniteMesh
    _parts: tuple[AssemblyPart, ...]

    def __init__(
        self,
        parts: Iterable[tuple[Any, ...]],
        *,
        far: NaniteMesh | None = None,
        far_error: float | None = None,
        far_triangles: int = 500_000,
        options: BuildOptions | None = None,
        progress: Progress = None,
    ) -> None:
        own = tuple(_part(part, i) for i, part in enumerate(_rows(parts)))
        if not own:
            raise ArgumentError("parts: expected one at least, found none")
        most = _checks.whole(far_triangles, "far_triangles", 1)
        if far is None:
            if far_error is not None:
                raise ArgumentError("far_error: goes with far=")
            if not (options is None or isinstance(options, BuildOptions)):
                raise DtypeError(f"options: expected BuildOptions, not {_advice.name_of_type(options)}")
            options = BuildOptions(preserve_area=True) if options is None else options
            far = _built(own, most, options, progress)
        elif not isinstance(far, NaniteMesh):
            raise DtypeError(f"far: expected a NaniteMesh, not {_advice.name_of_type(far)}")
        elif far_error is None:
            raise ArgumentError("far_error: is needed with far=: how far it may be from the parts")
        else:
            far = _stated(far, _checks.not_negative(far_error, "far_error"))
        self._fill(own, far)

    def _fill(self, parts: tuple[AssemblyPart, ...], far: NaniteMesh) -> None:
        self._parts, self._far, self._materials = parts, far, far.materials
        raw = [
            (item._core, item._looks(look) if isinstance(item, NaniteMesh) else [], poses)
            for item, poses, look in parts
        ]
        self._core = _core.Assembly(raw, far._core, far._looks(far._default_look()))

    @property
    def parts(self) -> tuple[AssemblyPart, ...]:
        """What it consists of."""
        return self._parts

    @property
    def far(self) -> NaniteMesh:
        """What is drawn of it from far away; an ordinary mesh with levels of detail."""
        return self._far

    @property
    def far_error(self) -> float:
        """How far `far` may be from the parts, at full detail, in the unit of the assembly; 0 where it is exact."""
        error: float = self._core.error
        return error

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Smallest and largest corner of a box around all parts: (2, 3) float64."""
        return np.array(self._core.bounds)

    @property
    def nbytes(self) -> int:
        """Bytes in memory: of each mesh, of each list of poses once, and of far meshes."""
        return sum(_sizes(self).values())

    def __len__(self) -> int:
        """Return the number of meshes, those of assemblies in it one by one."""
        return int(self._core.leaves)

    def _default_look(self) -> Look:
        return ()

    def _outline(self) -> NDArray[np.floating[Any]]:
        return self._far._outline()

    def __copy__(self) -> Assembly:
        """Return the assembly itself: it does not change."""
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> Assembly:
        """Return the assembly itself: it does not change."""
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle parts and the far mesh, each once."""
        return _restored, (self._parts, self._far)

    def __repr__(self) -> str:
        return (
            f"<Assembly: {len(self):,} parts; {len(self._far):,} triangles stand for them within "
            f"{self.far_error:.3g}>"
        )


def _rows(parts: Any) -> list[Any]:
    try:
        return list(parts)
    except TypeError:
        raise DtypeError(
            f"parts: expected a sequence of (item, poses), not {_advice.name_of_type(parts)}"
        ) from None


def _part(part: Any, number: int) -> AssemblyPart:
    which = f"parts[{number}]"
    if not (isinstance(part, tuple | list) and len(part) in (2, 3)):
        raise DtypeError(f"{which}: expected (item, poses) or (item, poses, material), not {part!r:.80}")
    item, poses, *look = part
    if not isinstance(item, NaniteMesh | Assembly):
        raise DtypeError(f"{which}: expected a NaniteMesh or an Assembly, not {_advice.name_of_type(item)}")
    array = poses_of(poses, f"{which}: poses")
    material: Look = look[0] if look and look[0] is not None else item._default_look()
    if isinstance(item, Assembly):
        if material != ():
            raise ArgumentError(f"{which}: material: the parts of an assembly have their own")
    else:
        try:
            several(material, "material")
            item._looks(material)
        except (ArgumentError, DtypeError) as error:
            raise type(error)(f"{which}: {error}") from None
    return AssemblyPart(item, array, material)


def poses_of(poses: ArrayLike, name: str) -> NDArray[np.float64]:
    """Return poses as an array of their own, checked; ``name`` is the argument's."""
    try:
        array = np.array(poses, np.float64, order="C")
    except (TypeError, ValueError):
        raise DtypeError(f"{name}: expected an (N, 4, 4) array of numbers") from None
    if array.ndim == 2:
        array = array[None]
    if array.ndim != 3 or array.shape[1:] != (4, 4):
        raise ArgumentError(f"{name}: expected shape (N, 4, 4), found {array.shape}")
    if not len(array):
        raise ArgumentError(f"{name}: expected one at least, found none")
    try:
        _core.check_poses(array)
    except ArgumentError as error:
        said = str(error).removeprefix("poses").removeprefix(": ")
        gap = "" if said.startswith("[") else ": "
        raise ArgumentError(f"{name}{gap}{said}") from None
    array.flags.writeable = False
    return array


def _restored(parts: tuple[AssemblyPart, ...], far: NaniteMesh) -> Assembly:
    made = object.__new__(Assembly)
    made._fill(parts, far)
    return made


def _sizes(assembly: Assembly) -> dict[int, int]:
    """Bytes of all that an assembly holds, each thing once."""
    sizes = {id(assembly.far): assembly.far.nbytes}
    for item, poses, _ in assembly.parts:
        # The core has them as maps of twelve numbers with a bound.
        sizes[id(poses)] = poses.nbytes + 13 * 8 * len(poses)
        sizes |= _sizes(item) if isinstance(item, Assembly) else {id(item): item.nbytes}
    return sizes


# ------------------------------------------------------------------------------------------- the far mesh


def _stated(mesh: NaniteMesh, error: float) -> NaniteMesh:
    """Return a mesh whose errors count an error of its source."""
    own = NaniteMesh._wrap(mesh._core.with_source_error(error))
    own._materials = mesh._materials
    return own


def _stretch(poses: NDArray[np.float64]) -> float:
    """How much the poses stretch any length at most."""
    return float(np.linalg.norm(poses[:, :3, :3], 2, axis=(1, 2)).max()) * (1.0 + 1e-9)


def _built(
    parts: tuple[AssemblyPart, ...], most: int, options: BuildOptions, progress: Progress
) -> NaniteMesh:
    """Build the mesh that stands for parts, of cuts of them with so many triangles at most."""
    things = [(p.item if isinstance(p.item, NaniteMesh) else p.item.far, _stretch(p.poses)) for p in parts]
    cuts, error = _cuts(things, [len(part.poses) for part in parts], most)
    asset = Asset("parts")
    for number, ((item, poses, look), cut) in enumerate(zip(parts, cuts, strict=True)):
        of: Look = item.far._default_look() if isinstance(item, Assembly) else look
        looks = several(of, "material")
        source = _everywhere(cut, poses, textured=any(_has_textures(look) for look in looks))
        name = f"parts[{number}]"
        asset.placed.append((name, number, np.eye(4)))
        asset.meshes.append([Part(name, source, list(looks))])
    source = flattened(asset)
    vertices = source.vertices
    # What storing in single precision takes is counted by the build.
    mesh = NaniteMesh.from_arrays(
        vertices,
        source.faces,
        normals=source.normals,
        colors=source.colors,
        uvs=source.uvs or None,
        face_materials=source.face_materials,
        materials=source.materials or None,
        options=options,
        progress=progress,
    )
    return _stated(mesh, error) if error > 0.0 else mesh


def _cuts(
    things: Sequence[tuple[NaniteMesh, float]], counts: Sequence[int], most: int
) -> tuple[list[Cut], float]:
    """Cut meshes for one error, as their poses stretch them, the smallest with few enough triangles in all."""

    def at(error: float) -> tuple[list[Cut], int]:
        cuts = [mesh.cut(error=error / stretch) for mesh, stretch in things]
        return cuts, sum(len(cut) * count for cut, count in zip(cuts, counts, strict=True))

    if sum(len(mesh) * count for (mesh, _), count in zip(things, counts, strict=True)) <= most:
        found, _ = at(0.0)
    else:
        found, least = at(math.inf)
        if least > most:
            raise ArgumentError(
                f"far_triangles: the coarsest cuts of all parts have {least:,} triangles, more than {most:,}: give "
                "more, join parts in assemblies of their own, or add the parts to the scene one by one "
                "(Scene.add_many)"
            )
        sizes = [float(np.linalg.norm(np.ptp(mesh.bounds, axis=0))) * by for mesh, by in things]
        high = max(sizes)
        low = high * _RANGE
        for _ in range(_STEPS):
            middle = math.sqrt(low * high)
            cuts, triangles = at(middle)
            if triangles <= most:
                found, high = cuts, middle
            else:
                low = middle
    errors = [
        max(e for e in (cut.error, cut.attribute_error) if math.isfinite(e)) * stretch
        for cut, (_, stretch) in zip(found, things, strict=True)
    ]
    return found, max(errors)


def _has_textures(material: Material) -> bool:
    return any(texture is not None for texture in material._raw()["textures"])


def _everywhere(cut: Cut, poses: NDArray[np.float64], *, textured: bool) -> Source:
    """Put a cut in all places, as one surface."""
    count, linear = len(poses), poses[:, :3, :3]
    vertices = cut.vertices.astype(np.float64) @ linear.transpose(0, 2, 1) + poses[:, None, :3, 3]
    mirrored = np.linalg.det(linear) < 0.0
    # The cofactor matrix is det · inverse transpose, and keeps its sign where a map mirrors.
    cofactor = np.stack([np.cross(linear[:, (k + 1) % 3], linear[:, (k + 2) % 3]) for k in range(3)], axis=1)
    cofactor *= np.where(mirrored, -1.0, 1.0)[:, None, None]
    normals = cut.normals.astype(np.float64) @ cofactor.transpose(0, 2, 1)
    length = np.linalg.norm(normals, axis=2, keepdims=True)
    units = np.asarray(normals / np.where(length > 0.0, length, 1.0), np.float32).reshape(-1, 3)
    faces = cut.faces.astype(np.int64) + len(cut.vertices) * np.arange(count)[:, None, None]
    faces[mirrored] = faces[mirrored][:, :, ::-1]

    def tiled(rows: NDArray[Any]) -> NDArray[Any]:
        return np.tile(rows, (count,) + (1,) * (rows.ndim - 1))

    return Source(
        vertices.reshape(-1, 3),
        faces.reshape(-1, 3),
        normals=units,
        colors=None if cut.fine_colors is None else tiled(cut.fine_colors),
        uvs=[tiled(uvs) for uvs in cut.uvs] if textured else [],
        face_materials=None if cut.face_materials is None else tiled(cut.face_materials),
    )


# --------------------------------------------------------------------------------------- one mesh at a time


@dataclass(frozen=True)
class Placed:
    """A mesh, points or lines where they stand: what an instance shows, or a part of it."""

    mesh: Any
    pose: NDArray[np.float64]
    material: Look
    instance_id: int
    name: str = ""


def placed(mesh: Any, pose: NDArray[np.float64], material: Look, instance_id: int) -> Iterator[Placed]:
    """Yield what an instance shows, of assemblies part by part."""
    if not isinstance(mesh, Assembly):
        yield Placed(mesh, pose, material, instance_id)
        return
    for item, poses, look in mesh.parts:
        for own in poses:
            yield from placed(item, pose @ own, look, instance_id)
