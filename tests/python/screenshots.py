"""Pictures of the viewer as users see it: in a window, and in JupyterLab in a browser.

`make screenshots` runs this. It drives both as a user does, and checks that a click in the browser picks what the
viewer picks by itself. The browser is Chromium without a screen, by its DevTools protocol.
"""

from __future__ import annotations

import base64
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from PIL import Image

import nanite_rs as nrs
from oracles.desk import Desk, screen

if TYPE_CHECKING:
    from collections.abc import Iterator

FACES = 400_000
BROWSERS = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome", "chrome")
CELLS = (
    "import nanite_rs as nrs\n\n"
    f"mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.displaced_icosphere(faces={FACES}))",
    'viewer = nrs.view(mesh, width=720, height=480, backend="cpu")\nviewer',
)

# Parts of the page.
CANVAS = "document.querySelector('.jp-OutputArea img.renderview-view')"
MENU = "document.querySelector('.jp-OutputArea select')"
BUTTONS = "[...document.querySelectorAll('.jp-OutputArea button')]"
PICKED = "[...document.querySelectorAll('.jp-OutputArea .widget-html')].at(-1).innerText"


# -------------------------------------------------------------------------------------------------- window


def window(folder: Path, mesh: Path) -> None:
    """Look around in a window."""
    width, height = 1100, 700
    command = [sys.executable, "-m", "nanite_rs", "view", str(mesh), "--backend", "cpu"]
    command += ["--size", f"{width}x{height}"]
    with screen(width, height) as display:
        environment = {k: v for k, v in os.environ.items() if k != "WAYLAND_DISPLAY"} | {"DISPLAY": display}
        process = subprocess.Popen(command, cwd=folder, env=environment)
        try:
            desk = Desk(display)
            shown = desk.window()

            def shot(name: str) -> None:
                time.sleep(2.0)  # until pictures have their full size again
                Image.fromarray(desk.seen(width, height).astype("u1")).save(folder / f"window_{name}.png")
                print(folder / f"window_{name}.png")

            shot("shaded")
            for _ in range(3):
                desk.key("v")
            click(desk, 560, 330)
            shot("picked")
            for _ in range(2):
                desk.key("]")
            drag(desk, 300, 0)
            shot("turned")
            desk.key("f")
            drag(desk, 250, 60)
            for _ in range(4):
                desk.button(5, down=True)
                desk.button(5, down=False)
            shot("frozen")
            desk.close(shown)
            if process.wait(20):
                raise SystemExit("the window ended with an error")
        finally:
            process.kill()


def click(desk: Desk, x: int, y: int) -> None:
    """Press and release the left button."""
    desk.move(x, y)
    desk.button(1, down=True)
    desk.button(1, down=False)


def drag(desk: Desk, dx: int, dy: int) -> None:
    """Drag from the middle with the left button."""
    desk.move(550, 350)
    desk.button(1, down=True)
    for k in range(1, 11):
        desk.move(550 + dx * k // 10, 350 + dy * k // 10)
    desk.button(1, down=False)


# ------------------------------------------------------------------------------------------------- browser


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
        "--ServerApp.token=screenshots",
    ]
    options += ["--LabApp.expose_app_in_browser=True", f"--ServerApp.root_dir={folder}"]
    with log.open("w") as stream:
        process = subprocess.Popen(
            [sys.executable, "-m", "jupyterlab", *options],
            cwd=folder,
            env=environment,
            stdout=stream,
            stderr=stream,
        )
    try:
        end = time.monotonic() + 60.0
        while not (found := re.search(r"http://127\.0\.0\.1:\d+/", log.read_text())):
            if process.poll() is not None or time.monotonic() > end:
                raise SystemExit(f"JupyterLab does not start:\n{log.read_text()}")
            time.sleep(0.2)
        yield found[0]
    finally:
        process.terminate()
        process.wait(20)


class Browser:
    """A page of Chromium."""

    def __init__(self, folder: Path, width: int, height: int) -> None:
        program = next(filter(None, map(shutil.which, BROWSERS)), None)
        if program is None:
            raise SystemExit(f"there is none of {', '.join(BROWSERS)}")
        options = [
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--hide-scrollbars",
            "--remote-debugging-port=0",
        ]
        options += [
            f"--user-data-dir={folder}",
            f"--window-size={width},{height}",
            "--remote-allow-origins=*",
        ]
        # The program may be a script that starts the browser: both end together.
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "start_new_session": True}
        self._process = subprocess.Popen([program, *options, "about:blank"], **quiet)
        self._number = 0
        try:
            self._socket = self._connected(program, folder / "DevToolsActivePort")
        except BaseException:
            self.close()
            raise

    def _connected(self, program: str, port: Path) -> Any:
        import websocket

        end = time.monotonic() + 60.0
        while not port.exists() or not port.read_text():
            if self._process.poll() is not None or time.monotonic() > end:
                raise SystemExit(f"{program} does not start")
            time.sleep(0.1)
        listing = f"http://127.0.0.1:{port.read_text().split()[0]}/json"
        with urllib.request.urlopen(listing) as answer:
            (page,) = [page for page in json.load(answer) if page["type"] == "page"]
        return websocket.create_connection(page["webSocketDebuggerUrl"], timeout=60)

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Call a method of the protocol."""
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while (answer := json.loads(self._socket.recv())).get("id") != self._number:
            pass
        if "error" in answer:
            raise SystemExit(f"{method}: {answer['error']}")
        result: dict[str, Any] = answer["result"]
        return result

    def value(self, script: str) -> Any:
        """The value of an expression in the page."""
        answer = self.call("Runtime.evaluate", expression=script, returnByValue=True)
        return None if "exceptionDetails" in answer else answer["result"].get("value")

    def until(self, script: str) -> Any:
        """Wait until an expression has a true value."""
        end = time.monotonic() + 90.0
        while not (found := self.value(script)):
            if time.monotonic() > end:
                self.shot(Path("target/screenshots/failed.png"))
                raise SystemExit(f"this does not come: {script}")
            time.sleep(0.2)
        return found

    def mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        """Do something with the mouse."""
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    def click(self, x: float, y: float) -> None:
        """Press and release the left button."""
        self.mouse("mouseMoved", x, y)
        for kind in ("mousePressed", "mouseReleased"):
            self.mouse(kind, x, y, button="left", clickCount=1)

    def drag(self, x: float, y: float, dx: float, dy: float) -> None:
        """Drag with the left button."""
        self.mouse("mouseMoved", x, y)
        self.mouse("mousePressed", x, y, button="left", clickCount=1)
        for k in range(1, 11):
            self.mouse("mouseMoved", x + dx * k / 10, y + dy * k / 10, button="left", buttons=1)
            time.sleep(0.05)
        self.mouse("mouseReleased", x + dx, y + dy, button="left", clickCount=1)

    def shot(self, path: Path) -> None:
        """Save what the page looks like."""
        path.write_bytes(base64.b64decode(self.call("Page.captureScreenshot")["data"]))
        print(path)

    def close(self) -> None:
        """End it."""
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGTERM)
        self._process.wait(20)


def notebook(folder: Path, work: Path, mesh: Path) -> None:
    """Look around in a cell."""
    cells = [
        {
            "cell_type": "code",
            "id": f"cell-{k}",
            "execution_count": None,
            "metadata": {},
            "outputs": [],
            "source": text,
        }
        for k, text in enumerate(CELLS)
    ]
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    content = {"cells": cells, "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 5}
    (work / "viewer.ipynb").write_text(json.dumps(content))
    (work / "browser").mkdir()
    browser = Browser(work / "browser", 1000, 900)
    try:
        with lab(work) as address:
            browser.call("Page.navigate", url=f"{address}doc/tree/viewer.ipynb?token=screenshots")
            browser.until(
                "window.jupyterapp?.shell.currentWidget?.sessionContext?.session?.kernel?.status == 'idle'"
            )
            browser.until("(window.jupyterapp.commands.execute('notebook:run-all-cells'), true)")
            browser.until(f"{CANVAS}?.naturalWidth > 0")
            left, top, width, height = browser.value(
                f"(b => [b.x, b.y, b.width, b.height])({CANVAS}.getBoundingClientRect())"
            )
            time.sleep(2.0)
            browser.shot(folder / "jupyter_shaded.png")
            browser.click(left + width / 2, top + height / 2)
            text = browser.until(f"{PICKED}.includes('error') && {PICKED}")
            # What the canvas has inside of its frame.
            wide, high = browser.value(f"[{CANVAS}.naturalWidth, {CANVAS}.naturalHeight]")
            opened = nrs.NaniteMesh.open(mesh)
            with nrs.Viewer(opened, width=wide, height=high, backend="cpu") as here:
                x, y = wide / 2, high / 2
                own = [str(here.pick(x + dx, y + dy)).split() for dx in (-1, 0, 1) for dy in (-1, 0, 1)]
            if text.split() not in own:
                raise SystemExit(f"the browser picks {text.split()}, and the viewer none such of {own}")
            browser.value(
                f"{MENU}.value = 'clusters'; {MENU}.dispatchEvent(new Event('change', {{bubbles: true}}))"
            )
            time.sleep(1.0)
            browser.drag(left + 300, top + 200, 160, 40)
            time.sleep(2.0)
            browser.shot(folder / "jupyter_picked.png")
            browser.value(f"{BUTTONS}.find(button => button.innerText.includes('Freeze')).click()")
            time.sleep(2.0)
            browser.drag(left + 300, top + 200, 200, 60)
            browser.mouse("mouseWheel", left + 300, top + 200, deltaX=0, deltaY=300)
            time.sleep(2.0)
            browser.shot(folder / "jupyter_frozen.png")
    finally:
        browser.close()


def main(target: str) -> None:
    """Make all pictures in a folder."""
    folder = Path(target).resolve()
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as temporary:
        mesh = Path(temporary) / "mesh.nanite"
        built = nrs.NaniteMesh.from_arrays(*nrs.shapes.displaced_icosphere(faces=FACES), progress=False)
        built.save(mesh, precision="exact")
        window(folder, mesh)
        notebook(folder, Path(temporary), mesh)


if __name__ == "__main__":
    main(sys.argv[1])
