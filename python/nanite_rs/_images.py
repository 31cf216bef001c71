"""Files of pictures, and OpenImageIO where it is needed."""

from __future__ import annotations

import errno
import os
import secrets
import stat
import sys
import tempfile
from contextlib import contextmanager
from io import BytesIO
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from nanite_rs import _advice
from nanite_rs.exceptions import FileError, ForkError, FormatError, MissingFileError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    import PIL.Image
    from numpy.typing import NDArray

# Formats that Pillow may read: none that runs another program, as EPS does.
_PILLOW: Final = (
    "PNG",
    "JPEG",
    "WEBP",
    "AVIF",
    "BMP",
    "TGA",
    "GIF",
    "DDS",
    "JPEG2000",
    "PPM",
    "PSD",
    "SGI",
    "PCX",
)

# The first bytes of files that OpenImageIO reads, and the extensions by which it knows them.
_OPENIMAGEIO: Final = {
    b"#?RADIANCE": ".hdr",
    b"#?RGBE": ".hdr",
    b"v/1\x01": ".exr",
    b"II*\0": ".tif",
    b"MM\0*": ".tif",
    b"II+\0": ".tif",
    b"MM\0+": ".tif",
}
PNG: Final = b"\x89PNG\r\n\x1a\n"
"""How files begin that glTF can hold; here PNG, and JPEG below."""
JPEG: Final = b"\xff\xd8\xff"
_KTX: Final = b"\xabKTX "


def suffix(path: str) -> str:
    """Return ``".png"`` or ``".exr"``; any other ending is an error."""
    found = os.path.splitext(path)[1].lower()
    if found not in (".png", ".exr"):
        what = f"extension {found} is unknown" if found else "the name has no extension"
        raise FormatError(f"{path}: {what}; frames are saved as .png or .exr")
    return found


def openimageio(purpose: str) -> Any:
    """Import OpenImageIO, some 20 MB that not everybody needs; where it is missing the error names ``purpose``.

    Where nobody has imported it before, it works by one thread from then on.
    """
    known = "OpenImageIO" in sys.modules
    try:
        import OpenImageIO
    except ImportError as error:
        raise _advice.missing(purpose, "OpenImageIO") from error
    if not known:
        # A forked process would wait forever for its threads, which it can neither release nor make again.
        OpenImageIO.attribute("threads", 1)
    elif "OpenImageIO" in _inherited and OpenImageIO.get_int_attribute("threads") != 1:
        raise ForkError(
            f"{purpose}: OpenImageIO has threads in the process that this one was forked from, and not in this "
            'one: call OpenImageIO.attribute("threads", 1) there before all else, or start workers with "spawn"'
        )
    return OpenImageIO


_inherited: set[str] = set()
"""What was imported in the process that this one was forked from."""

if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=lambda: _inherited.update(sys.modules))


@contextmanager
def _without_threads(oiio: Any) -> Iterator[None]:
    """Keep OpenEXR from making threads, for which a process forked from this one would wait for ever."""
    before = oiio.get_int_attribute("exr_threads")
    oiio.attribute("exr_threads", -1)
    try:
        yield
    finally:
        # Threads are then made only on request.
        oiio.attribute("exr_threads", before)


@contextmanager
def beside(path: str) -> Iterator[str]:
    """Name a new empty file beside ``path``: it takes that name when the block ends well, and goes otherwise.

    It takes the mode of a file of that name, too. Where ``path`` is a symbolic link, the place that it leads to is
    meant, and the link stays.
    """
    try:
        old = _mode(path)
        target = os.path.realpath(path)
        name = f".nanite-{secrets.token_hex(8)}{os.path.splitext(path)[1].lower()}"
        temporary = os.path.join(os.path.dirname(target), name)
        with open(temporary, "xb"):
            pass
        try:
            yield temporary
            if old is not None:
                os.chmod(temporary, old)
            os.replace(temporary, target)
        except BaseException:
            os.unlink(temporary)
            raise
    except OSError as error:
        kind = MissingFileError if isinstance(error, FileNotFoundError) else FileError
        raise kind(error.errno, error.strerror, path) from None


def _mode(path: str) -> int | None:
    """The mode of a file; None where the file does not exist yet. Other failures are errors."""
    try:
        found = os.stat(path).st_mode
    except FileNotFoundError:
        return None
    except ValueError:  # a zero byte in the name
        raise OSError(errno.EINVAL, os.strerror(errno.EINVAL), path) from None
    if stat.S_ISDIR(found):
        raise OSError(errno.EISDIR, os.strerror(errno.EISDIR), path)
    if not stat.S_ISREG(found):
        raise OSError(errno.EINVAL, "neither a file nor a place for one", path)
    return stat.S_IMODE(found)


def write_png(path: str, picture: NDArray[Any], texts: Mapping[str, str]) -> None:
    """Write (H, W, 3 or 4) uint8, or (H, W) uint16, with texts: by Pillow, which every installation has."""
    from PIL import Image, PngImagePlugin

    info = PngImagePlugin.PngInfo()
    for key, text in texts.items():
        info.add_text(key, text)
    image = Image.fromarray(picture)
    with beside(path) as temporary:
        image.save(temporary, format="PNG", compress_level=3, pnginfo=info)


def png(picture: NDArray[np.uint8]) -> bytes:
    """Encode (H, W, 3) uint8, for notebooks."""
    from PIL import Image

    buffer = BytesIO()
    Image.fromarray(picture).save(buffer, format="PNG", compress_level=3)
    return buffer.getvalue()


def write_deep_png(path: str, picture: NDArray[np.uint16], texts: Mapping[str, str]) -> None:
    """Write (H, W, 3 or 4) uint16 with texts: by OpenImageIO, since Pillow knows no such pictures."""
    oiio = openimageio(path)
    height, width, count = picture.shape
    spec = _described(oiio.ImageSpec(width, height, count, oiio.UINT16), texts)
    # Colours as they are, not multiplied by alpha, as PNG has them.
    spec.attribute("oiio:UnassociatedAlpha", 1)
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
    with _without_threads(oiio), beside(path) as temporary:
        output = oiio.ImageOutput.create(temporary)
        specs = tuple(spec for spec, _ in parts)
        written = output.open(temporary, specs if len(specs) > 1 else specs[0])
        for number, (spec, pixels) in enumerate(parts):
            if number:
                written = written and output.open(temporary, spec, "AppendSubimage")
            written = written and output.write_image(pixels)
        # Closing writes the rest, also of a file that failed.
        if not (output.close() and written):
            raise FileError(errno.EIO, output.geterror() or os.strerror(errno.EIO), path)


def read_bytes(path: str | os.PathLike[str], what: str = "") -> bytes:
    """Read a file; errors name it, and say what it is needed for if that is given."""
    name = f"{what}: {os.fspath(path)}" if what else os.fspath(path)
    try:
        # Not a device or a pipe, which may never end.
        if not os.path.isfile(path):
            os.stat(path)
            code = errno.EISDIR if os.path.isdir(path) else errno.EINVAL
            raise FileError(code, os.strerror(code), name)
        with open(path, "rb") as file:
            return file.read()
    except FileNotFoundError as error:
        raise MissingFileError(error.errno, error.strerror, name) from None
    except FileError:
        raise
    except (OSError, ValueError) as error:  # ValueError: a zero byte in the name
        code = getattr(error, "errno", None) or errno.EINVAL
        raise FileError(code, os.strerror(code), name) from None


def read_image(source: str | os.PathLike[str] | bytes, name: str | None = None) -> NDArray[Any]:
    """Read a picture as (H, W) or (H, W, 2 to 4), rows from the top: uint8, uint16 or float32.

    Palettes become RGB or RGBA, CMYK and other colour models RGB; grey, with and without alpha, stays as it is.
    Colours are as stored, not multiplied by alpha. Profiles and rotations that a file asks for are not applied, as
    glTF says.

    Parameters
    ----------
    source : path or bytes
        A file, or the content of one.
    name : str, optional
        What errors call it; by default the path.

    Raises
    ------
    MissingFileError, FileError, FormatError, DependencyError
        Each names the file.
    """
    if isinstance(source, bytes):
        data, name = source, name or "image"
    else:
        data, name = read_bytes(source), name or os.fspath(source)
    ending = next((end for start, end in _OPENIMAGEIO.items() if data.startswith(start)), None)
    if data.startswith(PNG) and data[24:25] == b"\x10":
        ending = ".png"  # Pillow makes 8 bits of colours of 16
    if ending:
        return _read_deep(data, ending, name)
    if data.startswith(_KTX):
        raise FormatError(f"{name}: KTX textures cannot be read; PNG, JPEG and WebP can")
    return read_plain(data, name)


def read_plain(data: bytes, name: str) -> NDArray[Any]:
    """Read what Pillow reads, as it is."""
    import PIL
    from PIL import Image

    known = Image.registered_extensions().values()  # this also loads Pillow's readers
    try:
        with Image.open(BytesIO(data), formats=[name for name in _PILLOW if name in known]) as image:
            return from_pillow(image)
    except Image.DecompressionBombError as error:
        raise FormatError(f"{name}: {error}") from None
    except PIL.UnidentifiedImageError:
        raise FormatError(f"{name}: it is damaged, or no image of a known format") from None
    except MemoryError:
        raise
    except Exception as error:  # whatever a reader trips over in a damaged file
        raise FormatError(f"{name}: the image is damaged: {error}") from error


def from_pillow(image: PIL.Image.Image) -> NDArray[Any]:
    """Pixels of a Pillow image, as `read_image` gives them."""
    mode = image.mode
    clear = "transparency" in image.info
    if mode.startswith("I;16"):
        return np.array(image, np.uint16)
    if mode == "I":
        return np.array(np.clip(np.asarray(image), 0, 65535), np.uint16)
    if mode == "F":
        return np.asarray(image, np.float32)
    if mode in ("1", "L") and not clear:
        mode = "L"
    elif mode in ("1", "L", "LA", "La"):
        mode = "LA"
    elif mode in ("RGBA", "RGBa", "PA") or clear:
        mode = "RGBA"
    else:
        mode = "RGB"
    return np.array(image if image.mode == mode else image.convert(mode))


def _read_deep(data: bytes, ending: str, name: str) -> NDArray[Any]:
    """Read by OpenImageIO, which takes files only."""
    oiio = openimageio(name)
    handle, path = tempfile.mkstemp(ending)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
        with _without_threads(oiio):
            pixels = _read_file(oiio, path, name)
    finally:
        os.unlink(path)
    if pixels.dtype.kind == "f" and not np.isfinite(pixels).all():
        row, column, channel = (int(k) for k in np.argwhere(~np.isfinite(pixels))[0])
        value = pixels[row, column, channel]
        raise FormatError(f"{name}: {value} at row {row}, column {column}, channel {channel}")
    picture: NDArray[Any] = pixels[..., 0] if pixels.shape[2] == 1 else pixels
    return picture


def _read_file(oiio: Any, path: str, name: str) -> NDArray[Any]:
    """Read the picture of a file that errors call ``name``."""
    wanted = oiio.ImageSpec()
    wanted.attribute("oiio:UnassociatedAlpha", 1)
    source = oiio.ImageInput.open(path, wanted)
    if source is None:
        raise FormatError(f"{name}: the image is damaged: {_reason(oiio.geterror(), path)}")
    try:
        spec = source.spec()
        _refuse_bombs(spec, name)
        # Wider types than float32 and more channels than a picture's have no use here.
        kind = {"uint8": "uint8", "uint16": "uint16"}.get(str(spec.format), "float")
        pixels = source.read_image(kind)
        if pixels is None:
            raise FormatError(f"{name}: the image is damaged: {_reason(source.geterror(), path)}")
        pixels = np.asarray(pixels).reshape(spec.height, spec.width, spec.nchannels)
        picture: NDArray[Any] = pixels[..., _picture(list(spec.channelnames))]
        return picture
    finally:
        source.close()


def _reason(message: str, path: str) -> str:
    """The message of OpenImageIO, without the name of the temporary file."""
    return message.replace(path, "it").strip() or "no reason is known"


def _picture(names: list[str]) -> list[int]:
    """Which channels of a file are the picture: R, G, B and A, or Y and A, or the first ones."""
    places = {name.upper(): place for place, name in reversed(list(enumerate(names)))}
    for color in ("RGB", "Y"):
        if all(channel in places for channel in color):
            return [places[channel] for channel in (*color, "A") if channel in places]
    return list(range(min(len(names), 4)))


def _refuse_bombs(spec: Any, name: str) -> None:
    """Apply Pillow's limit, which callers can change, to files that Pillow does not read."""
    from PIL import Image

    limit = Image.MAX_IMAGE_PIXELS
    if limit is not None and spec.width * spec.height * max(spec.depth, 1) > 2 * limit:
        raise FormatError(
            f"{name}: {spec.width} x {spec.height} pixels exceed twice PIL.Image.MAX_IMAGE_PIXELS"
        )
