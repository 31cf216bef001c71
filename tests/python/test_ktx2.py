"""Images of glTF as KTX 2.0, read by what others wrote: Binomial's decoder, by three.js in Chromium."""

from __future__ import annotations

import base64
import hashlib
import io
import json
import struct
import subprocess
import sys
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from PIL import Image

import nanite_rs as nrs
from nanite_rs import _core, _export_ktx2, _export_textures
from nanite_rs._export_parts import Notes
from nanite_rs._export_textures import halved
from oracles.compare import psnr
from test_export import source
from test_tiles_in_browser import PACKAGES, opened

if TYPE_CHECKING:
    from oracles.browser import Browser

PAGE = """<!DOCTYPE html><canvas id="c"></canvas>
<script type="importmap">{"imports": {"three": "/npm/three/build/three.module.js"}}</script>
<script type="module">
import * as three from "three";
import { KTX2Loader } from "/npm/three/examples/jsm/loaders/KTX2Loader.js";
const canvas = document.getElementById("c");
const renderer = new three.WebGLRenderer({canvas, preserveDrawingBuffer: true});
const loader = new KTX2Loader().setTranscoderPath("/npm/three/examples/jsm/libs/basis/").detectSupport(renderer);
// Texels of a level as they are stored, after the device's own decoder; what is linear there is made sRGB again.
const material = new three.RawShaderMaterial({
    glslVersion: three.GLSL3, depthTest: false,
    uniforms: {image: {value: null}, level: {value: 0}, what: {value: 0}},
    vertexShader: "in vec3 position; void main() { gl_Position = vec4(position, 1.0); }",
    fragmentShader: `precision highp float; uniform sampler2D image; uniform int level, what; out vec4 o;
        void main() {
            vec2 size = vec2(textureSize(image, level));
            vec4 t = texelFetch(image, ivec2(gl_FragCoord.x, size.y - gl_FragCoord.y), level);
            vec3 s = mix(12.92 * t.rgb, 1.055 * pow(t.rgb, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, t.rgb));
            o = vec4(what == 2 ? vec3(t.a) : what == 1 ? s : t.rgb, 1.0);
        }`});
const scene = new three.Scene(), mesh = new three.Mesh(new three.PlaneGeometry(2, 2), material);
mesh.frustumCulled = false;
scene.add(mesh);
window.load = (name) => {
    window.texture = window.failed = null;
    const failed = (error) => { window.failed = `${error}`; };
    loader.load(name, (texture) => { window.texture = texture; }, undefined, failed);
};
window.read = (level, what) => {
    const {width, height} = window.texture.mipmaps[level];
    renderer.setSize(width, height, false);
    window.texture.minFilter = three.NearestMipmapNearestFilter;
    material.uniforms.image.value = window.texture;
    material.uniforms.level.value = level;
    material.uniforms.what.value = what;
    renderer.render(scene, new three.Camera());
    return canvas.toDataURL("image/png");
};
window.ready = true;
</script>
"""


def picture(height: int, width: int, alpha: bool) -> np.ndarray:
    """A picture of slopes, with some noise."""
    y, x = np.mgrid[:height, :width] / max(height, width)
    waves = [0.5 + 0.3 * np.sin(2.0 * x + k) * np.cos(1.5 * y * (k + 1)) for k in range(3)]
    out = np.stack([*waves, np.ones_like(x)], axis=2)
    out[..., :3] += np.random.default_rng(3).normal(0.0, 0.005, out[..., :3].shape)
    if alpha:
        out[..., 3] = np.clip(1.5 - 2.0 * np.hypot(x - 0.5, y - 0.5), 0.0, 1.0)
    return np.rint(255.0 * out.clip(0.0, 1.0)).astype(np.uint8)


def head(file: bytes) -> dict[str, int]:
    """The numbers at the start of a file."""
    assert file[:12] == _export_ktx2.KTX2
    names = ["format", "type_size", "width", "height", "depth", "layers", "faces", "levels", "scheme"]
    return dict(zip(names, struct.unpack_from("<9I", file, 12), strict=True))


def seen(browser: Browser, level: int, what: int) -> np.ndarray:
    """Texels of a level: as they are, as sRGB, or their alpha."""
    data = browser.value(f"read({level}, {what})").partition(",")[2]
    with Image.open(io.BytesIO(base64.b64decode(data))) as image:
        return np.asarray(image.convert("RGB"))


@pytest.mark.slow
@pytest.mark.skipif(
    not (PACKAGES / "three").exists(), reason="three.js is not there; tools/tile-viewer fetches it"
)
def test_three_reads_every_level(tmp_path) -> None:
    cases = {
        "color": (picture(128, 256, False), True),
        "faded": (picture(128, 128, True), True),
        "data": (picture(64, 128, False), False),
        "both": (picture(128, 64, True), False),
        "small": (picture(4, 4, False), True),
        "long": (picture(4, 512, False), False),
    }
    (tmp_path / "page").mkdir()
    (tmp_path / "page" / "index.html").write_text(PAGE)
    for name, (pixels, color) in cases.items():
        (tmp_path / "page" / f"{name}.ktx2").write_bytes(encoded(pixels, color))
    with opened(tmp_path / "page", tmp_path / "chromium") as browser:
        browser.until("window.ready")
        for name, (pixels, color) in cases.items():
            browser.value(f"load('{name}.ktx2')")
            browser.until("window.texture || window.failed")
            assert browser.value("window.failed") is None
            levels = browser.value("window.texture.mipmaps.length")
            height, width = pixels.shape[:2]
            assert levels == max(height, width).bit_length()
            for level in range(levels):
                expected = halved(nrs.Image(pixels), level, color).pixels
                got = seen(browser, level, 1 if color else 0)
                alpha = seen(browser, level, 2)[..., 0]
                assert got.shape[:2] == expected.shape[:2]
                # Blocks hold few colours, and slopes get twice as steep with each level.
                least = {0: 37.0, 1: 34.0, 2: 30.0, 3: 25.0}.get(level, 18.0) if name != "small" else 18.0
                assert psnr(got, expected[..., :3]) >= least
                if min(got.shape[:2]) >= 8:
                    assert psnr(got[::-1], expected[..., :3]) < psnr(got, expected[..., :3]) - 6.0
                assert psnr(alpha, expected[..., 3]) >= min(least, 24.0)


def encoded(pixels: np.ndarray, color: bool) -> bytes:
    return _export_textures.encoded_as("ktx2", nrs.Image(pixels), color, Notes())[0]


@pytest.mark.parametrize("color", [True, False])
@pytest.mark.parametrize("size", [(1, 1), (2, 7), (5, 3), (6, 6), (30, 200), (33, 31), (1, 300)])
@pytest.mark.parametrize("alpha", [True, False])
def test_sides_are_multiples_of_four(size, alpha, color) -> None:
    found = head(encoded(picture(*size, alpha), color))
    sides = found["width"], found["height"]
    assert all(side % 4 == 0 and side >= 4 for side in sides)
    assert all(abs(side - own) <= max(2, 4 - own) for side, own in zip(sides, size[::-1], strict=True))
    assert found["levels"] == max(sides).bit_length()
    # Basis Universal has no format of Vulkan's; ETC1S comes with BasisLZ, UASTC with zstd.
    assert (found["format"], found["scheme"]) == (0, 1 if color else 2)


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
@pytest.mark.parametrize("value", [0, 255])
def test_images_of_one_value(channels, value) -> None:
    pixels = np.full((16, 16, channels), value, np.uint8)
    assert len(encoded(pixels, True)) < 2_000
    assert len(encoded(pixels, False)) < 2_000


def test_more_than_eight_bits() -> None:
    pixels = picture(16, 16, False)
    notes = Notes()
    wide = nrs.Image(pixels.astype(np.uint16) * 257)
    assert _export_textures.encoded_as("ktx2", wide, False, notes)[0] == encoded(pixels, False)
    with pytest.warns(UserWarning, match="images of more than 8 bits"):
        notes.warn("a.glb")


def test_the_same_bytes_each_time() -> None:
    """With any number of threads, and in a process of its own."""
    pixels = picture(96, 64, True)
    ours = [encoded(pixels, color) for color in (True, False)]
    for threads in (1, 2, 5):
        nrs.set_num_threads(threads)
        try:
            assert [encoded(pixels, color) for color in (True, False)] == ours
        finally:
            nrs.set_num_threads(0)
    script = (
        "import hashlib, test_ktx2 as t\n"
        "for color in (True, False): print(hashlib.sha256(t.encoded(t.picture(96, 64, True), color)).hexdigest())"
    )
    run = subprocess.run(
        [sys.executable, "-c", script],
        cwd=Path(__file__).parent,
        check=True,
        capture_output=True,
        text=True,
    )
    assert run.stdout.split() == [hashlib.sha256(one).hexdigest() for one in ours]


def test_levels_that_do_not_fit() -> None:
    level = np.zeros((8, 8, 4), np.uint8)
    for levels, message in (
        ([], "levels: expected a level at least, found none"),
        ([level, level], r"levels: level 1: expected \(4, 4, 4\), found \(8, 8, 4\)"),
        ([level[..., :3]], r"levels: level 0: expected \(8, 8, 4\), found \(8, 8, 3\)"),
        ([level[:0]], r"levels: expected 1 to 16384 texels a side, found \(0, 8\)"),
    ):
        with pytest.raises(nrs.ArgumentError, match=message):
            _core.encode_basis(levels, True)


def test_textures_refer_to_them(tmp_path) -> None:
    mesh = source()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        mesh.export(tmp_path / "a.gltf", levels=[1.0, 0.2], images="ktx2")
    found = json.loads((tmp_path / "a.gltf").read_text())
    data = (tmp_path / found["buffers"][0]["uri"]).read_bytes()
    assert "KHR_texture_basisu" in found["extensionsRequired"]
    assert {image["mimeType"] for image in found["images"]} == {"image/ktx2"}
    for texture in found["textures"]:
        assert "source" not in texture
        image = found["images"][texture["extensions"]["KHR_texture_basisu"]["source"]]
        start = found["bufferViews"][image["bufferView"]].get("byteOffset", 0)
        assert data[start:].startswith(_export_ktx2.KTX2)


def test_tiles_have_them(tmp_path) -> None:
    source().to_3dtiles(tmp_path / "t", triangles=1_500, images="ktx2")
    data = b"".join(path.read_bytes() for path in (tmp_path / "t").rglob("*") if path.is_file())
    assert _export_ktx2.KTX2 in data
    assert b"image/png" not in data
