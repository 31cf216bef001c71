"""The difference of two pictures: PSNR in decibels, FLIP as the eye sees it, and the distance of outlines.

The difference to the eye is FLIP for displays of low dynamic range (Andersson, Nilsson, Akenine-Möller, Oskarsson,
Åström and Fairchild, "FLIP: A Difference Evaluator for Alternating Images", HPG 2020), as OpenImageIO computes it
with the constants of the paper; ``pip install OpenImageIO`` installs it.

Examples
--------
>>> found = nrs.compare(frame, frame)
>>> found.psnr, found.flip, found.silhouette.max
(inf, 0.0, 0.0)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from nanite_rs import _checks, _colors, _images
from nanite_rs._arrays import as_array
from nanite_rs.exceptions import ArgumentError, DtypeError, InternalError
from nanite_rs.frame import Frame
from nanite_rs.measure import closest_points

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

__all__ = ["Comparison", "ImageLike", "SilhouetteDistance", "compare"]

ImageLike: TypeAlias = "Frame | ArrayLike"
"""A picture: a `Frame`, or an array (H, W, 3) or (H, W, 4) of uint8, uint16 or floats."""


@dataclass(frozen=True)
class SilhouetteDistance:
    """How far the outlines of two masks are apart, in pixels.

    An outline is the set of the centres of all edges between a covered pixel and one that is not; the border of the
    picture is none. Between masks that differ, of which one has no outline, both figures are infinite.
    """

    mean: float
    """Mean distance from a point of either outline to the other outline."""
    max: float
    """Largest of these distances: the Hausdorff distance of the outlines."""


@dataclass(frozen=True)
class Comparison:
    """How far two pictures are apart. Made by `compare`."""

    psnr: float
    """Peak signal-to-noise ratio in dB, over all pixels and the three colours as they are encoded; infinite where
    there is no difference."""
    flip: float
    """Mean of `flip_map`: 0 where no difference can be seen, at most 1."""
    flip_map: NDArray[np.float32]
    """FLIP of each pixel, (H, W) float32, 0 to 1."""
    difference: NDArray[np.uint8]
    """`flip_map` as a picture, (H, W, 3) uint8: black where no difference can be seen, then purple, orange and pale
    yellow (the colours called magma, which the tools of FLIP's authors use)."""
    silhouette: SilhouetteDistance | None
    """Distance of the outlines; None where a picture has no mask."""

    def __repr__(self) -> str:
        """Everything but the arrays."""
        s = self.silhouette
        outline = "" if s is None else f", silhouette mean {s.mean:.3g} and max {s.max:.3g} px"
        return f"Comparison(PSNR {self.psnr:.2f} dB, FLIP {self.flip:.4f}{outline})"


def compare(
    image: ImageLike,
    reference: ImageLike,
    *,
    mask: ArrayLike | None = None,
    reference_mask: ArrayLike | None = None,
    pixels_per_degree: float = 67.0,
) -> Comparison:
    """Compare a picture with a reference.

    Either may be the reference: swapping them changes nothing. Colours are compared as they are encoded, over the
    whole picture; alpha counts for the outline alone.

    Parameters
    ----------
    image, reference : Frame, or (H, W, 3) or (H, W, 4) array
        Pictures of one size, sRGB-encoded as files and displays have them: uint8, uint16, or floats from 0 to 1.
        Linear light has to be encoded first. They may differ in dtype.
    mask, reference_mask : (H, W) bool array
        What each picture covers, for the distance of outlines. By default of a frame where it has depth, and of
        an array with alpha where that is a half or more. Before a plain background:
        ``mask=(image != background).any(axis=-1)``.
    pixels_per_degree : float
        Pixels per degree of the observer's view, 2 to 1000: FLIP blurs what the eye would. 67 is the paper's
        (3840 pixels on 0.7 m, seen from 0.7 m).

    Returns
    -------
    Comparison

    Raises
    ------
    ArgumentError, DtypeError
        For sizes, numbers of channels or dtypes that do not fit, one mask without the other, and for values that
        are not finite or out of range, with the index; the message begins with the argument's name.
    DependencyError
        Without OpenImageIO.

    Examples
    --------
    >>> mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.displaced_icosphere(faces=20_000))
    >>> scene = nrs.Scene(ambient_light=(0.5, 0.5, 0.5))
    >>> node = scene.add(mesh)
    >>> pose = np.eye(4)
    >>> pose[2, 3] = 4.0
    >>> camera = nrs.PerspectiveCamera(yfov=0.8)
    >>> with nrs.Renderer(128, 72) as renderer:
    ...     full, cut = (renderer.render(scene, camera, pose, pixel_error=e) for e in (0.0, 1.0))
    >>> found = nrs.compare(cut, full)
    >>> found.psnr > 25, found.flip < 0.05, found.silhouette.max <= 2.0
    (True, True, True)
    >>> found.difference.shape, found.difference.dtype
    ((72, 128, 3), dtype('uint8'))
    """
    shown, covered = _picture(image, "image", mask, "mask")
    expected, reference_covered = _picture(reference, "reference", reference_mask, "reference_mask")
    if shown.shape != expected.shape:
        sizes = [f"{width} × {height}" for height, width, _ in (shown.shape, expected.shape)]
        raise ArgumentError(f"image: must be as large as the reference, {sizes[1]} pixels, not {sizes[0]}")
    pixels_per_degree = _checks.number(pixels_per_degree, "pixels_per_degree")
    if not 2.0 <= pixels_per_degree <= 1000.0:
        raise ArgumentError(f"pixels_per_degree: must be between 2 and 1000, not {pixels_per_degree}")
    if mask is not None and reference_covered is None:
        raise ArgumentError("reference_mask: mask needs one to compare with, and the reference has no alpha")
    if reference_mask is not None and covered is None:
        raise ArgumentError("mask: reference_mask needs one to compare with, and the image has no alpha")
    error = float(np.mean((shown - expected) ** 2))
    flip_map, difference = _flip(shown, expected, pixels_per_degree)
    outlines = None
    if covered is not None and reference_covered is not None:
        outlines = _silhouette_distance(covered, reference_covered)
    return Comparison(
        psnr=-10.0 * float(np.log10(error)) if error > 0.0 else float("inf"),
        flip=float(flip_map.mean(dtype=np.float64)),
        flip_map=flip_map,
        difference=difference,
        silhouette=outlines,
    )


def _picture(
    image: ImageLike, name: str, mask: ArrayLike | None, mask_name: str
) -> tuple[NDArray[np.float64], NDArray[np.bool_] | None]:
    """Colours, (H, W, 3) from 0 to 1 as encoded, and what is covered."""
    array: NDArray[Any]
    covered: NDArray[np.bool_] | None
    try:
        array, covered = (
            (image.color, image.depth > 0) if isinstance(image, Frame) else (np.asarray(image), None)
        )
    except ValueError as error:  # rows of different lengths, or a frame of depth alone
        raise ArgumentError(f"{name}: {error}") from None
    if array.ndim != 3 or array.shape[2] not in (3, 4) or array.size == 0:
        raise ArgumentError(f"{name}: expected shape (H, W, 3) or (H, W, 4), found {array.shape}")
    if array.dtype.kind == "u" and array.dtype.itemsize <= 2:
        values = array / np.float64(np.iinfo(array.dtype).max)
    elif array.dtype.kind == "f":
        wrong = np.argwhere(~((array >= 0.0) & (array <= 1.0)))
        if len(wrong):
            place = tuple(map(int, wrong[0]))
            raise ArgumentError(f"{name}: floats must be between 0 and 1, not {array[place]} at {place}")
        values = array.astype(np.float64)
    else:
        raise DtypeError(f"{name}: expected uint8, uint16 or a floating-point dtype, not {array.dtype}")
    if array.shape[2] == 4:
        covered = values[..., 3] >= 0.5
    if mask is not None:
        covered = as_array(mask, mask_name)
        if covered.dtype != np.bool_:
            raise DtypeError(f"{mask_name}: expected bool, not {covered.dtype}")
        if covered.shape != array.shape[:2]:
            raise ArgumentError(f"{mask_name}: expected shape {array.shape[:2]}, found {covered.shape}")
    return values[..., :3], covered


def _flip(
    image: NDArray[np.float64], reference: NDArray[np.float64], pixels_per_degree: float
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """FLIP of each pixel, and it in colours."""
    oiio = _images.openimageio("compare")

    def pixels(buffer: Any) -> NDArray[np.float32]:
        if buffer.has_error:  # asking such a buffer for its pixels would end the process
            raise InternalError(f"OpenImageIO: {buffer.geterror()}")
        found: NDArray[np.float32] = buffer.get_pixels(oiio.FLOAT)
        return found

    # Images without a colour space are taken as linear, whatever the configuration of OpenColorIO.
    linear = (np.ascontiguousarray(_colors.from_srgb(x), np.float32) for x in (reference, image))
    # On this thread alone: a forked process would lack other threads, and they gain little.
    buffers = map(oiio.ImageBuf, linear)
    flip = oiio.ImageBufAlgo.FLIP_diff(*buffers, hdr=0, ppd=pixels_per_degree, nthreads=1)
    flip_map = pixels(flip)[..., 0].copy()
    magma = _colors.to_srgb(pixels(oiio.ImageBufAlgo.color_map(flip, 0, "magma", nthreads=1)))
    return flip_map, np.rint(255.0 * magma).astype(np.uint8)


def _outline(mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Centres of the edges between covered pixels and others: (N, 3), x to the right, y downwards, z 0."""
    rows, columns = np.nonzero(mask[:, 1:] != mask[:, :-1])
    upright = np.stack([columns + 1.0, rows + 0.5, np.zeros(len(rows))], axis=1)
    rows, columns = np.nonzero(mask[1:] != mask[:-1])
    level = np.stack([columns + 0.5, rows + 1.0, np.zeros(len(rows))], axis=1)
    return np.concatenate([upright, level])


def _silhouette_distance(a: NDArray[np.bool_], b: NDArray[np.bool_]) -> SilhouetteDistance:
    if np.array_equal(a, b):
        return SilhouetteDistance(0.0, 0.0)
    first, second = _outline(a), _outline(b)
    if not (len(first) and len(second)):
        return SilhouetteDistance(np.inf, np.inf)

    def away(points: NDArray[np.float64], outline: NDArray[np.float64]) -> NDArray[np.float64]:
        # A triangle of one corner three times is a point.
        return closest_points(points, (outline, np.arange(len(outline))[:, None].repeat(3, axis=1))).distances

    there, back = away(first, second), away(second, first)
    mean = (there.sum() + back.sum()) / (len(there) + len(back))
    return SilhouetteDistance(float(mean), float(max(there.max(), back.max())))
