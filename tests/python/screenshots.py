"""Pictures of the viewer as users see it: in a window, and in JupyterLab in a browser.

`make screenshots` runs this. It drives both as a user does, and in the browser checks each picture against a viewer
of its own.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from PIL import Image

import nanite_rs as nrs
from oracles.browser import notebook
from oracles.desk import Desk, screen

FACES = 400_000
CELLS = (
    "import nanite_rs as nrs\n\n"
    f"mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.displaced_icosphere(faces={FACES}))",
    'viewer = nrs.view(mesh, width=720, height=480, backend="cpu")\nviewer',
)


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


def in_a_cell(folder: Path, work: Path, mesh: Path) -> None:
    """Look around in a cell."""
    with (
        nrs.Viewer(nrs.NaniteMesh.open(mesh), width=720, height=480, backend="cpu") as here,
        notebook(work, CELLS, here) as cell,
    ):

        def shot(name: str) -> None:
            cell.wait(f"{name} is not what the viewer draws")
            cell.browser.shot(folder / f"jupyter_{name}.png")
            print(folder / f"jupyter_{name}.png")

        shot("shaded")
        x, y = here.size[0] // 2, here.size[1] // 2
        cell.choose("clusters")
        here.view = "clusters"
        cell.drag(x, y, 160, 40)
        here.orbit.turn(-1.6, 0.4)
        cell.wait("a drag does not turn the camera")
        cell.click(x - 60, y + 70)
        found = here.pick(x - 60, y + 70, select=True)
        cell.browser.wait(lambda: cell.picked().split() == str(found).split(), f"the text is not {found}")
        shot("picked")
        cell.press("Freeze")
        here.freeze()
        cell.drag(x, y, 200, 60)
        cell.wheel(x, y, 300)
        here.orbit.turn(-2.0, 0.6)
        here.orbit.zoom(1.0015**-300)
        shot("frozen")


def main(target: str) -> None:
    """Make all pictures in a folder."""
    folder = Path(target).resolve()
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as temporary:
        mesh = Path(temporary) / "mesh.nanite"
        built = nrs.NaniteMesh.from_arrays(*nrs.shapes.displaced_icosphere(faces=FACES), progress=False)
        built.save(mesh, precision="exact")
        window(folder, mesh)
        in_a_cell(folder, Path(temporary), mesh)


if __name__ == "__main__":
    main(sys.argv[1])
