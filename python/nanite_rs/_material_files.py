"""Materials as ``.nanite`` files have them: a table, and the images that it names. docs/format.md has both."""

from __future__ import annotations

import json
from dataclasses import fields
from functools import partial
from io import BytesIO
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from nanite_rs._export_parts import png, textures
from nanite_rs._images import read_image
from nanite_rs.exceptions import FormatError, NaniteError
from nanite_rs.material import Material, default_material
from nanite_rs.texture import Image, Texture

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

_NPY: Final = b"\x93NUMPY"


def encoded(materials: Sequence[Material]) -> tuple[str, list[bytes]]:
    """Return the table and the images; nothing where all look as a mesh does that nothing is said of."""
    if all(look in (Material(), default_material(colored=True)) and not look.name for look in materials):
        return "", []
    images = _Images()
    rows = [_row(look, images) for look in materials]
    return json.dumps({"images": images.rows, "materials": rows}, allow_nan=False), images.files


def decoded(table: str, count: int, read: Callable[[int], bytes], name: str) -> tuple[Material, ...]:
    """Return the materials of a file; images are read and decoded when they are first looked at.

    ``read`` returns one of its ``count`` images by its number, and errors name the file.
    """
    if not table:
        return ()
    try:
        known = json.loads(table)
        images = [
            _image(row, partial(read, k), f"{name}: image {k}") for k, row in enumerate(known["images"])
        ]
        if len(images) != count:
            raise ValueError(f"{len(images)} images, {count} sections Images")
        return tuple(_material(row, images) for row in known["materials"])
    except (NaniteError, ValueError, TypeError, LookupError, AttributeError, RecursionError) as error:
        raise FormatError(f"{name}: section Materials: {type(error).__name__}: {error}") from error


def forget(look: Material) -> None:
    """Keep no pixels of images that have a file."""
    for _, texture in textures(look):
        texture.image._forget()


class _Images:
    """Images by what they hold."""

    def __init__(self) -> None:
        self.rows: list[dict[str, Any]] = []
        self.files: list[bytes] = []
        self._of_image: dict[int, int] = {}
        self._of_file: dict[bytes, int] = {}

    def number(self, image: Image) -> int:
        """Return the number of an image, and keep it."""
        known = self._of_image.get(id(image))
        if known is None:
            file = image.encoded() or _encode(image.pixels)
            known = self._of_file.setdefault(file, len(self.files))
            if known == len(self.files):
                height, width, channels = image._shape
                row = {"width": width, "height": height, "channels": channels, "dtype": image._dtype}
                self.rows.append(row)
                self.files.append(file)
            self._of_image[id(image)] = known
        return known


def _encode(pixels: NDArray[Any]) -> bytes:
    """Encode without loss in what every installation reads: PNG of bytes, and what NumPy writes of all else."""
    if pixels.dtype == np.uint8:
        return png(pixels)
    buffer = BytesIO()
    np.save(buffer, pixels, allow_pickle=False)
    return buffer.getvalue()


def _image(row: dict[str, Any], read: Callable[[], bytes], name: str) -> Image:
    """Return an image that is read when it is looked at, and must be as large as the table says."""
    shape, dtype = (int(row["height"]), int(row["width"]), int(row["channels"])), str(row["dtype"])

    def decode() -> NDArray[Any]:
        pixels = Image(_decode(read(), name)).pixels
        if (pixels.shape, pixels.dtype.name) != (shape, dtype):
            found = f"{pixels.dtype} of shape {pixels.shape}"
            raise FormatError(f"{name}: it is {found}, and {dtype} of shape {shape} in the table")
        return pixels

    return Image._later(shape, dtype, read, decode)


def _decode(data: bytes, name: str) -> NDArray[Any]:
    if not data.startswith(_NPY):
        return read_image(data, name)
    try:
        pixels: NDArray[Any] = np.load(BytesIO(data), allow_pickle=False)
    except (ValueError, EOFError, OSError) as error:
        raise FormatError(f"{name}: the image is damaged: {error}") from error
    return pixels


def _row(look: Material, images: _Images) -> dict[str, Any]:
    """Return all fields of a material by their names; textures by those of theirs."""
    row = {field.name: getattr(look, field.name) for field in fields(Material)}
    return {
        name: _texture_row(value, images) if isinstance(value, Texture) else value
        for name, value in row.items()
    }


def _texture_row(texture: Texture, images: _Images) -> dict[str, Any]:
    row = {field.name: getattr(texture, field.name) for field in fields(Texture)}
    return row | {"image": images.number(texture.image)}


def _material(row: dict[str, Any], images: list[Image]) -> Material:
    """Return a material of the fields that are known here."""
    known = {field.name for field in fields(Material)}
    own = {name: value for name, value in row.items() if name in known}
    for name, value in own.items():
        if name.endswith("_texture") and value is not None:
            own[name] = _texture(value, images)
    return Material(**own)


def _texture(row: dict[str, Any], images: list[Image]) -> Texture:
    known = {field.name for field in fields(Texture)}
    own = {name: value for name, value in row.items() if name in known}
    number = own["image"]
    if not (isinstance(number, int) and 0 <= number < len(images)):
        raise ValueError(f"image {number!r} of {len(images)}")
    wrap = own.get("wrap", "repeat")
    return Texture(**own | {"image": images[number], "wrap": wrap if isinstance(wrap, str) else tuple(wrap)})
