"""A `Viewer` on a canvas of rendercanvas: event handling, redraws and resolution."""

from __future__ import annotations

import importlib
import time
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias, get_args

import numpy as np

from nanite_rs import _advice, _overlay, _widgets
from nanite_rs.exceptions import ArgumentError, BackendError, NaniteError, StaleHandleError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from nanite_rs.viewer import Viewer

CanvasName: TypeAlias = Literal["auto", "jupyter", "glfw", "qt", "wx", "offscreen"]

HELP: Final = (
    "drag turns",
    "right or shift drag moves",
    "wheel zooms",
    "double click centres",
    "click picks",
    "F freezes",
    "R resets",
    "S saves",
    "V next view",
    "[ ] pixel error",
    "0 full detail",
    "H help",
)

_PACKAGES: Final = {
    "jupyter": ("rendercanvas", "ipywidgets", "jupyter_rfb"),
    "glfw": ("rendercanvas", "glfw", "wgpu"),
    "qt": ("rendercanvas",),
    "wx": ("rendercanvas", "wx"),
    "offscreen": ("rendercanvas",),
}

_SHOWING: Final = ("Vulkan", "Metal", "D3D12")
"""Backends of wgpu that windows can be drawn by: with OpenGL its surfaces may fail, which ends the process."""

_STILL: Final = 0.2
"""Seconds after the last movement from which on pictures are drawn in full."""

_CLICK: Final = 4.0
"""Logical pixels that the pointer may move in a click."""

_TURN: Final = 0.01
"""Radians per logical pixel of a drag."""

#: Radians to the right and upwards that a key turns by.
_ARROWS: Final = {
    "ArrowLeft": (-0.1, 0.0),
    "ArrowRight": (0.1, 0.0),
    "ArrowUp": (0.0, 0.1),
    "ArrowDown": (0.0, -0.1),
}

_WHEEL: Final = 1.0015
"""Zoom per unit of the wheel, of which a notch has 100."""


class Budget:
    """How much smaller pictures have to be, so that drawing one takes no longer than wished."""

    STEPS: Final = (1.0, 0.75, 0.5, 0.375, 0.25)

    def __init__(self, seconds: float = 0.04) -> None:
        self.seconds = seconds
        self.scale = 1.0
        """Part of width and height."""

    def took(self, seconds: float) -> None:
        """Learn what a picture at the present scale took."""
        # The cost of a frame grows at most with its pixels, so a low resolution recovers soon.
        wanted = self.scale * (self.seconds / max(seconds, 1e-6)) ** 0.5
        at = self.STEPS.index(self.scale)
        if seconds > self.seconds:
            fitting = [step for step in self.STEPS if step <= wanted]
            self.scale = fitting[0] if fitting else self.STEPS[-1]
        elif at > 0 and wanted >= 1.15 * self.STEPS[at - 1]:
            self.scale = self.STEPS[at - 1]


def in_notebook() -> bool:
    """Whether this runs in a kernel of Jupyter."""
    try:
        from IPython import get_ipython
    except ImportError:
        return False
    shell = get_ipython()
    return shell is not None and hasattr(shell, "kernel")


def chosen(canvas: str) -> str:
    """The canvas that a name stands for, with its packages."""
    if canvas not in get_args(CanvasName):
        raise ArgumentError(f"canvas: must be one of {', '.join(get_args(CanvasName))}, not {canvas!r}")
    name = ("jupyter" if in_notebook() else "glfw") if canvas == "auto" else canvas
    for package in _PACKAGES[name]:
        _needed(package, name)
    return name


def _needed(package: str, name: str) -> None:
    try:
        importlib.import_module(package)
    except ImportError as error:
        raise _advice.missing(f"view: canvas={name!r}", package) from error
    except Exception as error:  # such as glfw's, where a library of the system is missing
        raise BackendError(f"canvas: {name} cannot be used here: {error}") from error


def _start_glfw() -> None:
    """Check for what would end the process: glfw without a display, or a device that cannot present to a window."""
    import glfw
    import wgpu

    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        if not glfw.init():
            raise OSError(str(said[-1].message) if said else "it does not start")
    adapter = wgpu.gpu.request_adapter_sync(power_preference="high-performance").info
    if adapter["backend_type"] not in _SHOWING:
        raise OSError(
            f"it wants Vulkan, Metal or DX12, and there is {adapter['backend_type']} on {adapter['device']} alone; "
            "a driver in software will do, such as Mesa's lavapipe, and canvas='qt' does without"
        )


def attach(viewer: Viewer, name: str, *, block: bool) -> None:
    """Put a viewer on a new canvas, and wait until it is closed, if wished and there is a window."""
    width, height = viewer.size
    title = "" if name == "jupyter" else "nanite_rs"
    try:
        if name == "glfw":
            _start_glfw()
        module = importlib.import_module(f"rendercanvas.{name}")
        canvas = module.RenderCanvas(size=(width, height), title=title, max_fps=60)
        binding = Binding(
            viewer, canvas, module.loop if name != "offscreen" else None, text=name != "jupyter"
        )
    except Exception as error:
        viewer.close()
        raise BackendError(
            f"canvas: {name} cannot open a window here: {error}; canvas='jupyter' shows in a notebook, "
            "and Renderer draws without any window"
        ) from error
    viewer.canvas = canvas
    if name == "jupyter":
        viewer.widget = _widgets.around(viewer, binding)
    elif name != "offscreen" and block:
        module.loop.run()
        if canvas.get_closed():  # with a loop that runs already it returns at once
            viewer.close()


class Binding:
    """Draws a viewer on a canvas and hands it the canvas's events.

    ``loop`` is that of the canvas, or None where it has none: then pictures are small only while a button is held.
    """

    def __init__(self, viewer: Viewer, canvas: Any, loop: Any, *, text: bool) -> None:
        self.viewer, self.canvas, self._loop, self._text = viewer, canvas, loop, text
        self.help = True
        self.message = ""
        self.budget = Budget()
        self.milliseconds = 0.0
        self.moved: list[Any] = []
        """Called without arguments after each picture."""
        self._moving, self._until = False, 0.0
        self._drawn = 0, 0, 0.0  # size and scale of the picture before
        self._button, self._slider, self._dragged = 0, False, False
        self._down = self._last = (0.0, 0.0)
        self._context = canvas.get_bitmap_context()
        canvas.add_event_handler(
            self.handle,
            "pointer_down",
            "pointer_move",
            "pointer_up",
            "wheel",
            "double_click",
            "key_down",
            "resize",
            "close",
        )
        viewer.changed.append(self._redraw)
        canvas.request_draw(self.draw)

    # --------------------------------------------------------------------------------------- drawing

    def draw(self) -> None:
        """Draw the picture and what is written on it."""
        width, height = self.canvas.get_physical_size()
        if width < 1 or height < 1:
            return
        self.viewer.resize(min(width, 8192), min(height, 8192))
        moving = self._moving
        scale = self.budget.scale if moving else 1.0
        start, before = time.perf_counter(), self.viewer.stats
        picture = self.viewer.image(moving=moving, scale=scale)
        seconds = time.perf_counter() - start
        if self.viewer.stats is not before:  # else it was drawn before
            self.milliseconds = seconds * 1e3
        # The first picture of a size takes memory for it. On a GPU pixels are not what costs time.
        if moving and self._drawn == (*self.viewer.size, scale) and self.viewer.backend == "cpu":
            self.budget.took(seconds)
        self._drawn = *self.viewer.size, scale
        if self._text:
            picture = _overlay.resized(picture, *self.viewer.size)
            ratio = self.canvas.get_pixel_ratio()
            lines = HELP if self.help else ()
            _overlay.draw(picture, self.status(), lines, self.picked(), self.viewer.pixel_error, ratio)
        self._context.set_bitmap(_opaque(picture))
        for call in self.moved:
            call()

    def status(self) -> list[str]:
        """What is shown, in a few lines."""
        viewer, stats = self.viewer, self.viewer.stats
        if viewer.frozen:
            counts = viewer.frozen_triangles, len(viewer.frozen_clusters)
        else:
            counts = (stats.triangles, stats.clusters) if stats else (0, 0)
        frozen = ", frozen" if viewer.frozen else f" of {_short(stats.source_triangles)}" if stats else ""
        lines = [
            viewer.view,
            f"{_short(counts[0])} triangles{frozen}, {_short(counts[1])} clusters",
            f"{self.milliseconds:.0f} ms",
        ]
        if self.message:
            lines.append(self.message)
        return lines

    def picked(self) -> list[str]:
        """What was picked, in a few lines, with its error as it is seen now."""
        found = self.viewer.selected
        if found is None:
            return []
        try:
            lines = found.table(self.viewer.pixels_now(found)).splitlines()
        except StaleHandleError:
            return ["it was removed from the scene"]
        if not self.viewer.selected_pixels:
            lines.append("not seen now: hidden, or drawn at another level")
        return lines

    def _redraw(self) -> None:
        self.canvas.request_draw()

    def _move(self) -> None:
        """The camera has moved: draw at a lower resolution until it rests."""
        if self._loop is not None:
            self._until = time.perf_counter() + _STILL
            if not self._moving:
                self._loop.call_later(_STILL, self._settle)
            self._moving = True
        else:
            self._moving = self._button != 0
        self._redraw()

    def _settle(self) -> None:
        left = self._until - time.perf_counter()
        if left > 0.0:
            self._loop.call_later(left, self._settle)
        else:
            self._moving = False
            self._redraw()

    # ---------------------------------------------------------------------------------------- events

    def handle(self, event: dict[str, Any]) -> None:
        """Do what an event asks for."""
        try:
            getattr(self, f"_on_{event['event_type']}")(event)
        except NaniteError as error:  # such as a damaged page, which a pick reads
            self.message = str(error)
            self._redraw()

    def _place(self, event: dict[str, Any]) -> tuple[float, float]:
        """Clamp a position in pixels to the picture."""
        ratio = self.canvas.get_pixel_ratio()
        width, height = self.viewer.size
        x, y = event["x"] * ratio, event["y"] * ratio
        return min(max(x, 0.0), width - 1.0), min(max(y, 0.0), height - 1.0)

    def _bar(self) -> _overlay.Slider:
        return _overlay.Slider(self.viewer.size[0], self.canvas.get_pixel_ratio())

    def _on_pointer_down(self, event: dict[str, Any]) -> None:
        if self._button:
            return
        self._button, self._dragged = event["button"], False
        self._down = self._last = event["x"], event["y"]
        self._slider = self._text and self._button == 1 and self._bar().holds(*self._place(event))
        if self._slider:
            self._slide(event, dragging=True)

    def _on_pointer_move(self, event: dict[str, Any]) -> None:
        if not self._button:
            return
        if self._slider:
            self._slide(event, dragging=True)
            return
        self._dragged = self._dragged or not self._is_near(event)
        if not self._dragged:
            return
        dx, dy = event["x"] - self._last[0], event["y"] - self._last[1]
        self._last = event["x"], event["y"]
        if self._button == 1 and "Shift" not in event.get("modifiers", ()):
            self.viewer.orbit.turn(-dx * _TURN, dy * _TURN)
        else:
            height = max(self.canvas.get_logical_size()[1], 1.0)
            self.viewer.orbit.pan(-dx / height, dy / height)
        self._move()

    def _on_pointer_up(self, event: dict[str, Any]) -> None:
        button, self._button = self._button, 0
        if self._slider:
            self._slider = False
            self._slide(event, dragging=False)
        elif button == 1 and not self._dragged:
            self.viewer.pick(*self._place(event), select=True)
        if self._loop is None:
            self._moving = False
        self._redraw()

    def _is_near(self, event: dict[str, Any]) -> bool:
        """Whether the pointer is near the place where the button was pressed, which makes it a click."""
        away = max(abs(event["x"] - self._down[0]), abs(event["y"] - self._down[1]))
        return bool(away <= _CLICK)

    def _slide(self, event: dict[str, Any], *, dragging: bool) -> None:
        # A frozen cut is rebuilt for a value: only for the last one.
        if not (dragging and self.viewer.frozen):
            self.viewer.pixel_error = self._bar().value(self._place(event)[0])

    def _on_wheel(self, event: dict[str, Any]) -> None:
        self.viewer.orbit.zoom(_WHEEL ** -event["dy"])
        self._move()

    def _on_double_click(self, event: dict[str, Any]) -> None:
        if not (self._text and self._bar().holds(*self._place(event))):
            self.viewer.center_on(*self._place(event))

    def _on_key_down(self, event: dict[str, Any]) -> None:
        key, viewer = event["key"], self.viewer
        self.message = ""
        if key in _ARROWS:
            viewer.orbit.turn(*_ARROWS[key])
            self._move()
        elif key in ("+", "=", "-"):
            viewer.orbit.zoom(0.8 if key == "-" else 1.25)
            self._move()
        elif key in ("f", "F"):
            viewer.frozen = not viewer.frozen
        elif key in ("r", "R"):
            viewer.reset()
        elif key in ("s", "S"):
            self.save()
        elif key in ("h", "H"):
            self.help = not self.help
        elif key == "Escape":
            viewer.selected = None
        elif key in ("v", "V"):
            back = key == "V" or "Shift" in event.get("modifiers", ())
            views = viewer.views
            viewer.view = views[(views.index(viewer.view) + (-1 if back else 1)) % len(views)]
        elif key in ("[", "]"):
            viewer.pixel_error = stepped(viewer.pixel_error, 1 if key == "]" else -1)
        elif key == "0":
            viewer.pixel_error = 0.0
        self._redraw()

    def _on_resize(self, _event: dict[str, Any]) -> None:
        self._redraw()

    def _on_close(self, _event: dict[str, Any]) -> None:
        if self._redraw in self.viewer.changed:
            self.viewer.changed.remove(self._redraw)

    def save(self) -> None:
        """Write a PNG under the next free name in the working directory, and say so."""
        number = next(n for n in range(1, 1_000_000) if not Path(f"nanite_{n:03}.png").exists())
        path = f"nanite_{number:03}.png"
        try:
            self.viewer.save(path)
            self.message = f"saved {path}"
        except NaniteError as error:
            self.message = str(error)
        self._redraw()


def stepped(pixel_error: float, steps: int) -> float:
    """The pixel error some half powers of two on; 0 below the smallest."""
    if pixel_error == 0.0:
        return 2.0**_overlay.LEAST if steps > 0 else 0.0
    power = round(2.0 * float(np.log2(pixel_error))) + steps
    if power < 2.0 * _overlay.LEAST:
        return 0.0
    return float(2.0 ** (min(power, 2.0 * _overlay.MOST) / 2.0))


def _opaque(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    out = np.empty((*picture.shape[:2], 4), np.uint8)
    out[..., :3], out[..., 3] = picture, 255
    return out


def _short(count: int) -> str:
    """Three digits at most: 999, 1.23k, 45.6M."""
    for unit, name in ((10**9, "G"), (10**6, "M"), (10**3, "k")):
        if count >= unit:
            return f"{count / unit:.3g}{name}"
    return str(count)
