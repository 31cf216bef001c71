"""Files of pictures, read: every mode that files have, pixel for pixel, and errors that name the file."""

from __future__ import annotations

import io
import struct
import sys
import zlib

import numpy as np
import pytest
from PIL import Image as Pillow

import nanite_rs as nrs
from nanite_rs._images import from_pillow, read_image

RNG = np.random.default_rng(3)
RGBA = RNG.integers(0, 256, (5, 7, 4), dtype=np.uint8)


def encoded(image: Pillow.Image, kind: str = "PNG", **options) -> bytes:
    out = io.BytesIO()
    image.save(out, kind, **options)
    return out.getvalue()


def png(rows: np.ndarray, color: int, depth: int = 8) -> bytes:
    """A PNG of any depth, which Pillow does not write."""

    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    height, width = rows.shape[:2]
    lines = rows.astype(f">u{depth // 8}").reshape(height, -1)
    body = b"".join(b"\0" + line.tobytes() for line in lines)
    head = struct.pack(">IIBBBBB", width, height, depth, color, 0, 0, 0)
    chunks = chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(body)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + chunks


@pytest.mark.parametrize(
    ("kind", "channels"),
    [*((kind, count) for kind in ("PNG", "TGA") for count in (1, 3, 4)), ("BMP", 3), ("WEBP", 3), ("PPM", 3)],
)
def test_plain_files_are_read_pixel_for_pixel(tmp_path, kind, channels) -> None:
    pixels = RGBA[..., 0] if channels == 1 else RGBA[..., :channels]
    path = tmp_path / f"a.{kind.lower()}"
    Pillow.fromarray(pixels).save(path, kind, **({"lossless": True} if kind == "WEBP" else {}))
    found = read_image(path)
    assert found.dtype == np.uint8
    assert np.array_equal(found, pixels)
    assert np.array_equal(read_image(path.read_bytes(), "a"), pixels)
    image = nrs.Image.open(path)
    assert image.size == (7, 5)
    assert np.array_equal(image.pixels, pixels.reshape(5, 7, channels))


def test_jpeg_is_pillows() -> None:
    data = encoded(Pillow.fromarray(RGBA[..., :3]), "JPEG")
    assert np.array_equal(read_image(data), np.asarray(Pillow.open(io.BytesIO(data))))


@pytest.mark.parametrize("mode", ["1", "L", "LA", "P", "PA", "RGB", "RGBA", "CMYK", "YCbCr", "HSV", "LAB"])
def test_every_mode_becomes_grey_or_colour(mode) -> None:
    image = Pillow.fromarray(RGBA)
    image = image.convert("P").convert("PA") if mode == "PA" else image.convert("RGB").convert(mode)
    found = from_pillow(image)
    assert found.dtype == np.uint8
    expected = {"1": "L", "L": "L", "LA": "LA", "PA": "RGBA", "RGBA": "RGBA"}.get(mode, "RGB")
    assert np.array_equal(found, np.asarray(image.convert(expected)))


def test_palettes_keep_their_transparency() -> None:
    image = Pillow.new("P", (2, 1))
    image.putpalette([255, 0, 0, 0, 255, 0])
    image.putdata([0, 1])
    opaque = read_image(encoded(image))
    assert opaque.tolist() == [[[255, 0, 0], [0, 255, 0]]]
    holes = read_image(encoded(image, transparency=bytes([255, 0])))
    assert holes.tolist() == [[[255, 0, 0, 255], [0, 255, 0, 0]]]


def test_a_transparent_colour_is_alpha() -> None:
    image = Pillow.fromarray(np.array([[[1, 2, 3], [4, 5, 6]]], np.uint8))
    assert read_image(encoded(image, transparency=(4, 5, 6)))[0, :, 3].tolist() == [255, 0]
    grey = Pillow.fromarray(np.array([[7, 9]], np.uint8))
    assert read_image(encoded(grey, transparency=9)).tolist() == [[[7, 255], [9, 0]]]


@pytest.mark.parametrize(("color", "channels"), [(0, 1), (2, 3), (4, 2), (6, 4)])
def test_png_of_16_bits(color, channels) -> None:
    pytest.importorskip("OpenImageIO")
    pixels = RNG.integers(0, 65536, (5, 7, channels), dtype=np.uint16)
    found = read_image(png(pixels, color, 16))
    assert found.dtype == np.uint16
    # Colours stay as stored, also where alpha is small.
    assert np.array_equal(found.reshape(pixels.shape), pixels)


@pytest.mark.parametrize(("kind", "dtype"), [("exr", np.float32), ("exr", np.float16), ("tif", np.float32)])
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_floats_are_read_bit_for_bit(tmp_path, kind, dtype, channels) -> None:
    oiio = pytest.importorskip("OpenImageIO")
    pixels = (RNG.random((5, 7, channels)) * 9.0).astype(dtype)
    path = tmp_path / f"a.{kind}"
    spec = oiio.ImageSpec(7, 5, channels, oiio.HALF if dtype is np.float16 else oiio.FLOAT)
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), spec)
    assert output.write_image(pixels)
    output.close()
    found = read_image(path)
    assert found.dtype == np.float32
    assert np.array_equal(found.reshape(pixels.shape), pixels.astype(np.float32))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_tiff(tmp_path, dtype) -> None:
    oiio = pytest.importorskip("OpenImageIO")
    pixels = RNG.integers(0, np.iinfo(dtype).max, (5, 7, 4)).astype(dtype)
    path = tmp_path / "a.tiff"
    spec = oiio.ImageSpec(7, 5, 4, oiio.UINT8 if dtype is np.uint8 else oiio.UINT16)
    spec.attribute("oiio:UnassociatedAlpha", 1)
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), spec)
    assert output.write_image(pixels)
    output.close()
    assert np.array_equal(read_image(path), pixels)


def test_hdr(tmp_path) -> None:
    oiio = pytest.importorskip("OpenImageIO")
    pixels = (RNG.random((16, 16, 3)) * 100.0).astype(np.float32)
    path = tmp_path / "sky.hdr"
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), oiio.ImageSpec(16, 16, 3, oiio.FLOAT))
    assert output.write_image(pixels)
    output.close()
    found = read_image(path)
    assert np.abs(found - pixels).max() <= pixels.max() / 128.0


def test_a_saved_frame_comes_back(tmp_path) -> None:
    pytest.importorskip("OpenImageIO")
    scene = nrs.Scene(ambient_light=(0.2, 0.3, 0.4))
    with nrs.Renderer(16, 8) as renderer:
        frame = renderer.render(scene, nrs.PerspectiveCamera(yfov=0.8), np.eye(4))
    frame.save(tmp_path / "a.exr")
    assert np.array_equal(read_image(tmp_path / "a.exr"), frame.linear)


# ------------------------------------------------------------------------------------------------- bad input


def test_a_missing_file_and_a_folder(tmp_path) -> None:
    with pytest.raises(nrs.MissingFileError, match=r"none\.png"):
        nrs.Image.open(tmp_path / "none.png")
    with pytest.raises(nrs.FileError, match="directory"):
        nrs.Image.open(tmp_path)


def refused(data: bytes) -> str | None:
    """What is said of a file, if it is refused."""
    try:
        read_image(data, "cut.img")
    except nrs.FormatError as error:
        return str(error)
    return None


@pytest.mark.parametrize("kind", ["PNG", "JPEG", "WEBP", "BMP", "TGA", "GIF", "JPEG2000", "DDS"])
def test_cut_off_files_are_refused_or_read(kind) -> None:
    data = encoded(Pillow.fromarray(RGBA if kind != "JPEG" else RGBA[..., :3]), kind)
    texts = [refused(data[:end]) for end in range(len(data))]
    assert all(text.startswith("cut.img: ") for text in texts if text)
    assert sum(text is not None for text in texts) > 0.5 * len(data)


@pytest.mark.parametrize("kind", ["exr", "png", "hdr", "tif"])
def test_cut_off_deep_files_are_refused_or_read(tmp_path, kind) -> None:
    oiio = pytest.importorskip("OpenImageIO")
    if kind == "png":
        data = png(RNG.integers(0, 65536, (9, 9, 3), dtype=np.uint16), 2, 16)
    else:
        path = tmp_path / f"a.{kind}"
        output = oiio.ImageOutput.create(str(path))
        output.open(str(path), oiio.ImageSpec(9, 9, 3, oiio.FLOAT))
        output.write_image(RNG.random((9, 9, 3)).astype(np.float32))
        output.close()
        data = path.read_bytes()
    texts = [refused(data[:end]) for end in range(11, len(data), 7)]
    assert all(text.startswith("cut.img: ") and "/tmp" not in text for text in texts if text)
    assert sum(text is not None for text in texts) > 0.5 * len(texts)


@pytest.mark.parametrize(
    "data", [b"", b"\0" * 100, b"%!PS-Adobe-3.0 EPSF-3.0\n", b"hello", b"\xabKTX 20\xbb\r\n"]
)
def test_what_is_no_image_is_refused(data) -> None:
    with pytest.raises(nrs.FormatError, match=r"it\.jpg"):
        read_image(data, "it.jpg")


def test_bombs_are_refused(monkeypatch) -> None:
    monkeypatch.setattr(Pillow, "MAX_IMAGE_PIXELS", 10)
    with pytest.raises(nrs.FormatError, match=r"big.*pixels"):
        read_image(encoded(Pillow.fromarray(RGBA)), "big")
    pytest.importorskip("OpenImageIO")
    with pytest.raises(nrs.FormatError, match=r"big.*pixels"):
        read_image(png(np.zeros((5, 7, 3), np.uint16), 2, 16), "big")


def test_what_is_not_finite_is_named(tmp_path) -> None:
    oiio = pytest.importorskip("OpenImageIO")
    pixels = np.zeros((3, 4, 3), np.float32)
    pixels[1, 2, 0] = np.nan
    path = tmp_path / "a.exr"
    output = oiio.ImageOutput.create(str(path))
    output.open(str(path), oiio.ImageSpec(4, 3, 3, oiio.FLOAT))
    output.write_image(pixels)
    output.close()
    with pytest.raises(nrs.FormatError, match=r"a\.exr: nan at row 1, column 2, channel 0"):
        nrs.Image.open(path)


def test_without_openimageio_the_error_names_it(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "OpenImageIO", None)
    assert read_image(encoded(Pillow.fromarray(RGBA))).shape == (5, 7, 4)
    with pytest.raises(nrs.DependencyError, match=r"deep\.png: OpenImageIO is needed"):
        read_image(png(np.zeros((5, 7, 3), np.uint16), 2, 16), "deep.png")
