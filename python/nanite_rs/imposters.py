"""Imposters: a mesh as pictures from all sides, for what is a few pixels large.

The views are those of a grid over the octahedral map, or its upper half, and a picture mixes the three nearest,
each shifted by its depth: octahedral impostors (Brucks, Shaderbits 2018). `bake_imposter` makes one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np

from nanite_rs import _advice, _checks
from nanite_rs._imposters import bake, files, octahedron, texels
from nanite_rs._imposters.picture import drawn
from nanite_rs.assets import LoadedScene
from nanite_rs.camera import Camera, OrthographicCamera
from nanite_rs.exceptions import ArgumentError, DtypeError
from nanite_rs.mesh import NaniteMesh
from nanite_rs.scene import Scene
from nanite_rs.skinned_mesh import SkinnedMesh
from nanite_rs.swaying_mesh import SwayingMesh
from nanite_rs.triangle_mesh import TriangleMesh

if TYPE_CHECKING:
    import os

    from numpy.typing import ArrayLike, NDArray

    from nanite_rs._imposters.bake import Layers

__all__ = ["Imposter", "ImposterPicture", "bake_imposter"]

LayerName: TypeAlias = Literal["base_color", "normal", "depth", "orm"]


@dataclass(frozen=True, eq=False)
class ImposterPicture:
    """What a camera sees of an imposter. Made by `Imposter.picture`; row 0 is on top."""

    alpha: NDArray[np.float32]
    """Coverage, (H, W) float32, 0 to 1; where it is 0, all else is 0."""
    base_color: NDArray[np.float32]
    """Base colour, (H, W, 3) float32, linear, not multiplied by alpha."""
    normal: NDArray[np.float32]
    """Unit normals in the space of the mesh, (H, W, 3) float32."""
    depth: NDArray[np.float32]
    """Distance along the view axis, (H, W) float32 in units of the mesh."""
    orm: NDArray[np.float32]
    """Occlusion, roughness and metallic, (H, W, 3) float32."""


class Imposter:
    """Pictures of a mesh from the directions of a grid. Made by `bake_imposter` and `Imposter.open`.

    The sphere around the mesh has its middle at `center` and the `radius`. Each view is an orthographic picture of
    it, two radii wide, from the direction of `directions` towards the centre.
    """

    __slots__ = ("_center", "_full", "_layers", "_radius", "_up")

    def __init__(
        self,
        layers: Layers,
        center: NDArray[np.float64],
        radius: float,
        full_sphere: bool,
        up: Literal["y", "z"],
    ) -> None:
        self._layers = layers
        self._center, self._radius, self._full, self._up = center, radius, full_sphere, up

    @property
    def views(self) -> int:
        """Views along each side of the grid."""
        return int(self._layers["depth"].shape[0])

    @property
    def size(self) -> int:
        """Texels along each side of a view."""
        return int(self._layers["depth"].shape[2])

    @property
    def full_sphere(self) -> bool:
        """Whether views are from all directions; otherwise from above the horizon."""
        return self._full

    @property
    def up(self) -> Literal["y", "z"]:
        """The axis of the mesh that points up."""
        return self._up

    @property
    def center(self) -> NDArray[np.float64]:
        """Middle of the sphere, (3,) float64, in the space of the mesh."""
        return self._center.copy()

    @property
    def radius(self) -> float:
        """Radius of the sphere, units of the mesh."""
        return self._radius

    @property
    def nbytes(self) -> int:
        """Bytes of all texels: 12 for each."""
        return sum(layer.nbytes for layer in self._layers.values())

    @property
    def directions(self) -> NDArray[np.float64]:
        """Unit vectors from the centre towards the viewers, (views, views, 3) float64, in the space of the mesh.

        Row i, column j has the place (u, v) = (2j, 2i) / (views − 1) − 1 of the octahedral map of which u and v run
        along Z and X where Y is up, along X and Y where Z is; of the upper half that map turned by 45°.
        """
        grid = octahedron.grid(self.views, full=self._full)
        return np.asarray(grid @ octahedron.AXES[self._up])

    @property
    def camera(self) -> OrthographicCamera:
        """The camera of the views: of the width and height of the sphere, from two radii away."""
        return OrthographicCamera(self._radius, self._radius, znear=self._radius / 2.0)

    def pose(self, direction: ArrayLike) -> NDArray[np.float64]:
        """Return the pose of `camera`, (4, 4) float64, two radii from the centre in a direction of any length.

        Up in its picture is the axis `up`; from straight above and below the next one, X of Y and Y of Z.

        Raises
        ------
        ArgumentError, DtypeError
            The direction is not three finite numbers, or is 0.
        """
        toward = _checks.numbers(direction, (3,), "direction")
        if not toward.any():
            raise ArgumentError("direction: must not be 0")
        toward = toward / np.abs(toward).max()
        frame = octahedron.frame(toward / np.linalg.norm(toward), octahedron.AXES[self._up])
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = frame.T, self._center + 2.0 * self._radius * frame[2]
        return pose

    def layer(self, name: LayerName) -> NDArray[np.uint8] | NDArray[np.uint16]:
        """Return a layer of all views, (views, views, size, size[, channels]), a copy; row 0 of a view is on top.

        Parameters
        ----------
        name : str
            ``"base_color"``, (…, 4) uint8: sRGB, and coverage as alpha, not multiplied; ``"normal"``, (…, 3) uint8:
            in the space of the mesh, −1 to 1 as 0 to 255; ``"depth"``, (…) uint16: how far behind the plane that
            touches the sphere in front, 0 to 2 radii as 0 to 65,535, so that the middle is 1 radius; ``"orm"``,
            (…, 3) uint8: occlusion, roughness, metallic.

        Raises
        ------
        ArgumentError
            For another name.

        Examples
        --------
        >>> ball = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=500))
        >>> nrs.bake_imposter(ball, views=3, size=16).layer("depth").shape
        (3, 3, 16, 16)
        """
        return self._layers[_checks.choice(name, "name", tuple(texels.LAYERS))].copy()

    def atlas(self, name: LayerName) -> NDArray[np.uint8] | NDArray[np.uint16]:
        """Return a layer as one picture, (views · size, views · size[, channels]), as `save` writes it.

        Parameters
        ----------
        name : str
            As for `layer`.

        Raises
        ------
        ArgumentError
            For another name.
        """
        picture: NDArray[np.uint8] | NDArray[np.uint16] = files.atlas(self.layer(name))
        return picture

    def picture(
        self, camera: Camera, pose: ArrayLike, width: int, height: int, *, iterations: int = 2
    ) -> ImposterPicture:
        """Return what a camera sees of the imposter, standing where the mesh stood.

        The three views around the direction of the camera are mixed by barycentric coordinates in the grid. A ray
        looks up the depth of a view where it meets the plane through the centre, goes on to where it is at that
        depth, and so on. Texels are filtered bilinearly, from the mip level whose texels are no larger than pixels.
        What none of the three shows is missing: some of the outline, the more the fewer the views. Those of the
        upper half say nothing of what is seen from far below the horizon; straight from below nothing is shown.

        Parameters
        ----------
        camera : PerspectiveCamera, IntrinsicsCamera or OrthographicCamera
            How to project it.
        pose : (4, 4) array
            Camera-to-world matrix, as for `Renderer.render`.
        width, height : int
            Pixels.
        iterations : int
            How often a ray is shifted by depth, 0 to 16; 0 for pictures on planes through the centre.

        Raises
        ------
        ArgumentError, DtypeError
            For a value out of range, a pose that is not finite or not rigid, or a perspective camera inside of the
            sphere.

        Examples
        --------
        >>> ball = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=2_000))
        >>> imposter = nrs.bake_imposter(ball, views=6, size=32)
        >>> picture = imposter.picture(imposter.camera, imposter.pose((1, 2, 3)), 32, 32)
        >>> picture.alpha.shape, abs(float(picture.depth[16, 16]) - 1.0) < 0.1
        ((32, 32), True)
        """
        if not isinstance(camera, Camera):
            raise DtypeError(f"camera: expected a camera of nanite_rs, not {type(camera).__name__}")
        sides = (
            _checks.whole(width, "width", 1, files.LARGEST),
            _checks.whole(height, "height", 1, files.LARGEST),
        )
        matrix = _checks.numbers(pose, (4, 4), "pose")
        turn = matrix[:3, :3]
        if not np.allclose(turn @ turn.T, np.eye(3), atol=0.01) or not np.array_equal(
            matrix[3], (0, 0, 0, 1)
        ):
            raise ArgumentError("pose: expected the matrix of a rotation and a translation")
        if not isinstance(camera, OrthographicCamera):
            away = float(np.linalg.norm(matrix[:3, 3] - self._center))
            if not away > self._radius:
                raise ArgumentError(
                    f"pose: {away:g} from the centre is inside of the sphere of {self._radius:g}"
                )
        times = _checks.whole(iterations, "iterations", 0, 16)
        found = drawn(self, camera, matrix, *sides, times)
        return ImposterPicture(
            alpha=found[..., texels.ALPHA].copy(),
            base_color=found[..., texels.COLOR].copy(),
            normal=found[..., texels.NORMAL].copy(),
            depth=found[..., texels.DEPTH].copy(),
            orm=found[..., texels.ORM].copy(),
        )

    def save(self, folder: str | os.PathLike[str]) -> None:
        """Write PNG files of all layers, and ``imposter.json``, which says what they mean.

        Depths have 16 bits, all else 8; nothing is lost. The folder is made; files of these names are replaced.

        Raises
        ------
        FileError
            The folder cannot be written.

        Examples
        --------
        >>> ball = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=500))
        >>> imposter = nrs.bake_imposter(ball, views=3, size=16)
        >>> imposter.save("ball_imposter")
        >>> back = nrs.Imposter.open("ball_imposter")
        >>> np.array_equal(back.atlas("depth"), imposter.atlas("depth"))
        True
        """
        files.save(self, _checks.path_of(folder, "folder"))

    @classmethod
    def open(cls, folder: str | os.PathLike[str]) -> Imposter:
        """Read what `save` wrote into ``folder``.

        Raises
        ------
        MissingFileError, FileError
            A file is not there, or cannot be read.
        FormatError
            A file is not what it should be; the message names it.
        """
        layers, known = files.opened(_checks.path_of(folder, "folder"))
        center = np.array(known["center"], np.float64)
        return cls(layers, center, float(known["radius"]), known["full_sphere"], known["up"])

    def __repr__(self) -> str:
        part = "sphere" if self._full else "upper half"
        return f"<Imposter {self.views} × {self.views} views of the {part}, {self.size} × {self.size} texels each>"

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle all layers."""
        return Imposter, (self._layers, self._center, self._radius, self._full, self._up)


def bake_imposter(
    mesh: NaniteMesh | TriangleMesh | SkinnedMesh | SwayingMesh | Scene | LoadedScene,
    *,
    views: int = 12,
    size: int = 128,
    full_sphere: bool = True,
    up: Literal["y", "z"] = "y",
    backend: Literal["auto", "cpu", "gpu"] = "cpu",
) -> Imposter:
    """Bake pictures of a mesh from all sides: base colour, coverage, normals, depth, and how it reflects.

    Views are drawn by `Renderer` at full detail, 16 samples to a texel, with the mesh's own materials, without
    light. A texel has the means of its samples that are covered. Around what is covered, texels go on as their
    neighbours, so that filters mix in nothing foreign. Where materials blend, there is a hole where alpha is below
    0.5; emitted light is left out.

    The same input gives the same bytes on the CPU backend. The guide on imposters says where they are nearer to the
    mesh than a cut is, and where not.

    Parameters
    ----------
    mesh : NaniteMesh, TriangleMesh, SkinnedMesh, SwayingMesh, Scene or LoadedScene
        What to bake: a mesh, or all visible instances of a scene in the space of the world, as they stand.
    views : int
        Views along each side of the grid, 3 or more; their square is baked.
    size : int
        Texels along each side of a view, a power of two from 4 on. Images have ``views · size`` a side, 8,192 at
        most.
    full_sphere : bool
        Views from all directions; False for those from above the horizon, twice as dense, as of trees.
    up : str
        Which axis points up: ``"y"`` or ``"z"``.
    backend : str
        What draws, as for `Renderer`.

    Returns
    -------
    Imposter

    Raises
    ------
    ArgumentError, DtypeError
        For a value out of range, or a scene with points or lines.
    MeshError
        There is nothing to see, or nothing with an extent.
    BackendError
        As `Renderer` does.

    Examples
    --------
    >>> tree = nrs.NaniteMesh.from_arrays(*nrs.shapes.foliage(faces=2_000))
    >>> imposter = nrs.bake_imposter(tree, views=4, size=32, full_sphere=False)
    >>> imposter
    <Imposter 4 × 4 views of the upper half, 32 × 32 texels each>
    >>> imposter.atlas("base_color").shape, imposter.nbytes
    ((128, 128, 4), 196608)
    """
    count = _checks.whole(views, "views", files.LEAST_VIEWS)
    side = _checks.whole(size, "size", files.LEAST_SIZE)
    if side.bit_count() != 1:
        raise ArgumentError(
            f"size: must be a power of two, so that mip levels of views do not mix, not {size}"
        )
    if count * side > files.LARGEST:
        raise ArgumentError(
            f"size: {count} views of {side} texels make images of {count * side}; the most is {files.LARGEST}"
        )
    full = _checks.truth(full_sphere, "full_sphere")
    axis: Any = _checks.choice(up, "up", tuple(octahedron.AXES))
    nodes = [node for node in _scene(mesh).instances if node.visible]
    center, radius = bake.sphere(nodes)
    scene = bake.normalized(nodes, center, radius)
    layers = bake.baked(scene, views=count, size=side, full=full, up=axis, backend=backend)
    return Imposter(layers, center, radius, full, axis)


def _scene(mesh: object) -> Scene:
    if isinstance(mesh, LoadedScene):
        return mesh.scene
    if isinstance(mesh, Scene):
        return mesh
    if not isinstance(mesh, NaniteMesh | TriangleMesh | SkinnedMesh | SwayingMesh):
        raise DtypeError(f"mesh: expected a mesh or a Scene, not {_advice.name_of_type(mesh)}")
    scene = Scene()
    scene.add(mesh)
    return scene
