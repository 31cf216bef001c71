"""Images of materials, and how they lie on a surface."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, get_args

import numpy as np

from nanite_rs import _advice, _checks, _core
from nanite_rs._images import read_bytes, read_image
from nanite_rs.exceptions import ArgumentError, DtypeError, UsageWarning

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike, NDArray

__all__ = ["Image", "Texture"]

Wrap: TypeAlias = Literal["repeat", "mirror", "clamp"]
Filter: TypeAlias = Literal["linear", "nearest"]

_DTYPES = ("uint8", "uint16", "float16", "float32", "float64")


class Image:
    """A picture that textures show. Textures that share an `Image` share its memory.

    Whether its numbers are sRGB or linear follows from what a material uses it for, as in glTF: of colours 8-bit
    and 16-bit numbers are sRGB; everything else, and all floats, are linear. Smaller versions for the distance are
    made in linear light when it is first used. 16-bit numbers and floats are kept as halves, 11 bits of precision.

    Parameters
    ----------
    pixels : (H, W) or (H, W, C) array
        Rows from the top; grey, grey and alpha, RGB or RGBA; uint8, uint16 or floats. Integers stand for 0 to 1.
        It is copied.

    Raises
    ------
    DtypeError
        If it is of another type.
    ArgumentError
        If its shape is no picture's, a side is 0, or a number is NaN or infinite; the message names the pixel.

    Examples
    --------
    >>> checker = nrs.Image(np.kron([[1, 0] * 4, [0, 1] * 4] * 4, np.ones((16, 16))).astype(np.uint8) * 255)
    >>> checker
    <Image 128 x 128, 1 channel, uint8>
    """

    __slots__ = ("_cores", "_decode", "_dtype", "_encoded", "_map", "_pixels", "_shape")

    def __init__(self, pixels: ArrayLike) -> None:
        if isinstance(pixels, str | os.PathLike):
            raise DtypeError(f"pixels: expected an array, not {pixels!r}; nanite_rs.Image.open reads files")
        array = np.asarray(pixels)
        if array.dtype.name not in _DTYPES:
            raise DtypeError(f"pixels: must be {', '.join(_DTYPES)}, not {array.dtype}")
        if array.ndim == 2:
            array = array[:, :, None]
        if array.ndim != 3 or not 1 <= array.shape[2] <= 4:
            raise ArgumentError(f"pixels: expected (H, W) or (H, W, 1 to 4), found shape {np.shape(pixels)}")
        if 0 in array.shape:
            raise ArgumentError(f"pixels: the image is empty, of shape {np.shape(pixels)}")
        if array.dtype.kind == "f":
            finite = np.isfinite(array)
            if not finite.all():
                row, column, channel = (int(k) for k in np.argwhere(~finite)[0])
                value = array[row, column, channel]
                raise ArgumentError(f"pixels: {value} at row {row}, column {column}, channel {channel}")
            array = array.astype(np.float32)
            if 16 < array.max() <= 255 and array.min() >= 0 and (array == np.rint(array)).all():
                _advice.warn(
                    "pixels: they look like 0 to 255; floats are 0 to 1: give pixels.astype(np.uint8)",
                    UsageWarning,
                )
        self._keep(np.array(array, order="C", copy=True), None)

    def _keep(self, pixels: NDArray[Any], file: bytes | None) -> None:
        """Be of these pixels, and the file that they were read from."""
        height, width, channels = pixels.shape
        self._begin((height, width, channels), pixels.dtype.name, lambda: file, lambda: pixels)
        self._look()

    def _begin(
        self,
        shape: tuple[int, int, int],
        dtype: str,
        encoded: Callable[[], bytes | None],
        decode: Callable[[], NDArray[Any]],
    ) -> None:
        self._shape, self._dtype, self._encoded, self._decode = shape, dtype, encoded, decode
        self._pixels: NDArray[Any] | None = None
        self._cores: dict[bool, _core.Image] = {}
        self._map: _core.EnvironmentMap | None = None

    def _look(self) -> NDArray[Any]:
        """Return the pixels, of which it keeps one array."""
        pixels = self._decode()
        pixels.flags.writeable = False
        self._pixels = pixels
        return pixels

    @classmethod
    def open(cls, path: str | os.PathLike[str]) -> Image:
        """Read a file: PNG, JPEG and the like by Pillow; HDR, EXR, TIFF and PNG of 16 bits by OpenImageIO.

        Parameters
        ----------
        path : path
            The file.

        Raises
        ------
        MissingFileError, FileError, FormatError, DependencyError
            Each names the file.
        """
        name = _checks.path_of(path)
        return cls._read(read_bytes(name), name)

    @classmethod
    def _read(cls, data: bytes, name: str) -> Image:
        """The content of a file, which is kept, so that files hold it unchanged."""
        image = _image(cls(read_image(data, name)).pixels, data)
        image._decode = lambda: cls(read_image(data, name)).pixels
        return image

    def _forget(self) -> None:
        """Keep the file alone, which is smaller; pixels are decoded again when they are looked at."""
        if self._encoded() is not None:
            self._pixels = None

    @classmethod
    def _later(
        cls,
        shape: tuple[int, int, int],
        dtype: str,
        encoded: Callable[[], bytes],
        decode: Callable[[], NDArray[Any]],
    ) -> Image:
        """An image of this shape and type that is read and decoded when it is looked at."""
        image = object.__new__(cls)
        image._begin(shape, dtype, encoded, decode)
        return image

    def encoded(self) -> bytes | None:
        """The file that it was read from, as it was; None of arrays.

        Raises
        ------
        FileError, AccessError, ServerError, ChangedFileError, FormatError
            It is in a ``.nanite`` file that cannot be read.
        """
        return self._encoded()

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the pixels, and the file that they came from."""
        return _image, (self.pixels, self.encoded())

    @classmethod
    def _of(cls, given: Image | ArrayLike | str | os.PathLike[str]) -> Image:
        """An image as it is, of an array, or of a file by its path."""
        if isinstance(given, Image):
            return given
        return cls.open(given) if isinstance(given, str | os.PathLike) else cls(given)

    @property
    def pixels(self) -> NDArray[Any]:
        """(H, W, C), read-only.

        Of the images of an opened mesh they are read when they are first asked for.

        Raises
        ------
        FileError, AccessError, ServerError, ChangedFileError, FormatError, DependencyError
            It is in a ``.nanite`` file that cannot be read, or damaged.
        """
        return self._look() if self._pixels is None else self._pixels

    @property
    def size(self) -> tuple[int, int]:
        """Width and height."""
        return self._shape[1], self._shape[0]

    def _alpha_varies(self) -> bool:
        """Whether alpha is below 1 anywhere."""
        if self._shape[2] not in (2, 4):
            return False
        pixels = self.pixels
        full = 1.0 if pixels.dtype.kind == "f" else np.iinfo(pixels.dtype).max
        return bool((pixels[..., -1] < full).any())

    def _environment(self) -> _core.EnvironmentMap:
        """The image as an environment map."""
        if self._map is None:
            self._map = _core.EnvironmentMap(self.pixels)
        return self._map

    def _core(self, color: bool) -> _core.Image:
        """The image as renderers have it, of colours or of other numbers."""
        srgb = color and self._dtype.startswith("u")
        known = self._cores.get(srgb)
        if known is None:
            known = self._cores[srgb] = _core.Image(self.pixels, srgb)
        return known

    def __repr__(self) -> str:
        height, width, channels = self._shape
        plural = "" if channels == 1 else "s"
        return f"<Image {width} x {height}, {channels} channel{plural}, {self._dtype}>"


def _image(pixels: NDArray[Any], file: bytes | None) -> Image:
    """An image of pixels that were looked at before, and its file."""
    image = object.__new__(Image)
    image._keep(pixels, file)
    return image


def _pair(value: object, name: str) -> tuple[float, float]:
    array = np.asarray(value, np.float64)
    if array.shape != (2,) or not np.isfinite(array).all():
        raise ArgumentError(f"{name}: expected two finite numbers, not {value!r}")
    return float(array[0]), float(array[1])


def both_ways(wrap: Wrap | tuple[Wrap, Wrap]) -> tuple[Wrap, Wrap]:
    """Return how an image goes on along u and along v."""
    ways: tuple[Wrap, ...] = (wrap, wrap) if isinstance(wrap, str) else tuple(wrap)
    if len(ways) != 2 or not set(ways) <= set(get_args(Wrap)):
        raise ArgumentError(f"wrap: must be repeat, mirror or clamp, or two of them, not {wrap!r}")
    return ways[0], ways[1]


def wrapped(at: NDArray[np.int64], count: int, way: str) -> NDArray[np.int64]:
    """Return which of ``count`` texels of a row are seen at places outside, too."""
    if way == "clamp":
        return np.clip(at, 0, count - 1)
    if way == "repeat":
        return at % count
    twice = at % (2 * count)
    return np.minimum(twice, 2 * count - 1 - twice)


@_advice.teaching
@dataclass(frozen=True)
class Texture:
    """An image, the UV set that it lies on a surface by, and how it is filtered.

    UV (0, 0) is the lower left corner of the image, as in OpenGL, trimesh and OBJ. `offset`, `rotation` and `scale`
    are those of glTF's ``KHR_texture_transform`` and count from its upper left corner, as they do there.

    A pixel sees an ellipse of the image. As many samples as that is times longer than wide lie along its longer
    axis, up to `anisotropy`, each between the two levels of the image whose pixels are about as wide as it.

    Examples
    --------
    >>> texture = nrs.Texture(np.array([[[255, 0, 0], [0, 255, 0]]], np.uint8), wrap="clamp", filter="nearest")
    >>> red_and_green = nrs.Material(base_color_texture=texture)
    """

    image: Image
    """The picture; an array makes one, and the path of a file is read by `Image.open`."""
    uv_set: int = field(default=0, kw_only=True)
    """Which of the mesh's UV sets."""
    wrap: Wrap | tuple[Wrap, Wrap] = field(default="repeat", kw_only=True)
    """What is beyond the edges, along both axes or along u and v."""
    filter: Filter = field(default="linear", kw_only=True)
    """Between pixels of the image."""
    mipmaps: Filter | None = field(default="linear", kw_only=True)
    """Between smaller versions of it; ``None`` uses none of them, and flickers in the distance."""
    anisotropy: int = field(default=8, kw_only=True)
    """Most samples along the longer axis of what a pixel sees of it, 1 to 16."""
    offset: tuple[float, float] = field(default=(0.0, 0.0), kw_only=True)
    """Added to the coordinates, last."""
    rotation: float = field(default=0.0, kw_only=True)
    """Radians, counter-clockwise."""
    scale: tuple[float, float] = field(default=(1.0, 1.0), kw_only=True)
    """Times the coordinates, first."""

    def __post_init__(self) -> None:
        def keep(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        keep("image", Image._of(self.image))
        keep("wrap", both_ways(self.wrap))
        for name, value in (("filter", self.filter), ("mipmaps", self.mipmaps or "linear")):
            if value not in get_args(Filter):
                raise ArgumentError(f"{name}: must be linear or nearest, not {value!r}")
        for name, least, most in (("uv_set", 0, 3), ("anisotropy", 1, 16)):
            value = getattr(self, name)
            if not (isinstance(value, int | np.integer) and least <= value <= most):
                raise ArgumentError(f"{name}: must be a whole number from {least} to {most}, not {value!r}")
        keep("offset", _pair(self.offset, "offset"))
        keep("scale", _pair(self.scale, "scale"))
        if not np.isfinite(self.rotation):
            raise ArgumentError(f"rotation: must be finite, not {self.rotation!r}")

    def _rows(self) -> list[list[float]]:
        """Rows of the map from the mesh's (u, v, 1), v up, to places on the image, v down, in its sides."""
        cos, sin = float(np.cos(self.rotation)), float(np.sin(self.rotation))
        shift = np.array([[1.0, 0.0, self.offset[0]], [0.0, 1.0, self.offset[1]], [0.0, 0.0, 1.0]])
        turn = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
        stretch = np.diag([*self.scale, 1.0])
        down = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 1.0], [0.0, 0.0, 1.0]])
        rows: list[list[float]] = (shift @ turn @ stretch @ down)[:2].tolist()
        return rows

    def _raw(self, color: bool) -> dict[str, Any]:
        u, v = (get_args(Wrap).index(way) for way in self.wrap)
        mipmaps = {None: 0, "nearest": 1, "linear": 2}[self.mipmaps]
        return {
            "image": self.image._core(color),
            "uv_set": int(self.uv_set),
            "wrap": (u, v),
            "linear": self.filter == "linear",
            "mipmaps": mipmaps,
            "anisotropy": int(self.anisotropy),
            "rows": self._rows(),
        }
