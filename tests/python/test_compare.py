"""Comparisons of pictures, against the FLIP of its authors, OpenImageIO's noise ratio, and SciPy's distances."""

from __future__ import annotations

import os
import subprocess
import sys

import flip_evaluator
import numpy as np
import OpenImageIO as oiio
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from PIL import Image, ImageDraw, ImageFilter
from scipy import ndimage
from scipy.spatial.distance import cdist, directed_hausdorff

import nanite_rs as nrs
from oracles.camera import at

FLIP_TOLERANCE = 1e-3
LENS = nrs.PerspectiveCamera(yfov=0.8)


@pytest.fixture(scope="module")
def frames() -> list[nrs.Frame]:
    """At full detail, at one pixel of error and at eight."""
    scene = nrs.Scene(ambient_light=(0.06, 0.06, 0.07), bg_color=(0.92, 0.93, 0.95))
    mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.displaced_icosphere(faces=100_000), progress=False)
    scene.add(mesh)
    scene.add(nrs.DirectionalLight(intensity=3.0))
    with nrs.Renderer(160, 120, backend="cpu") as renderer:
        return [renderer.render(scene, LENS, at(0, 0, 3), pixel_error=error) for error in (0.0, 1.0, 8.0)]


def noisy(seed: int, shape=(53, 71, 3), amount=0.1) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    reference = rng.random(shape)
    return np.clip(reference + rng.normal(0, amount, shape), 0, 1), reference


def drawn() -> tuple[np.ndarray, np.ndarray]:
    """A picture with edges, flat areas and colours; and it blurred, with a line added."""
    picture = Image.new("RGB", (120, 80), (30, 60, 120))
    pen = ImageDraw.Draw(picture)
    pen.ellipse((20, 10, 70, 60), fill=(250, 200, 20))
    pen.rectangle((80, 30, 110, 70), fill=(255, 255, 255), outline=(0, 0, 0))
    other = picture.filter(ImageFilter.GaussianBlur(1.5))
    ImageDraw.Draw(other).line((0, 79, 119, 0), fill=(200, 0, 0))
    return np.asarray(other), np.asarray(picture)


def authors_flip(image, reference, pixels_per_degree=67.0) -> np.ndarray:
    as_float = [
        np.ascontiguousarray(x / 255 if x.dtype == np.uint8 else x, np.float32) for x in (image, reference)
    ]
    found, _, _ = flip_evaluator.evaluate(
        as_float[1], as_float[0], "LDR", applyMagma=False, parameters={"ppd": pixels_per_degree}
    )
    return found.reshape(found.shape[:2])


# ------------------------------------------------------------------------------------------------ FLIP, noise


@pytest.mark.parametrize("pixels_per_degree", [2, 10.0, 30.0, 67.0, 120.5, 400.0])
@pytest.mark.parametrize("pair", [noisy(0), noisy(1, amount=0.01), drawn()], ids=["noise", "little", "drawn"])
def test_flip_is_its_authors(pair, pixels_per_degree):
    found = nrs.compare(*pair, pixels_per_degree=pixels_per_degree)
    expected = authors_flip(*pair, float(pixels_per_degree))
    assert found.flip_map.dtype == np.float32
    assert found.flip_map.shape == pair[0].shape[:2]
    np.testing.assert_allclose(found.flip_map, expected, atol=FLIP_TOLERANCE)
    assert found.flip == pytest.approx(expected.mean(), abs=FLIP_TOLERANCE / 10)
    assert found.flip == pytest.approx(found.flip_map.mean(dtype=np.float64), abs=1e-12)


@pytest.mark.parametrize("shape", [(1, 1, 3), (1, 9, 3), (7, 2, 3)])
def test_flip_of_small_pictures_is_its_authors(shape):
    pair = noisy(3, shape)
    np.testing.assert_allclose(nrs.compare(*pair).flip_map, authors_flip(*pair), atol=FLIP_TOLERANCE)


def test_frames_against_the_authors(frames):
    full, fine, coarse = frames
    found = [nrs.compare(f, full) for f in (fine, coarse)]
    for frame, one in zip((fine, coarse), found, strict=True):
        expected = authors_flip(frame.color, full.color)
        np.testing.assert_allclose(one.flip_map, expected, atol=FLIP_TOLERANCE)
    assert 0 < found[0].flip < found[1].flip
    assert found[0].psnr > found[1].psnr
    assert found[0].silhouette.mean < found[1].silhouette.mean
    assert found[0].silhouette.max <= 2  # the cut keeps to one pixel, and pixels to half of one either way
    arrays_too = nrs.compare(coarse.color, full.color)
    np.testing.assert_array_equal(arrays_too.flip_map, found[1].flip_map)
    assert arrays_too.psnr == found[1].psnr
    assert arrays_too.silhouette is None


@pytest.mark.parametrize("pair", [noisy(5), drawn()], ids=["noise", "drawn"])
def test_psnr_is_openimageios(pair):
    first, second = (
        oiio.ImageBuf(np.ascontiguousarray(x / (255 if x.dtype == np.uint8 else 1))) for x in pair
    )
    expected = oiio.ImageBufAlgo.compare(first, second, 0.0, 0.0)
    assert nrs.compare(*pair).psnr == pytest.approx(expected.PSNR, abs=1e-6)


def test_psnr_by_hand():
    black = np.zeros((4, 5, 3), np.uint8)
    white = np.full_like(black, 255)
    assert nrs.compare(black, white).psnr == 0.0
    tenth = np.full(black.shape, 0.1)
    assert nrs.compare(tenth, black).psnr == pytest.approx(20.0, abs=1e-9)


def test_the_difference_is_the_authors_picture():
    pair = drawn()
    found = nrs.compare(*pair).difference
    as_float = [np.ascontiguousarray(x / 255, np.float32) for x in pair]
    expected, _, _ = flip_evaluator.evaluate(as_float[1], as_float[0], "LDR", parameters={"ppd": 67.0})
    assert found.dtype == np.uint8
    assert found.shape == pair[0].shape
    # OpenImageIO interpolates between 17 of the 256 colours.
    assert np.abs(found - 255.0 * expected).max() < 8
    assert np.abs(found - 255.0 * expected).mean() < 2


def test_no_configuration_of_colours_matters():
    code = (
        "import numpy as np, nanite_rs as nrs\n"
        "a = np.random.default_rng(0).integers(0, 256, (9, 9, 3), np.uint8)\n"
        "found = nrs.compare(a, a[::-1])\n"
        "print(found.flip, found.difference.sum())"
    )
    printed = {
        subprocess.run(
            [sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True
        ).stdout
        for env in (None, {**os.environ, "OCIO": "/nowhere/config.ocio"})
    }
    assert len(printed) == 1


# --------------------------------------------------------------------------------------------------- dtypes


def test_dtypes_mean_the_same():
    a, b = (np.random.default_rng(k).integers(0, 256, (20, 30, 3), np.uint8) for k in (0, 1))
    expected = nrs.compare(a, b)
    for other in (
        a.astype(np.uint16) * 257,
        (a.astype(np.uint16) * 257).astype(">u2"),
        a / 255,
        np.float32(a / 255),
        np.asfortranarray(a),
        Image.fromarray(a),
        np.dstack([a, np.zeros((20, 30), np.uint8)]),
    ):
        found = nrs.compare(other, b)
        assert found.psnr == pytest.approx(expected.psnr, abs=1e-5)
        assert found.flip == pytest.approx(expected.flip, abs=1e-6)
    kept = a.copy()
    nrs.compare(a, b)
    np.testing.assert_array_equal(a, kept)


# ----------------------------------------------------------------------------------------------- properties

pictures = arrays.array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=12).flatmap(
    lambda s: st.tuples(*[arrays.arrays(np.uint8, (*s, 3)) for _ in range(2)])
)
masks = arrays.array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=10).flatmap(
    lambda s: st.tuples(*[arrays.arrays(np.bool_, s) for _ in range(3)])
)


@settings(deadline=None, max_examples=100)
@given(pictures, st.floats(2, 200))
def test_bounds_identity_and_symmetry(pair, pixels_per_degree):
    a, b = pair
    there = nrs.compare(a, b, pixels_per_degree=pixels_per_degree)
    back = nrs.compare(b, a, pixels_per_degree=pixels_per_degree)
    assert there.psnr == back.psnr >= 0
    np.testing.assert_array_equal(there.flip_map, back.flip_map)
    assert there.flip_map.min() >= 0
    assert there.flip_map.max() <= 1
    assert 0 <= there.flip <= 1
    same = nrs.compare(a, a, pixels_per_degree=pixels_per_degree)
    assert (same.psnr, same.flip, same.flip_map.max()) == (np.inf, 0, 0)
    assert same.difference.max() <= 4  # where magma begins


@settings(deadline=None, max_examples=200)
@given(masks)
def test_silhouettes_are_at_scipys_distance(triple):
    a, b = triple[:2]
    points = [edges(m) for m in triple]
    found = {pair: silhouette(triple[pair[0]], triple[pair[1]]) for pair in ((0, 1), (1, 0), (1, 2), (0, 2))}
    assert found[0, 1] == found[1, 0]
    if np.array_equal(a, b):
        assert (found[0, 1].mean, found[0, 1].max) == (0, 0)
    elif len(points[0]) and len(points[1]):
        p, q = points[:2]
        largest = max(directed_hausdorff(p, q)[0], directed_hausdorff(q, p)[0])
        assert found[0, 1].max == pytest.approx(largest, rel=1e-12)
        away = cdist(p, q)
        nearest = np.concatenate([away.min(axis=1), away.min(axis=0)])
        assert found[0, 1].mean == pytest.approx(nearest.mean(), rel=1e-12)
        assert found[0, 1].mean <= found[0, 1].max
        assert silhouette(~a, ~b) == found[0, 1]
        if len(points[2]):
            assert found[0, 2].max <= found[0, 1].max + found[1, 2].max + 1e-9
    else:
        assert (found[0, 1].mean, found[0, 1].max) == (np.inf, np.inf)


def edges(mask: np.ndarray) -> np.ndarray:
    """Centres of the edges between pixels that differ, one by one."""
    found = []
    for (row, column), value in np.ndenumerate(mask):
        if column + 1 < mask.shape[1] and mask[row, column + 1] != value:
            found.append((column + 1, row + 0.5))
        if row + 1 < mask.shape[0] and mask[row + 1, column] != value:
            found.append((column + 0.5, row + 1))
    return np.array(found, float).reshape(-1, 2)


def silhouette(mask, reference_mask) -> nrs.SilhouetteDistance:
    blank = np.zeros((*mask.shape, 3), np.uint8)
    return nrs.compare(blank, blank, mask=mask, reference_mask=reference_mask).silhouette


# ----------------------------------------------------------------------------------------------- silhouettes


def test_silhouettes_by_hand():
    square = np.zeros((40, 50), bool)
    square[10:20, 10:20] = True
    moved = np.roll(square, 3, axis=1)
    assert silhouette(square, moved).max == 3
    assert silhouette(square, np.roll(square, (3, 4), axis=(0, 1))).max == 5
    spot = square.copy()
    spot[30, 40] = True
    assert silhouette(square, spot).max == pytest.approx(np.hypot(41 - 20, 30.5 - 19.5))
    columns = np.broadcast_to(np.arange(50), square.shape)  # the border of the picture is no outline
    assert silhouette(columns < 25, columns < 27) == nrs.SilhouetteDistance(2.0, 2.0)
    assert silhouette(columns < 25, columns < 50) == nrs.SilhouetteDistance(np.inf, np.inf)
    assert silhouette(columns < 0, columns < 50) == nrs.SilhouetteDistance(np.inf, np.inf)
    assert silhouette(columns < 50, columns < 50) == nrs.SilhouetteDistance(0.0, 0.0)


def test_silhouettes_of_shapes_by_distance_transform():
    """On a grid twice as fine every centre of an edge is a sample, whose distances SciPy finds exactly."""
    rows, columns = np.mgrid[:200, :260]
    disk = np.hypot(rows - 100, columns - 120) < 60
    blob = np.hypot((rows - 105) / 1.2, columns - 128) < 55 + 8 * np.sin(
        np.arctan2(rows - 105, columns - 128) * 5
    )
    fine = []
    for mask in (disk, blob):
        grid = np.zeros((401, 521), bool)
        x, y = (2 * edges(mask)).astype(int).T
        grid[y, x] = True
        fine.append(grid)
    away = [ndimage.distance_transform_edt(~grid) / 2 for grid in fine]
    distances = np.concatenate([away[1][fine[0]], away[0][fine[1]]])
    found = silhouette(disk, blob)
    assert found.max == pytest.approx(distances.max(), rel=1e-12)
    assert found.mean == pytest.approx(distances.mean(), rel=1e-12)


def test_masks_come_from_frames_alpha_or_the_caller(frames):
    full, _, coarse = frames
    expected = nrs.compare(coarse, full).silhouette
    assert expected.max > 0
    covered = [f.depth > 0 for f in (coarse, full)]
    rgba = [np.dstack([f.color, np.where(f.depth > 0, 255, 127).astype(np.uint8)]) for f in (coarse, full)]
    assert nrs.compare(*rgba).silhouette == expected
    assert nrs.compare(rgba[0], full).silhouette == expected
    assert nrs.compare(coarse.color, full, mask=covered[0]).silhouette == expected
    given = nrs.compare(coarse.color, full.color, mask=covered[0], reference_mask=covered[1])
    assert given.silhouette == expected
    overruled = nrs.compare(coarse, full, mask=covered[1])
    assert overruled.silhouette == nrs.SilhouetteDistance(0.0, 0.0)
    background = full.color[0, 0]
    plain = [(f.color != background).any(axis=-1) for f in (coarse, full)]
    assert nrs.compare(coarse, full, mask=plain[0], reference_mask=plain[1]).silhouette == expected


def test_results_are_plain(frames):
    found = nrs.compare(frames[2], frames[0])
    assert (type(found.psnr), type(found.flip), type(found.silhouette.max)) == (float, float, float)
    for array in (found.flip_map, found.difference):
        assert array.flags.c_contiguous
        assert array.flags.owndata
        assert array.flags.writeable
    assert "dB" in repr(found)
    assert "px" in repr(found)
    with pytest.raises(AttributeError):
        found.flip = 0.0


# ---------------------------------------------------------------------------------------------------- refusals

GOOD = np.zeros((6, 8, 3), np.uint8)


def spoiled(value: float, dtype=np.float32) -> np.ndarray:
    out = np.zeros((6, 8, 3), dtype)
    out[2, 5, 1] = value
    return out


@pytest.mark.parametrize(
    ("arguments", "options", "error", "message"),
    [
        ((GOOD[:5], GOOD), {}, nrs.ArgumentError, r"image: .*reference, 8 × 6 pixels, not 8 × 5"),
        ((GOOD, GOOD[:, :, :1]), {}, nrs.ArgumentError, r"reference: expected shape .*found \(6, 8, 1\)"),
        ((GOOD[..., 0], GOOD), {}, nrs.ArgumentError, r"image: expected shape .*found \(6, 8\)"),
        ((GOOD[:0], GOOD), {}, nrs.ArgumentError, r"image: expected shape .*found \(0, 8, 3\)"),
        (([[1, 2], [3]], GOOD), {}, nrs.ArgumentError, "image: "),
        ((None, GOOD), {}, nrs.ArgumentError, "image: expected shape"),
        ((GOOD, GOOD.astype(np.int32)), {}, nrs.DtypeError, "reference: expected uint8, .*not int32"),
        ((GOOD > 0, GOOD), {}, nrs.DtypeError, "image: .*not bool"),
        ((GOOD.astype(complex), GOOD), {}, nrs.DtypeError, "image: .*not complex128"),
        ((GOOD, spoiled(np.nan)), {}, nrs.ArgumentError, r"reference: .*not nan at \(2, 5, 1\)"),
        ((spoiled(np.inf, float), GOOD), {}, nrs.ArgumentError, r"image: .*not inf at \(2, 5, 1\)"),
        ((spoiled(1.5, np.float16), GOOD), {}, nrs.ArgumentError, r"image: .*not 1\.5 at \(2, 5, 1\)"),
        ((spoiled(-0.25), GOOD), {}, nrs.ArgumentError, r"image: .*not -0\.25 at \(2, 5, 1\)"),
        (
            (GOOD, GOOD),
            {"pixels_per_degree": 1.0},
            nrs.ArgumentError,
            "pixels_per_degree: .*2 and 1000, not 1",
        ),
        ((GOOD, GOOD), {"pixels_per_degree": np.nan}, nrs.ArgumentError, "pixels_per_degree: .*not nan"),
        ((GOOD, GOOD), {"pixels_per_degree": "67"}, nrs.DtypeError, "pixels_per_degree: expected a number"),
        ((GOOD, GOOD), {"mask": GOOD[..., 0]}, nrs.DtypeError, "mask: expected bool, not uint8"),
        ((GOOD, GOOD), {"reference_mask": GOOD > 0}, nrs.ArgumentError, r"reference_mask: .*\(6, 8\), found"),
        ((GOOD, GOOD), {"mask": GOOD[..., 0] > 0}, nrs.ArgumentError, "reference_mask: mask needs one"),
        (
            (GOOD, GOOD),
            {"reference_mask": GOOD[..., 0] > 0},
            nrs.ArgumentError,
            "^mask: reference_mask needs",
        ),
    ],
)
def test_what_does_not_fit_is_named(arguments, options, error, message):
    with pytest.raises(error, match=message):
        nrs.compare(*arguments, **options)


def test_a_frame_of_depth_alone_has_no_colour():
    with nrs.Renderer(8, 6, backend="cpu") as renderer:
        frame = renderer.render(nrs.Scene(), LENS, at(0, 0, 3), depth_only=True)
    with pytest.raises(nrs.ArgumentError, match=r"reference: .*no color"):
        nrs.compare(GOOD, frame)


def test_without_openimageio(monkeypatch):
    monkeypatch.setitem(sys.modules, "OpenImageIO", None)
    with pytest.raises(nrs.DependencyError, match=r"compare: OpenImageIO is needed; pip install OpenImageIO"):
        nrs.compare(GOOD, GOOD)
