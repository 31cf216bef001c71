"""A display without a screen, and what someone before it sees and does: Xvfb, and python-xlib with XTEST."""

from __future__ import annotations

import os
import shutil
import subprocess
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import pytest

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

T = TypeVar("T")


@contextmanager
def screen(width: int, height: int) -> Iterator[str]:
    """The name of a new display."""
    program = shutil.which("Xvfb")
    if program is None:
        pytest.skip("there is no Xvfb; install the package xvfb")
    read, write = os.pipe()
    arguments = ["-displayfd", str(write), "-screen", "0", f"{width}x{height}x24", "-nolisten", "tcp"]
    server = subprocess.Popen([program, *arguments], pass_fds=(write,), stderr=subprocess.DEVNULL)
    try:
        os.close(write)
        with os.fdopen(read) as pipe:
            number = pipe.readline().strip()
        assert number, "Xvfb has ended"
        yield f":{number}"
    finally:
        server.terminate()
        server.wait(10)


class Desk:
    """What someone before a display sees and does."""

    def __init__(self, name: str) -> None:
        from Xlib import X, display
        from Xlib.ext import xtest

        self.X, self._xtest = X, xtest
        self._display = display.Display(name)
        self._root = self._display.screen().root

    def seen(self, width: int, height: int) -> np.ndarray:
        raw = self._root.get_image(0, 0, width, height, self.X.ZPixmap, 0xFFFFFFFF)
        return np.frombuffer(raw.data, np.uint8).reshape(height, width, 4)[..., 2::-1].astype(int)

    def until(self, done: Callable[[], T], what: str) -> T:
        """Wait until a condition holds, and return what it found."""
        end = time.monotonic() + 40.0
        while not (found := done()):
            assert time.monotonic() < end, what
            time.sleep(0.05)
        return found

    def window(self) -> Any:
        def find() -> list[Any]:
            shown = [w for w in self._root.query_tree().children if w.get_wm_name() == "nanite_rs"]
            return [w for w in shown if w.get_attributes().map_state == self.X.IsViewable]

        (window,) = self.until(find, "no window has opened")
        window.set_input_focus(self.X.RevertToParent, self.X.CurrentTime)
        self._display.sync()
        return window

    def _do(self, kind: int, detail: int = 0, x: int = 0, y: int = 0) -> None:
        self._xtest.fake_input(self._display, kind, detail, x=x, y=y)
        self._display.sync()
        time.sleep(0.03)

    def move(self, x: int, y: int) -> None:
        self._do(self.X.MotionNotify, 0, x, y)

    def button(self, number: int, *, down: bool) -> None:
        self._do(self.X.ButtonPress if down else self.X.ButtonRelease, number)

    def key(self, letter: str) -> None:
        code = self._display.keysym_to_keycode(ord(letter))
        self._do(self.X.KeyPress, code)
        self._do(self.X.KeyRelease, code)

    def close(self, window: Any) -> None:
        from Xlib.protocol import event

        protocols = self._display.intern_atom("WM_PROTOCOLS")
        data = (32, [self._display.intern_atom("WM_DELETE_WINDOW"), self.X.CurrentTime, 0, 0, 0])
        window.send_event(event.ClientMessage(window=window, client_type=protocols, data=data))
        self._display.sync()
