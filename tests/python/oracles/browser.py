"""JupyterLab in a browser without a screen, and what someone before it sees and does.

The browser is Chromium, by its DevTools protocol.
"""

from __future__ import annotations

import base64
import io
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import urllib.request
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import pytest
from PIL import Image

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    import nanite_rs as nrs

T = TypeVar("T")

BROWSERS = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome", "chrome")
LIMIT = 120.0
"""Seconds that anything may take, on a machine with much else to do."""

# Parts of the page.
AREA = ".jp-OutputArea"
CANVAS = f"document.querySelector('{AREA} img.renderview-view')"
MENU = f"document.querySelector('{AREA} select')"
HANDLE = f"document.querySelector('{AREA} .noUi-handle')"
READOUT = f"document.querySelector('{AREA} .widget-readout').innerText"
TEXTS = f"[...document.querySelectorAll('{AREA} .widget-html')]"
MISTAKES = (
    f"[...document.querySelectorAll('{AREA} [data-mime-type$=stderr], {AREA} [data-mime-type$=error]')]"
)
KERNEL = "window.jupyterapp?.shell.currentWidget?.sessionContext?.session?.kernel?.status"


def until(done: Callable[[], T], what: Callable[[], str]) -> T:
    """Wait until a condition holds, and return what it found."""
    end = time.monotonic() + LIMIT
    while not (found := done()):
        if time.monotonic() > end:
            raise AssertionError(f"within {LIMIT:g} s: {what()}")
        time.sleep(0.1)
    return found


class Browser:
    """A page of Chromium."""

    def __init__(self, folder: Path, width: int, height: int, *more: str) -> None:
        program = next(filter(None, map(shutil.which, BROWSERS)), None)
        if program is None:
            pytest.skip("there is no Chromium; install the package chromium-headless-shell")
        self._folder = folder
        options = [
            "--headless",
            "--no-sandbox",
            "--no-first-run",
            "--disable-gpu",
            "--disable-dev-shm-usage",  # it is small in containers
            "--hide-scrollbars",
            "--force-device-scale-factor=1",
            "--force-color-profile=srgb",
            "--remote-debugging-port=0",
            "--remote-allow-origins=*",
            f"--user-data-dir={folder}",
            f"--window-size={width},{height}",
            *more,
        ]
        # The program may be a script that starts the browser: both end together.
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "start_new_session": True}
        self._process = subprocess.Popen([program, *options, "about:blank"], **quiet)
        self._number = 0
        self._socket: Any = None
        try:
            self._socket = self._connected(program)
        except BaseException:
            self.close()
            raise

    def _connected(self, program: str) -> Any:
        import websocket

        port = self._folder / "DevToolsActivePort"

        def started() -> bool:
            assert self._process.poll() is None, f"{program} has ended"
            return port.exists() and bool(port.read_text())

        until(started, lambda: f"{program} does not start")
        listing = f"http://127.0.0.1:{port.read_text().split()[0]}/json"
        with urllib.request.urlopen(listing, timeout=LIMIT) as answer:
            (page,) = [page for page in json.load(answer) if page["type"] == "page"]
        return websocket.create_connection(page["webSocketDebuggerUrl"], timeout=LIMIT)

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Call a method of the protocol."""
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while (answer := json.loads(self._socket.recv())).get("id") != self._number:
            pass
        assert "error" not in answer, f"{method}: {answer['error']}"
        result: dict[str, Any] = answer["result"]
        return result

    def value(self, script: str) -> Any:
        """The value of an expression in the page; None where it throws."""
        answer = self.call("Runtime.evaluate", expression=script, returnByValue=True)
        return None if "exceptionDetails" in answer else answer["result"].get("value")

    def until(self, script: str) -> Any:
        """Wait until an expression has a true value."""
        return self.wait(lambda: self.value(script), f"no {script}")

    def wait(self, done: Callable[[], T], what: str) -> T:
        """Wait until a condition holds; where it does not, the error names a picture of the page."""

        def failed() -> str:
            picture = self._folder.parent / "failed.png"
            self.shot(picture)
            return f"{what}; see {picture}"

        return until(done, failed)

    def mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        """Do something with the mouse."""
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    def click(self, x: float, y: float) -> None:
        """Press and release the left button."""
        self.mouse("mouseMoved", x, y)
        for kind in ("mousePressed", "mouseReleased"):
            self.mouse(kind, x, y, button="left", clickCount=1)

    def drag(self, x: float, y: float, dx: float, dy: float) -> None:
        """Drag with the left button, at the pace of a hand."""
        self.mouse("mouseMoved", x, y)
        self.mouse("mousePressed", x, y, button="left", clickCount=1)
        for k in range(1, 11):
            self.mouse("mouseMoved", x + dx * k / 10, y + dy * k / 10, button="left", buttons=1)
            time.sleep(0.05)
        # A hand rests before it lets go: on a busy machine the last moves wait for the pictures of those before.
        time.sleep(1.0)
        self.mouse("mouseReleased", x + dx, y + dy, button="left", clickCount=1)

    def seen(self) -> np.ndarray:
        """What the page looks like, (H, W, 3)."""
        data = base64.b64decode(self.call("Page.captureScreenshot")["data"])
        return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))

    def shot(self, path: Path) -> None:
        """Save what the page looks like."""
        Image.fromarray(self.seen()).save(path)

    def close(self) -> None:
        """End it."""
        # Left open, it would be found by whatever test runs when garbage is collected.
        if self._socket is not None:
            self._socket.shutdown()
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGTERM)
        try:
            self._process.wait(LIMIT)
        except subprocess.TimeoutExpired:
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()


@contextmanager
def lab(folder: Path) -> Iterator[str]:
    """The address of JupyterLab with a folder, which asks nothing and remembers nothing."""
    home = folder / "jupyter"
    settings = home / "settings" / "@jupyterlab" / "apputils-extension"
    settings.mkdir(parents=True)
    quiet = {"fetchNews": "false", "checkForUpdates": False}
    (settings / "notification.jupyterlab-settings").write_text(json.dumps(quiet))
    log = home / "log.txt"
    folders = ("JUPYTER_CONFIG_DIR", "JUPYTER_RUNTIME_DIR", "IPYTHONDIR", "JUPYTERLAB_WORKSPACES_DIR")
    environment = dict(os.environ) | {name: str(home / name.lower()) for name in folders}
    environment["JUPYTERLAB_SETTINGS_DIR"] = str(home / "settings")
    options = [
        "--no-browser",
        "--allow-root",
        "--ip=127.0.0.1",
        "--ServerApp.port=0",
        "--ServerApp.token=token",
        "--LabApp.expose_app_in_browser=True",
        f"--ServerApp.root_dir={folder}",
    ]
    with log.open("w") as stream:
        process = subprocess.Popen(
            [sys.executable, "-m", "jupyterlab", *options],
            cwd=folder,
            env=environment,
            stdout=stream,
            stderr=stream,
        )

    def address() -> str | None:
        assert process.poll() is None, f"JupyterLab has ended:\n{log.read_text()}"
        found = re.search(r"http://127\.0\.0\.1:\d+/", log.read_text())
        return found and found[0]

    try:
        yield until(address, lambda: f"JupyterLab does not start:\n{log.read_text()}")
    finally:
        process.terminate()
        try:
            process.wait(LIMIT)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


class Cell:
    """The viewer in the cell of a notebook, and a `here`: a viewer of this process that does the same.

    Places are pixels of the canvas.
    """

    def __init__(self, browser: Browser, here: nrs.Viewer) -> None:
        self.browser, self.here = browser, here

    def _box(self) -> tuple[int, int, int, int]:
        """Where the canvas is now without its frame: what is above it may have grown."""
        corner = "[b.x + c.clientLeft, b.y + c.clientTop, c.clientWidth, c.clientHeight]"
        numbers = self.browser.value(f"(c => (b => {corner})(c.getBoundingClientRect()))({CANVAS})")
        left, top, width, height = (round(x) for x in numbers)
        return left, top, width, height

    def seen(self) -> np.ndarray:
        """What the canvas shows, (H, W, 3)."""
        left, top, width, height = self._box()
        return self.browser.seen()[top : top + height, left : left + width]

    def wait(self, what: str) -> np.ndarray:
        """Wait until the canvas shows the picture of `here`, which takes its size, and return what it shows."""
        inner = np.s_[8:-8, 8:-8]  # its corners are round

        def same() -> list[np.ndarray]:
            seen = self.seen()
            self.here.resize(seen.shape[1], seen.shape[0])
            difference = seen.astype(int)[inner] - self.here.image()[inner]
            return [seen] if np.abs(difference).max() <= 1 else []

        return self.browser.wait(same, what)[0]

    def status(self) -> str:
        """The line below the canvas: the view, triangles and clusters."""
        return str(self.browser.value(f"{TEXTS}.at(-2).innerText"))

    def picked(self) -> str:
        """The lines about what was picked."""
        return str(self.browser.value(f"{TEXTS}.at(-1).innerText"))

    def pixel_error(self) -> str:
        """What stands beside the slider."""
        return str(self.browser.value(READOUT))

    def click(self, x: int, y: int) -> None:
        """Click."""
        left, top, _, _ = self._box()
        self.browser.click(left + x, top + y)

    def drag(self, x: int, y: int, dx: int, dy: int) -> None:
        """Drag with the left button."""
        left, top, _, _ = self._box()
        self.browser.drag(left + x, top + y, dx, dy)

    def wheel(self, x: int, y: int, dy: int) -> None:
        """Turn the wheel."""
        left, top, _, _ = self._box()
        self.browser.mouse("mouseWheel", left + x, top + y, deltaX=0, deltaY=dy)

    def choose(self, view: str) -> None:
        """Choose from the menu, whose list the browser does not draw into the page."""
        change = "dispatchEvent(new Event('change', {bubbles: true}))"
        self.browser.value(f"{MENU}.value = '{view}'; {MENU}.{change}")

    def slide(self, dx: int) -> None:
        """Drag the handle of the slider."""
        self.browser.drag(*self._middle(HANDLE), dx, 0)

    def press(self, name: str) -> None:
        """Press a button."""
        button = f"[...document.querySelectorAll('{AREA} button')].find(b => b.innerText.includes('{name}'))"
        self.browser.click(*self._middle(button))

    def _middle(self, element: str) -> tuple[float, float]:
        x, y = self.browser.value(
            f"(b => [b.x + b.width / 2, b.y + b.height / 2])({element}.getBoundingClientRect())"
        )
        return x, y

    def mistakes(self) -> str:
        """What the kernel wrote about things that went wrong."""
        return str(self.browser.value(f"{MISTAKES}.map(e => e.innerText).join('\\n')"))


@contextmanager
def notebook(folder: Path, cells: Sequence[str], here: nrs.Viewer) -> Iterator[Cell]:
    """Run cells in JupyterLab, of which the last one shows a viewer."""
    for package in ("jupyterlab", "websocket", "rendercanvas", "ipywidgets", "jupyter_rfb"):
        pytest.importorskip(package)
    shown = [
        {
            "cell_type": "code",
            "id": f"cell-{k}",
            "execution_count": None,
            "metadata": {},
            "outputs": [],
            "source": text,
        }
        for k, text in enumerate(cells)
    ]
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    content = {"cells": shown, "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 5}
    (folder / "viewer.ipynb").write_text(json.dumps(content))
    (folder / "browser").mkdir()
    browser = Browser(folder / "browser", 1000, 900)
    try:
        with lab(folder) as address:
            browser.call("Page.navigate", url=f"{address}doc/tree/viewer.ipynb?token=token")
            browser.until(f"{KERNEL} == 'idle'")
            browser.until("(window.jupyterapp.commands.execute('notebook:run-all-cells'), true)")
            # Before its first picture it shows one pixel.
            browser.until(f"{CANVAS}?.naturalWidth > 1")
            browser.until(f"{KERNEL} == 'idle'")
            yield Cell(browser, here)
    finally:
        browser.close()
