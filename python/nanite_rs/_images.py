"""Files of pictures, and OpenImageIO where it is needed."""

from __future__ import annotations

import errno
import os
import secrets
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from nanite_rs.exceptions import DependencyError, FileError, FormatError, MissingFileError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray


def suffix(path: str) -> str:
    """Return ``".png"`` or ``".exr"``; any other ending is an error."""
    found = os.path.splitext(path)[1].lower()
    if found not in (".png", ".exr"):
        what = f"extension {found} is unknown" if found else "the name has no extension"
        raise FormatError(f"{path}: {what}; frames are saved as .png or .exr")
    return found


def openimageio(purpose: str) -> Any:
    """Import OpenImageIO, some 20 MB that not everybody needs; where it is missing the error names ``purpose``."""
    try:
        import OpenImageIO
    except ImportError as error:
        message = f"{purpose}: OpenImageIO is needed; pip install 'nanite-rs[io]'"
        raise DependencyError(message, name="OpenImageIO") from error
    return OpenImageIO


@contextmanager
def _beside(path: str) -> Iterator[str]:
    """Name a new empty file beside ``path``: it takes that name when the block ends well, and goes otherwise."""
    name = f".nanite-{secrets.token_hex(8)}{suffix(path)}"
    temporary = os.path.join(os.path.dirname(path), name)
    try:
        with open(temporary, "xb"):
            pass
        try:
            yield temporary
            os.replace(temporary, path)
        except BaseException:
            os.unlink(temporary)
            raise
    except OSError as error:
        kind = MissingFileError if isinstance(error, FileNotFoundError) else FileError
        raise kind(error.errno, error.strerror, path) from None


def write_png(path: str, picture: NDArray[np.uint8], texts: Mapping[str, str]) -> None:
    """Write (H, W, 3) uint8 with texts: by Pillow, which every installation has."""
    from PIL import Image, PngImagePlugin

    info = PngImagePlugin.PngInfo()
    for key, text in texts.items():
        info.add_text(key, text)
    image = Image.fromarray(picture)
    with _beside(path) as temporary:
        image.save(temporary, format="PNG", compress_level=3, pnginfo=info)


def write_deep_png(path: str, picture: NDArray[np.uint16], texts: Mapping[str, str]) -> None:
    """Write (H, W, 3) uint16 with texts: by OpenImageIO, since Pillow knows no such pictures."""
    oiio = openimageio(path)
    height, width, count = picture.shape
    spec = _described(oiio.ImageSpec(width, height, count, oiio.UINT16), texts)
    _write(oiio, path, [(spec, picture)])


def write_exr(path: str, channels: Mapping[str, NDArray[Any]], texts: Mapping[str, str]) -> None:
    """Write named channels, (H, W) float32 or uint32, bit for bit: those of each type in a part of their own.

    OpenImageIO's Python module writes channels of one type at a time, and through float32 ids would be rounded.
    """
    oiio = openimageio(path)
    parts = []
    for name, dtype, kind in (("geometry", np.float32, oiio.FLOAT), ("ids", np.uint32, oiio.UINT)):
        own = {channel: values for channel, values in channels.items() if values.dtype == dtype}
        if not own:
            continue
        pixels = np.stack(list(own.values()), axis=-1)
        height, width, count = pixels.shape
        spec = _described(oiio.ImageSpec(width, height, count, kind), texts)
        spec.channelnames = tuple(own)
        spec.attribute("oiio:subimagename", name)
        spec.attribute("compression", "zip")
        parts.append((spec, pixels))
    _write(oiio, path, parts)


def _described(spec: Any, texts: Mapping[str, str]) -> Any:
    for key, text in texts.items():
        spec.attribute(key, text)
    return spec


def _write(oiio: Any, path: str, parts: Sequence[tuple[Any, NDArray[Any]]]) -> None:
    """Write the parts of a file: specification and pixels each."""
    with _beside(path) as temporary:
        output = oiio.ImageOutput.create(temporary)
        specs = tuple(spec for spec, _ in parts)
        written = output.open(temporary, specs if len(specs) > 1 else specs[0])
        for number, (spec, pixels) in enumerate(parts):
            if number:
                written = written and output.open(temporary, spec, "AppendSubimage")
            written = written and output.write_image(pixels)
        # Closing writes what is left, also of a file that failed.
        if not (output.close() and written):
            raise FileError(errno.EIO, output.geterror() or os.strerror(errno.EIO), path)


def read_image(path: str | os.PathLike[str]) -> NDArray[Any]:
    """Read a picture, rows from the top."""
    from PIL import Image

    with Image.open(path) as image:
        return np.asarray(image)
