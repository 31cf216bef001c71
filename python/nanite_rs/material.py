"""Materials: how surfaces look."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, get_args

import numpy as np

from nanite_rs import _advice, _checks
from nanite_rs.exceptions import ArgumentError, DtypeError
from nanite_rs.texture import Texture

if TYPE_CHECKING:
    from collections.abc import Sequence

    from nanite_rs._checks import Color

__all__ = ["Material"]

AlphaMode: TypeAlias = Literal["opaque", "mask", "blend"]


@_advice.teaching
@dataclass(frozen=True)
class Material:
    """A metallic-roughness material as in glTF: factors, linear, and textures that multiply them.

    What is not given is as pyrender has it for meshes without a material, so that ``Material()`` looks as there.

    An instance has one for its whole mesh, or one for each number of the mesh's ``face_materials``; another one can
    be assigned at any time without building anything anew. A scene without textures pays nothing for them.

    Raises
    ------
    ArgumentError, DtypeError
        For a value out of range or of another type, when the material is made.

    Examples
    --------
    >>> clay = nrs.Material(base_color=(0.7, 0.65, 0.6), metallic=0.1, roughness=0.5)
    >>> bricks = nrs.Texture(np.random.default_rng(0).integers(0, 255, (64, 64, 3)).astype(np.uint8))
    >>> wall = nrs.Material(base_color=(1, 1, 1), base_color_texture=bricks)
    """

    base_color: Color = (0.3, 0.3, 0.3)
    """Linear RGB, 0 to 1; a fourth number is alpha."""
    metallic: float = 0.2
    """0 dielectric to 1 metal."""
    roughness: float = 0.8
    """Perceptual roughness, 0 to 1; below 0.04 it is shaded as 0.04."""
    emissive: Color = (0.0, 0.0, 0.0)
    """Emitted light, linear RGB; ``shading="pyrender"`` multiplies by it twice, as pyrender does."""
    double_sided: bool = False
    """Draw back faces too."""
    smooth: bool = True
    """Shade with interpolated vertex normals; otherwise every face is flat."""
    unlit: bool = False
    """Show the base colour, textures and vertex colours included, whatever the light (``KHR_materials_unlit``)."""
    base_color_texture: Texture | None = None
    """Times the base colour, and its alpha times alpha; sRGB."""
    metallic_roughness_texture: Texture | None = None
    """Roughness in green, metallic in blue, times the factors."""
    normal_texture: Texture | None = None
    """Normals in tangent space, 0 to 1 for -1 to 1: +X along u, +Y along v, +Z off the surface. Tangents follow
    from the UVs."""
    occlusion_texture: Texture | None = None
    """In red, how much of the light from everywhere arrives."""
    emissive_texture: Texture | None = None
    """Multiplies the emitted light; sRGB."""
    normal_scale: float = 1.0
    """Times X and Y of the normal texture."""
    occlusion_strength: float = 1.0
    """0 for no occlusion to 1 for all that the texture says."""
    alpha_mode: AlphaMode = "opaque"
    """What alpha does: nothing; surfaces have holes where it is below the cutoff; or what is behind them shows
    through as far as alpha, that of the texture and that of vertex colours leave it. Blended surfaces are
    composited in linear light, ordered by depth, up to ``max_layers`` of `Renderer.render`. They cast no shadows.
    Where alpha is below 1/255, nothing is drawn."""
    alpha_cutoff: float = 0.5
    """With ``"mask"``: where alpha is below it, there is a hole."""
    name: str = field(default="", compare=False)
    """What files and messages call it; nothing that is seen, so materials of other names may be equal."""

    def __post_init__(self) -> None:
        if not isinstance(self.name, str):
            raise DtypeError(f"name: expected a string, not {_advice.name_of_type(self.name)}")
        base = np.asarray(self.base_color, np.float64) if np.ndim(self.base_color) == 1 else None
        alpha = (float(base[3]),) if base is not None and base.shape == (4,) and base[3] != 1.0 else ()
        color = _checks.rgb(self.base_color, "base_color")
        try:
            for one in color:
                _checks.unit(one, "base_color")
        except ArgumentError as error:
            raise _advice.advised(error, "divide colours of 0 to 255 by 255") from None
        for one in alpha:
            _checks.unit(one, "alpha")
        object.__setattr__(self, "base_color", color + alpha)
        object.__setattr__(self, "emissive", _checks.bright(self.emissive, "emissive"))
        for one in self.emissive:
            _checks.not_negative(one, "emissive")
        for name, check in _NUMBERS.items():
            object.__setattr__(self, name, check(getattr(self, name), name))
        _checks.choice(self.alpha_mode, "alpha_mode", get_args(AlphaMode))
        for name in _SLOTS:
            texture = getattr(self, name)
            if not (texture is None or isinstance(texture, Texture)):
                wrong = DtypeError(f"{name}: expected a Texture, not {type(texture).__name__}")
                raise _advice.advised(wrong, _advice.for_texture(texture))

    def _raw(self) -> dict[str, Any]:
        textures = [getattr(self, name) for name in _SLOTS]
        return {
            "base_color": (*_checks.rgb(self.base_color, "base_color"), *self.base_color[3:], 1.0)[:4],
            "metallic": self.metallic,
            "roughness": self.roughness,
            "emissive": _checks.rgb(self.emissive, "emissive"),
            "double_sided": bool(self.double_sided),
            "smooth": bool(self.smooth),
            "unlit": bool(self.unlit),
            "normal_scale": self.normal_scale,
            "occlusion_strength": self.occlusion_strength,
            "alpha_cutoff": {"opaque": None, "mask": self.alpha_cutoff, "blend": _VISIBLE}[self.alpha_mode],
            "blends": self.alpha_mode == "blend",
            "textures": [
                None if texture is None else texture._raw(name in _COLORS)
                for name, texture in zip(_SLOTS, textures, strict=True)
            ],
        }

    def _ignores_alpha(self) -> bool:
        """Whether it has alpha that says nothing."""
        return self.alpha_mode == "opaque" and len(self.base_color) == 4


# The least alpha of what is drawn of transparent surfaces: a step of eight bits.
_VISIBLE = 1.0 / 255.0


def default_material(*, colored: bool) -> Material:
    """The look of a mesh that nothing is said of, as pyrender has it: white times the colours of vertices."""
    return Material(base_color=(1.0, 1.0, 1.0)) if colored else Material()


_NUMBERS = {
    "metallic": _checks.unit,
    "roughness": _checks.unit,
    "normal_scale": _checks.finite,
    "occlusion_strength": _checks.unit,
    "alpha_cutoff": _checks.finite,
}
_SLOTS = (
    "base_color_texture",
    "metallic_roughness_texture",
    "normal_texture",
    "occlusion_texture",
    "emissive_texture",
)
_COLORS = ("base_color_texture", "emissive_texture")


Look: TypeAlias = "Material | Sequence[Material]"


def several(material: Look, name: str) -> tuple[Material, ...]:
    """One or several as a tuple; ``name`` is the argument's."""
    if isinstance(material, Texture):
        raise DtypeError(
            f"{name}: expected a Material, not Texture; give Material(base_color_texture=texture)"
        )
    if isinstance(material, Material):
        return (material,)
    try:
        materials = tuple(material)
    except TypeError:
        raise DtypeError(
            f"{name}: expected a Material or a sequence of them, not {_advice.name_of_type(material)}"
        ) from None
    for number, one in enumerate(materials):
        if not isinstance(one, Material):
            raise DtypeError(
                f"{name}: expected a Material, not {type(one).__name__}, as number {number}; "
                "a colour goes into Material(base_color=...)"
            )
    return materials


def raw_materials(material: Look) -> list[dict[str, Any]]:
    """One or several, as Rust takes them."""
    materials = several(material, "material")
    if not materials:
        raise ArgumentError("material: expected one at least, found an empty sequence")
    return [one._raw() for one in materials]
