"""Animations: frames as GIF and WebP files by Pillow, as MP4 by PyAV.

Examples
--------
>>> mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.torus_knot(faces=5_000))
>>> scene, camera = nrs.Scene(ambient_light=(0.5, 0.5, 0.5)), nrs.PerspectiveCamera(yfov=0.8)
>>> node = scene.add(mesh)
>>> with nrs.Renderer(64, 48) as renderer:
...     frames = [renderer.render(scene, camera, pose) for pose in nrs.orbit(mesh, 8, yfov=0.8)]
>>> nrs.save_animation("around.gif", frames, fps=10)
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np

from nanite_rs import _advice, _checks
from nanite_rs._images import beside
from nanite_rs.exceptions import ArgumentError, DtypeError, FormatError
from nanite_rs.frame import Frame

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    import PIL.Image
    from numpy.typing import NDArray

__all__ = ["save_animation"]


def save_animation(
    path: str | os.PathLike[str], frames: Iterable[Frame | NDArray[np.uint8]], *, fps: float = 25.0
) -> None:
    """Write pictures one after the other: GIF and WebP, which repeat for ever, or MP4.

    The file is written to the side and renamed, so that there is a whole one or none. Frames may come from a
    generator: an MP4 keeps one at a time in memory, the other formats all.

    Parameters
    ----------
    path : path
        The file, replaced if it exists. ``.gif`` has 256 colours in a frame and is shown everywhere; ``.webp`` has
        all colours, with hardly visible loss; ``.mp4`` is H.264 and the smallest. That takes PyAV, which
        ``pip install av`` installs; of a picture with an odd number of columns or rows it repeats
        the last one, since H.264 has even ones.
    frames : iterable of Frame or (H, W, 3) uint8 arrays
        The pictures, all of one size: `Frame.color`, or such as `Frame.view` gives.
    fps : float
        Frames a second, up to 1000. A GIF shows each for a whole number of hundredths of a second, one at least.

    Raises
    ------
    FormatError
        If the name ends otherwise.
    ArgumentError, DtypeError
        There are no frames, they differ in size or are no pictures, or `fps` is out of range.
    DependencyError
        For an MP4 without PyAV.
    FileError
        If the file cannot be written.

    Examples
    --------
    >>> fading = [np.full((32, 48, 3), grey, np.uint8) for grey in range(0, 256, 16)]
    >>> nrs.save_animation("fading.gif", fading, fps=8)
    >>> from PIL import Image
    >>> Image.open("fading.gif").n_frames
    16
    """
    name = _checks.path_of(path)
    ending = os.path.splitext(name)[1].lower()
    if ending not in (".gif", ".webp", ".mp4"):
        raise FormatError(
            f"{name}: animations are saved as .gif, .webp or .mp4, not {ending or 'without ending'}"
        )
    if isinstance(fps, bool) or not isinstance(fps, int | float | np.integer | np.floating):
        raise DtypeError(f"fps: expected a number, not {type(fps).__name__}")
    if not 0.0 < fps <= 1000.0:
        raise ArgumentError(f"fps: must be above 0 and up to 1000, not {fps}")
    av = _pyav(name) if ending == ".mp4" else None
    pictures = _pictures(frames)
    first = next(pictures, None)
    if first is None:
        raise ArgumentError("frames: expected one at least")
    with beside(name) as temporary:
        if av is None:
            _write_images(temporary, first, pictures, float(fps))
        else:
            _write_video(av, temporary, first, pictures, float(fps))


def _pictures(frames: Iterable[Frame | NDArray[np.uint8]]) -> Iterator[NDArray[np.uint8]]:
    """Each as an array; checked when its turn comes."""
    size: tuple[int, ...] | None = None
    for number, frame in enumerate(frames):
        picture = frame.color if isinstance(frame, Frame) else frame
        if not isinstance(picture, np.ndarray) or picture.dtype != np.uint8:
            found = picture.dtype if isinstance(picture, np.ndarray) else type(picture).__name__
            raise DtypeError(f"frames[{number}]: expected a Frame or a uint8 array, not {found}")
        if picture.ndim != 3 or picture.shape[2] != 3 or picture.size == 0:
            raise ArgumentError(f"frames[{number}]: expected shape (H, W, 3), found {picture.shape}")
        if size is not None and picture.shape != size:
            raise ArgumentError(f"frames[{number}]: of shape {picture.shape}, but those before of {size}")
        size = picture.shape
        yield picture


def _write_images(path: str, first: NDArray[np.uint8], rest: Iterator[NDArray[np.uint8]], fps: float) -> None:
    from PIL import Image

    milliseconds = 1000.0 / fps
    options: dict[str, Any] = {"format": "WEBP", "duration": max(round(milliseconds), 1), "quality": 90}
    if path.endswith(".gif"):
        options = {"format": "GIF", "duration": max(round(milliseconds / 10), 1) * 10}

    images: Iterator[PIL.Image.Image] = (Image.fromarray(picture) for picture in rest)
    Image.fromarray(first).save(path, save_all=True, append_images=images, loop=0, **options)


def _write_video(
    av: Any, path: str, first: NDArray[np.uint8], rest: Iterator[NDArray[np.uint8]], fps: float
) -> None:
    from fractions import Fraction
    from itertools import chain

    height, width = first.shape[:2]
    even = ((0, height % 2), (0, width % 2), (0, 0))
    with av.open(path, "w", format="mp4") as output:
        stream = output.add_stream("libx264", rate=Fraction(fps).limit_denominator(1000))
        stream.height, stream.width = height + height % 2, width + width % 2
        stream.pix_fmt = "yuv420p"  # what browsers and presentations play
        stream.options = {"crf": "18"}  # hardly visible loss
        for picture in chain([first], rest):
            whole = np.ascontiguousarray(np.pad(picture, even, mode="edge"))
            output.mux(stream.encode(av.VideoFrame.from_ndarray(whole, format="rgb24")))
        output.mux(stream.encode(None))


def _pyav(purpose: str) -> Any:
    try:
        import av
    except ImportError as error:
        raise _advice.missing(purpose, "av", ", or save a .gif or .webp") from error
    return av
