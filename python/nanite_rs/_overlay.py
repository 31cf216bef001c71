"""Text over pictures, a slider, and a legend, drawn with Pillow."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

LEAST, MOST = -3.0, 6.0
"""The pixel errors of a slider's ends, as powers of two."""

_INK: Final = (244, 246, 248)
_DIM: Final = (165, 172, 180)
_PANEL: Final = np.array((24, 28, 34), np.float32)
_ACCENT: Final = (255, 190, 60)


@lru_cache(maxsize=8)
def _font(size: int) -> Any:
    from PIL import ImageFont

    return ImageFont.load_default(size)


class Slider:
    """A bar for the pixel error at the upper right of a picture; all in pixels of it."""

    def __init__(self, width: int, ratio: float) -> None:
        self.ratio = ratio
        self.length = max(min(260.0 * ratio, width - 40.0 * ratio), 20.0)
        self.left = width - self.length - 20.0 * ratio
        self.top = 42.0 * ratio

    def holds(self, x: float, y: float) -> bool:
        """Whether a place is on the bar."""
        margin = 10.0 * self.ratio
        inside = self.left - margin <= x <= self.left + self.length + margin
        return inside and abs(y - self.top) <= margin

    def value(self, x: float) -> float:
        """The pixel error at a column."""
        t = min(max((x - self.left) / self.length, 0.0), 1.0)
        return float(2.0 ** (LEAST + (MOST - LEAST) * t))

    def column(self, pixel_error: float) -> float:
        """The column of a pixel error; the left end for all that is smaller."""
        power = math.log2(pixel_error) if pixel_error > 0.0 else LEAST
        return self.left + self.length * min(max((power - LEAST) / (MOST - LEAST), 0.0), 1.0)


def draw(
    picture: NDArray[np.uint8],
    status: Sequence[str],
    helps: Sequence[str],
    picked: Sequence[str],
    pixel_error: float,
    ratio: float = 1.0,
) -> None:
    """Write on a picture: what is shown at the upper left, what was picked below it, help at the bottom.

    The slider stands at the upper right; ``ratio`` is pixels of the picture for each logical one.
    """
    from PIL import Image, ImageDraw

    height, width = picture.shape[:2]
    size, gap = max(round(13 * ratio), 6), round(10 * ratio)
    line = round(size * 1.45)
    font = _font(size)
    slider = Slider(width, ratio)
    blocks = [(gap, status), (gap * 2 + line * len(status) + gap, picked)]
    help_lines = _wrapped(helps, font, width - 2 * gap)
    if line * len(help_lines) > height // 3:
        help_lines = []  # there is no room
    bottom = height - gap - line * len(help_lines)
    blocks.append((bottom, help_lines))
    for top, lines in blocks:
        if lines:
            wide = max(font.getlength(text) for text in lines)
            _shade(picture, gap // 2, top - gap // 2, gap * 2 + wide, top + line * len(lines) + gap // 3)
    label = f"pixel error {pixel_error:.3g}"
    ink = round(slider.top)
    _shade(picture, slider.left - gap, gap // 2, slider.left + slider.length + gap, ink + gap)
    image = Image.fromarray(picture)
    pen = ImageDraw.Draw(image)
    for (top, lines), color in zip(blocks, (_INK, _ACCENT, _DIM), strict=True):
        for k, text in enumerate(lines):
            pen.text((gap, top + k * line), text, fill=color, font=font)
    pen.text((slider.left, ink - line - gap // 3), label, fill=_INK, font=font)
    thick = max(round(2 * ratio), 1)
    pen.line((slider.left, ink, slider.left + slider.length, ink), fill=_DIM, width=thick)
    at, knob = slider.column(pixel_error), 6.0 * ratio
    pen.ellipse((at - knob, ink - knob, at + knob, ink + knob), fill=_ACCENT)
    picture[:] = np.asarray(image)


def legend(picture: NDArray[np.uint8], names: Sequence[str], colors: NDArray[np.uint8]) -> None:
    """Write names at the upper left of a picture, each behind a patch of its colour, (N, 3)."""
    from PIL import Image, ImageDraw

    size, gap = 13, 10
    line, font = round(size * 1.45), _font(size)
    wide = max((font.getlength(name) for name in names), default=0.0)
    _shade(picture, gap // 2, gap // 2, gap * 3 + line + wide, gap * 1.5 + line * len(names))
    image = Image.fromarray(picture)
    pen = ImageDraw.Draw(image)
    for k, (name, color) in enumerate(zip(names, colors, strict=True)):
        top = gap + k * line
        pen.rectangle((gap, top + 1, gap + line - 3, top + line - 4), fill=tuple(int(c) for c in color))
        pen.text((gap * 2 + line, top), name, fill=_INK, font=font)
    picture[:] = np.asarray(image)


def _wrapped(items: Sequence[str], font: Any, width: float) -> list[str]:
    """Items in as few lines as hold them."""
    lines: list[str] = []
    for item in items:
        longer = f"{lines[-1]}    {item}" if lines else item
        if lines and font.getlength(longer) <= width:
            lines[-1] = longer
        else:
            lines.append(item)
    return lines


def _shade(picture: NDArray[np.uint8], left: float, top: float, right: float, bottom: float) -> None:
    """Darken a rectangle, so that text can be read on it."""
    box = (slice(max(round(top), 0), max(round(bottom), 0)), slice(max(round(left), 0), max(round(right), 0)))
    picture[box] = (picture[box] * np.float32(0.28) + _PANEL * np.float32(0.72)).astype(np.uint8)


def resized(picture: NDArray[np.uint8], width: int, height: int) -> NDArray[np.uint8]:
    """A picture of another size."""
    from PIL import Image

    if picture.shape[:2] == (height, width):
        return picture
    return np.array(Image.fromarray(picture).resize((width, height), Image.Resampling.BILINEAR))
