"""Lights, and environment maps."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from nanite_rs import _advice, _checks, _core
from nanite_rs._checks import Color, Rgb
from nanite_rs.exceptions import ArgumentError, DtypeError, UsageWarning
from nanite_rs.texture import Image

__all__ = ["DirectionalLight", "Environment", "PointLight", "SpotLight"]

RawLight: TypeAlias = tuple[str, Rgb, float, float | None, tuple[float, float] | None, tuple[bool, float]]


class _Shining(ABC):
    """Base of the lights: parameters are checked when one is made."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "color", _checks.bright(vars(self)["color"], "color"))
        try:
            _core.check_light(self._raw())
        except ArgumentError as error:
            name = str(error).partition(":")[0]
            angle = vars(self)[name] if name.lower().endswith("angle") else 0.0
            degrees = not isinstance(error, DtypeError) and angle > np.pi
            more = f"give degrees as np.radians({angle:g})" if degrees else ""
            raise _advice.advised(error, more) from None

    @abstractmethod
    def _raw(self) -> RawLight:
        """As Rust takes it."""

    def _color(self) -> tuple[Rgb, float]:
        return _checks.rgb(vars(self)["color"], "color"), _checks.number(vars(self)["intensity"], "intensity")

    def _range(self) -> float | None:
        reach = vars(self)["range"]
        return None if reach is None else _checks.number(reach, "range")

    def _shadows(self) -> tuple[bool, float]:
        return bool(vars(self)["casts_shadows"]), _checks.number(vars(self)["radius"], "radius")


@_advice.teaching
@dataclass(frozen=True)
class DirectionalLight(_Shining):
    """Light along the −Z of its pose, the same everywhere.

    Raises
    ------
    ArgumentError, DtypeError
        For a value out of range or of another type, when the light is made.

    Examples
    --------
    >>> light = nrs.DirectionalLight(color=(1.0, 1.0, 1.0), intensity=3.0)
    """

    color: Color = (1.0, 1.0, 1.0)
    """Linear RGB."""
    intensity: float = 1.0
    """Lux."""
    casts_shadows: bool = field(default=True, kw_only=True)
    """What is in its way casts shadows, with ``render(shadows=True)``."""
    angle: float = field(default=0.0, kw_only=True)
    """Angle that it is seen at, from side to side, radians, at most π/2: its shadows are soft. The sun's is 0.0093
    (0.53°); 0 is sharp. Highlights do not know it."""

    def _raw(self) -> RawLight:
        angle = _checks.number(self.angle, "angle")
        if not 0.0 <= angle <= np.pi / 2:
            raise ArgumentError(f"angle: must be from 0 to π/2, not {angle:g}")
        # At distance 1 it has this radius.
        shadows = bool(self.casts_shadows), math.tan(0.5 * angle)
        return "directional", *self._color(), None, None, shadows


@_advice.teaching
@dataclass(frozen=True)
class PointLight(_Shining):
    """Light from the origin of its pose, falling off with the square of the distance.

    Raises
    ------
    ArgumentError, DtypeError
        For a value out of range or of another type, when the light is made.

    Examples
    --------
    >>> light = nrs.PointLight(intensity=20.0)
    """

    color: Color = (1.0, 1.0, 1.0)
    """Linear RGB."""
    intensity: float = 1.0
    """Candela."""
    range: float | None = None
    """Distance at which the light has smoothly ended (glTF's window); ``None`` never. pyrender ignores it."""
    casts_shadows: bool = field(default=True, kw_only=True)
    """What is in its way casts shadows, with ``render(shadows=True)``."""
    radius: float = field(default=0.0, kw_only=True)
    """Radius of what shines, in the world: its shadows are soft. 0 is sharp. Highlights do not know it."""

    def _raw(self) -> RawLight:
        return "point", *self._color(), self._range(), None, self._shadows()


@_advice.teaching
@dataclass(frozen=True)
class SpotLight(_Shining):
    """Light from the origin of its pose along its −Z, within a cone; otherwise as a `PointLight`.

    From the inner to the outer angle it falls off with the square of what is left of the cosine, as glTF's
    ``KHR_lights_punctual`` and pyrender have it.

    Raises
    ------
    ArgumentError, DtypeError
        For a value out of range or of another type, when the light is made.

    Examples
    --------
    >>> lamp = nrs.SpotLight(intensity=20.0, innerConeAngle=0.2, outerConeAngle=0.4)
    """

    color: Color = (1.0, 1.0, 1.0)
    """Linear RGB."""
    intensity: float = 1.0
    """Candela."""
    range: float | None = None
    """Distance at which the light has smoothly ended (glTF's window); ``None`` never. pyrender ignores it."""
    innerConeAngle: float = 0.0  # noqa: N815  pyrender's and glTF's name
    """Angle from the axis, radians, up to which nothing is lost; below the outer one."""
    outerConeAngle: float = float(np.pi / 4.0)  # noqa: N815
    """Angle from the axis, radians, from which on there is no light; above 0, at most π/2."""
    casts_shadows: bool = field(default=True, kw_only=True)
    """What is in its way casts shadows, with ``render(shadows=True)``."""
    radius: float = field(default=0.0, kw_only=True)
    """Radius of what shines, in the world: its shadows are soft. 0 is sharp. Highlights do not know it."""

    def _raw(self) -> RawLight:
        inner = _checks.number(self.innerConeAngle, "innerConeAngle")
        outer = _checks.number(self.outerConeAngle, "outerConeAngle")
        return "spot", *self._color(), self._range(), (inner, outer), self._shadows()


Light: TypeAlias = DirectionalLight | PointLight | SpotLight


@_advice.teaching
@dataclass(frozen=True)
class Environment:
    """An environment map, equirectangular, for image-based lighting: ``shading="gltf"`` alone knows it.

    Rows go from +Y down to −Y. The middle of the map is +X; to its right follow +Z, then, at both edges, −X, then
    −Z. What surfaces of each roughness see of it is worked out once for an `Image`, when an environment of it is
    first given to a scene; others of the same image with another intensity or rotation cost nothing.

    Examples
    --------
    >>> sky = np.linspace([0.5, 0.7, 1.0], [0.2, 0.15, 0.1], 32)[:, None] * np.ones((1, 64, 1))
    >>> scene = nrs.Scene(environment=nrs.Environment(sky, intensity=0.8, background=True))
    """

    image: Image
    """The map, twice as wide as high: linear light that may exceed 1 where it holds floats, else sRGB. A path is
    read by `Image.open`, an array makes one."""
    intensity: float = field(default=1.0, kw_only=True)
    """Times its light."""
    rotation: float = field(default=0.0, kw_only=True)
    """Turns it about +Y, radians, counter-clockwise as seen from above: by π/2, what was at +X is at −Z."""
    background: bool = field(default=False, kw_only=True)
    """Show it where nothing is in front of it, in place of ``Scene.bg_color``; as sharp as 512 rows are."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "image", Image._of(self.image))
        for name, value in (("intensity", self.intensity), ("rotation", self.rotation)):
            if not isinstance(value, int | float | np.integer | np.floating):
                raise DtypeError(f"{name}: expected a number, not {value!r}")
            object.__setattr__(self, name, float(value))
        if math.tau < abs(self.rotation) <= 360.0 and self.rotation.is_integer():
            _advice.warn(
                f"rotation: {self.rotation:g} looks like degrees; it is in radians: np.radians({self.rotation:g})",
                UsageWarning,
            )

    def _raw(self) -> tuple[_core.EnvironmentMap, float, float, bool]:
        return self.image._environment(), self.intensity, self.rotation, bool(self.background)
