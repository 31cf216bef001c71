"""Several samples of a pixel, and colour in linear light: against pyrender, in files, and wrong arguments."""

from __future__ import annotations

import numpy as np
import OpenImageIO as oiio
import pytest
from PIL import Image
from scipy import ndimage

import nanite_rs as nrs
from conftest import SOAK
from oracles import compare, picture, subjects
from oracles.camera import at
from oracles.setup import setup

LENS = nrs.PerspectiveCamera(yfov=0.8)
SAMPLES = (1, 4, 16)


def scene() -> nrs.Scene:
    out = nrs.Scene(ambient_light=(0.1, 0.1, 0.1), bg_color=(0.5, 0.25, 0.0))
    for k in range(3):
        out.add(subjects.built("small sphere"), pose=at(1.2 * k - 1.2, 0.1 * k, -k))
    out.add(nrs.DirectionalLight(intensity=3.0))
    return out


@pytest.fixture(scope="module", params=("cpu", "gpu"))
def renderer(request):
    try:
        with nrs.Renderer(160, 120, backend=request.param) as made:
            yield made
    except nrs.BackendError as error:
        pytest.skip(str(error))


def shot(renderer, **options) -> nrs.Frame:
    return renderer.render(scene(), LENS, at(0.1, 0.2, 4), **options)


@pytest.mark.parametrize("name", ["bunny", *(["fine knot"] if SOAK else [])])
@pytest.mark.parametrize("backend", ["cpu", "gpu"])
def test_more_samples_are_nearer_to_pyrenders_finer_picture(name, backend, tmp_path):
    """Truth: pyrender at full detail, 4×4 samples averaged in linear light (γ = 2.2), compared as encoded."""
    picture.import_pyrender()
    s = setup(name)
    view = s.view.with_size(480, 270)
    fine, _ = s.oracle().render(view.with_size(4 * view.width, 4 * view.height))
    truth = compare.average_linear(fine, 4)
    camera = nrs.PerspectiveCamera(yfov=view.yfov, znear=view.znear)
    try:
        with nrs.Renderer(view.width, view.height, backend=backend) as renderer:
            frames = [
                renderer.render(s.scene(), camera, view.pose, pixel_error=0.0, samples=n) for n in SAMPLES
            ]
    except nrs.BackendError as error:
        pytest.skip(str(error))
    covered = (frames[0].depth > 0) | (truth.max(axis=-1) > 0)
    one, four, sixteen = (compare.psnr(frame.color, truth, covered) for frame in frames)
    print(f"{name} on {backend}: {one:.2f}, {four:.2f}, {sixteen:.2f} dB with 1, 4, 16 samples")
    with compare.evidence(tmp_path / f"{name}.png", frames[-1].color, truth):
        assert four > one + 6
        assert sixteen > four + 4
        assert sixteen > 42


def test_silhouettes_are_soft_and_all_else_is_of_the_centre(renderer):
    plain = shot(renderer)
    assert plain.stats.samples == 1
    for samples in SAMPLES[1:]:
        frame = shot(renderer, samples=samples)
        assert (frame.stats.samples, frame.metadata["samples"]) == (samples, samples)
        for name in ("depth", "normal", "instance_id", "cluster_id", "triangle_id", "face_id", "overdraw"):
            np.testing.assert_array_equal(getattr(frame, name), getattr(plain, name))
        for name in ("triangles", "clusters", "groups", "levels"):
            np.testing.assert_array_equal(frame.view(name), plain.view(name))
        np.testing.assert_array_equal(frame.view("shaded"), frame.color)
        changed = (frame.color != plain.color).any(-1)
        covered = plain.depth > 0
        assert np.count_nonzero(changed & ~covered) > 100
        assert not changed[~around(covered)].any()
        assert frame.stats.clusters == plain.stats.clusters
        assert frame.stats["shade"].received > plain.stats["shade"].received


def test_one_sample_is_the_default(renderer):
    np.testing.assert_array_equal(shot(renderer, samples=1, transfer="gamma22").color, shot(renderer).color)


def around(covered: np.ndarray) -> np.ndarray:
    """Pixels that are covered or next to one that is."""
    return ndimage.binary_dilation(covered, np.ones((3, 3)))


def curve(name: str, light: np.ndarray) -> np.ndarray:
    """The published curves, on 0 to 1."""
    c = np.clip(light.astype(np.float64), 0, 1)
    if name == "srgb":
        return np.where(c <= 0.0031308, 12.92 * c, 1.055 * c ** (1 / 2.4) - 0.055)
    return c if name == "linear" else c ** (1 / 2.2)


@pytest.mark.parametrize("transfer", ["gamma22", "srgb", "linear"])
@pytest.mark.parametrize("samples", SAMPLES)
def test_color_and_16_bits_are_linear_light_encoded(renderer, tmp_path, transfer, samples):
    frame = shot(renderer, samples=samples, transfer=transfer)
    assert (frame.linear.dtype, frame.linear.shape) == (np.float32, (120, 160, 3))
    assert np.isfinite(frame.linear).all()
    # On a device a few colours are rounded the other way.
    expected = curve(transfer, frame.linear)
    assert np.abs(255 * expected - frame.color).max() <= (0.5001 if renderer.backend == "cpu" else 1)
    assert (frame.color[~around(frame.depth > 0)] == (128, 64, 0)).all()
    frame.save(tmp_path / "frame.png", bits=16)
    stored = oiio.ImageBuf(str(tmp_path / "frame.png"))
    assert str(stored.spec().format) == "uint16"
    assert np.abs(65535 * expected - stored.get_pixels(oiio.UINT16)).max() <= 0.501
    with Image.open(tmp_path / "frame.png") as image:
        assert image.text["nanite_rs:transfer"] == frame.metadata["transfer"] == transfer
        assert image.text["Software"] == frame.metadata["software"]


@pytest.mark.parametrize("name", ["color", "linear"])
def test_an_exr_holds_linear_light(renderer, tmp_path, name):
    frame = shot(renderer, samples=4)
    frame.save(tmp_path / "frame.exr", outputs=[name, "depth"])
    image = oiio.ImageBuf(str(tmp_path / "frame.exr"))
    assert sorted(image.spec().channelnames) == ["B", "G", "R", "Z"]
    pixels = image.get_pixels(oiio.FLOAT)
    order = [image.spec().channelnames.index(channel) for channel in "RGBZ"]
    np.testing.assert_array_equal(pixels[..., order[:3]], frame.linear)
    np.testing.assert_array_equal(pixels[..., order[3]], frame.depth)


def test_light_is_not_cut_off(renderer):
    bright = nrs.Scene(ambient_light=(0.0, 0.0, 0.0))
    bright.add(subjects.built("small sphere"))
    bright.add(nrs.DirectionalLight(intensity=100.0))
    frame = renderer.render(bright, LENS, at(0, 0, 3), samples=4, outputs=["linear"])
    assert frame.linear.max() > 4
    assert frame.color.max() == 255


def test_every_view_has_its_samples(renderer):
    poses = [at(0.1, 0.2, 4), at(0.4, 0.2, 5)]
    together = renderer.render_views(scene(), [(LENS, pose) for pose in poses], samples=4)
    for frame, pose in zip(together, poses, strict=True):
        alone = renderer.render(scene(), LENS, pose, samples=4)
        np.testing.assert_array_equal(frame.color, alone.color)
        np.testing.assert_array_equal(frame.linear, alone.linear)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"samples": 0}, nrs.ArgumentError, "samples: must be 1, 4 or 16, not 0"),
        ({"samples": 2}, nrs.ArgumentError, "samples: must be 1, 4 or 16, not 2"),
        ({"samples": -4}, nrs.ArgumentError, "samples: .*-4"),
        ({"samples": 1 << 40}, nrs.ArgumentError, "samples: "),
        ({"samples": 4.0}, nrs.DtypeError, "samples: expected an integer, not float"),
        ({"samples": True}, nrs.DtypeError, "samples: expected an integer, not bool"),
        ({"samples": 4, "depth_only": True}, nrs.ArgumentError, "samples: with depth_only"),
        ({"transfer": "rec709"}, nrs.ArgumentError, 'transfer: must be .*, not "rec709"'),
        ({"outputs": ["linear"], "depth_only": True}, nrs.ArgumentError, "outputs: .*linear"),
    ],
)
def test_wrong_arguments_are_named(options, error, message):
    with nrs.Renderer(16, 12, backend="cpu") as renderer, pytest.raises(error, match=message):
        shot(renderer, **options)


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("frame.png", {"bits": 12}, "bits: must be 8 or 16, not 12"),
        ("frame.png", {"bits": 16, "view": "levels"}, "bits: the view 'levels' has 8"),
        ("frame.exr", {"bits": 16}, "bits: an .exr"),
    ],
)
def test_wrong_bits_are_named(tmp_path, name, options, message):
    with nrs.Renderer(16, 12, backend="cpu") as renderer, pytest.raises(nrs.ArgumentError, match=message):
        shot(renderer).save(tmp_path / name, **options)
    assert not list(tmp_path.iterdir())
