"""What moves in a scene of a file: nodes, joints that bend surfaces, and morph targets, at any time.

glTF 2.0, sections 3.7 and 3.11: keys are stepped, interpolated along lines (rotations along arcs) or by cubic
Hermite splines, and held before the first and after the last of them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias

import numpy as np

from nanite_rs import _core

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

__all__ = ["MIRROR", "REST", "Animation", "Bend", "Rig", "Skin", "Stance", "Track", "placed"]

Interpolation: TypeAlias = Literal["STEP", "LINEAR", "CUBICSPLINE"]
Path: TypeAlias = Literal["translation", "rotation", "scale", "weights"]

REST: Final = {
    "translation": (0.0, 0.0, 0.0),
    "rotation": (0.0, 0.0, 0.0, 1.0),
    "scale": (1.0, 1.0, 1.0),
}
"""What places a node, and the values of one that says nothing."""

MIRROR: Final = np.diag((-1.0, 1.0, 1.0, 1.0))
"""Where a skin lies whose node mirrors, about the world."""

# Quaternions whose arc is shorter are blended along the chord: the sine of the angle would have no digits left.
_SHORT_ARC: Final = 1.0 - 1e-6


def placed(
    translation: NDArray[np.float64], rotation: NDArray[np.float64], scale: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Matrix of a scale, then a rotation by a quaternion (x, y, z, w) of any length, then a translation."""
    length = float(np.linalg.norm(rotation))
    x, y, z, w = rotation / length if length > 0.0 else (0.0, 0.0, 0.0, 1.0)
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn * scale, translation
    return pose


def _arc(a: NDArray[np.float64], b: NDArray[np.float64], t: float) -> NDArray[np.float64]:
    """Between two rotations along the shorter arc (Shoemake, "Animating Rotation with Quaternion Curves", 1985)."""
    cosine = float(np.dot(a, b))
    if cosine < 0.0:
        b, cosine = -b, -cosine
    if cosine > _SHORT_ARC:
        return a + t * (b - a)
    angle = np.arccos(cosine)
    mixed: NDArray[np.float64] = (np.sin((1.0 - t) * angle) * a + np.sin(t * angle) * b) / np.sin(angle)
    return mixed


@dataclass(frozen=True)
class Track:
    """Keys of one property of one node."""

    node: int
    path: Path
    times: NDArray[np.float64]
    """Seconds, ascending: (K,)."""
    values: NDArray[np.float64]
    """(K, C); of splines (K, 3, C): the tangent before, the value, and the tangent behind."""
    interpolation: Interpolation

    def at(self, time: float) -> NDArray[np.float64]:
        """The property at a time."""
        times, values = self.times, self.values
        spline = self.interpolation == "CUBICSPLINE"
        points = values[:, 1] if spline else values
        after = int(np.searchsorted(times, time, side="right"))
        if after == 0 or after == len(times):
            held: NDArray[np.float64] = points[min(after, len(times) - 1)]
            return held
        before = after - 1
        if self.interpolation == "STEP":
            return points[before]  # type: ignore[no-any-return]
        span = times[after] - times[before]
        t = float((time - times[before]) / span)
        a, b = points[before], points[after]
        if spline:
            leaving, arriving = span * values[before, 2], span * values[after, 0]
            weights = 2 * t**3 - 3 * t**2 + 1, t**3 - 2 * t**2 + t, 3 * t**2 - 2 * t**3, t**3 - t**2
            bent: NDArray[np.float64] = (
                weights[0] * a + weights[1] * leaving + weights[2] * b + weights[3] * arriving
            )
            return bent
        if self.path == "rotation":
            return _arc(a, b, t)
        return (1.0 - t) * a + t * b  # type: ignore[no-any-return]


@dataclass(frozen=True, repr=False)
class Animation:
    """A motion that a file has for its nodes and surfaces; see `LoadedScene.set_time`."""

    name: str
    """Its name, or its number if it has none."""
    duration: float
    """Seconds from 0 to its last key."""
    _tracks: tuple[Track, ...] = field(repr=False)

    def __repr__(self) -> str:
        return f"<Animation {self.name!r}: {self.duration:g} s>"


@dataclass(frozen=True)
class Skin:
    """Joints, and what maps from where the surface was bound to each of them, (J, 4, 4)."""

    joints: NDArray[np.int64]
    inverse: NDArray[np.float64]


@dataclass(frozen=True)
class Stance:
    """Where everything is: matrices of nodes to the world, (N, 4, 4), and weights of morph targets by node."""

    nodes: NDArray[np.float64]
    weights: dict[int, NDArray[np.float64]]


@dataclass
class Bend:
    """A surface whose shape follows joints and the weights of morph targets."""

    node: int
    """Whose weights count, and whose place where there is no skin."""
    vertices: NDArray[np.float32]
    normals: NDArray[np.float32] | None
    targets: list[dict[str, NDArray[np.float32]]]
    """Of each morph target what it adds to POSITION and NORMAL."""
    skin: Skin | None = None
    joints: NDArray[np.uint32] | None = None
    """Rows of the skin's joints that act on each vertex, (N, K)."""
    weights: NDArray[np.float32] | None = None
    mirrored: bool = False
    """With a skin: it lies in a mirrored world (`MIRROR`), so that mirrored joints do not turn its faces over."""

    def at(self, stance: Stance) -> tuple[NDArray[Any], NDArray[np.float32] | None]:
        """Vertices and normals: with a skin in the world or the mirrored one, without one about the node."""
        vertices, normals = self.vertices, self.normals
        for weight, target in zip(stance.weights.get(self.node, ()), self.targets, strict=False):
            if weight:
                part = np.float32(weight)
                if "POSITION" in target:
                    vertices = vertices + part * target["POSITION"]
                if normals is not None and "NORMAL" in target:
                    normals = normals + part * target["NORMAL"]
        if self.skin is None or self.joints is None or self.weights is None:
            return vertices, normals
        return _core.skinned(
            vertices,
            normals,
            self.joints.reshape(-1),
            self.weights.reshape(-1),
            np.ascontiguousarray(self.matrices(stance)[:, :3]).reshape(-1, 4),
        )

    @property
    def follows_joints(self) -> bool:
        """Whether joints alone bend it, as they may a `SkinnedMesh`."""
        return self.joints is not None and self.joints.size > 0 and not self.targets

    def matrices(self, stance: Stance) -> NDArray[np.float64]:
        """Where the joints take space: (J, 4, 4); none without a skin."""
        if self.skin is None:
            return np.empty((0, 4, 4))
        matrices: NDArray[np.float64] = stance.nodes[self.skin.joints] @ self.skin.inverse
        return MIRROR @ matrices if self.mirrored else matrices


@dataclass
class Rig:
    """The nodes of a file, and what moves them."""

    first: NDArray[np.float64]
    """Of what is above the roots."""
    parents: list[int]
    """−1 for roots."""
    order: list[int]
    """Parents before their children."""
    local: dict[str, NDArray[np.float64]]
    """At rest: translations, rotations and scales of all nodes."""
    matrices: dict[int, NDArray[np.float64]]
    """Of nodes that have one instead."""
    weights: dict[int, NDArray[np.float64]]
    """Of morph targets, by node."""
    animations: list[Animation] = field(default_factory=list)

    def stance(self, animation: Animation | None = None, time: float = 0.0) -> Stance:
        """Where everything is at a time; without an animation at rest."""
        local, matrices = {path: values.copy() for path, values in self.local.items()}, dict(self.matrices)
        weights = dict(self.weights)
        for track in animation._tracks if animation is not None else ():
            value = track.at(time)
            if track.path == "weights":
                weights[track.node] = value
            else:
                matrices.pop(track.node, None)
                local[track.path][track.node] = value
        nodes = np.empty((len(self.parents), 4, 4))
        for node in self.order:
            own = matrices.get(node)
            if own is None:
                own = placed(*(local[path][node] for path in REST))
            parent = self.parents[node]
            nodes[node] = (self.first if parent < 0 else nodes[parent]) @ own
        return Stance(nodes, weights)

    def moved_by(self, animations: Sequence[Animation]) -> set[int]:
        """Nodes that animations move: those that have tracks, and all below them."""
        moved = {track.node for own in animations for track in own._tracks if track.path != "weights"}
        for node in self.order:
            if self.parents[node] in moved:
                moved.add(node)
        return moved
