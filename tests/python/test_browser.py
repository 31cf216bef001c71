"""The viewer in a cell of JupyterLab, in Chromium without a screen, against a viewer of this process."""

from __future__ import annotations

import math
import re

import numpy as np

import nanite_rs as nrs
from oracles.browser import notebook

FACES = 40_000
CELLS = (
    "import nanite_rs as nrs\n\n"
    f"mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.displaced_icosphere(faces={FACES}))",
    'viewer = nrs.view(mesh, width=480, height=360, backend="cpu")\nviewer',
)


def triangles(status: str) -> str:
    """The count in ``clusters · 3.1k triangles of 40k, …``."""
    return re.search(r"· (\S+) triangles", status)[1]


def test_a_browser_shows_what_the_viewer_draws(tmp_path) -> None:
    """Each picture is read from the page and compared; what a user does comes in by the mouse."""
    mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.displaced_icosphere(faces=FACES), progress=False)
    with (
        nrs.Viewer(mesh, width=480, height=360, backend="cpu") as here,
        notebook(tmp_path, CELLS, here) as cell,
    ):
        first = cell.wait("the first picture is another")
        covered = here.frame().depth > 0
        x, y = here.size[0] // 2, here.size[1] // 2
        background = first[y, 20]
        assert (first[covered] != background).any(axis=-1).mean() > 0.99
        inner = ~covered[8:-8, 8:-8]  # corners are round
        assert (first[8:-8, 8:-8][inner] == background).all(axis=-1).mean() > 0.95
        assert "drag turns" in cell.picked()

        found = here.pick(x, y, select=True)
        cell.click(x, y)
        picked = cell.wait("what was picked is not highlighted")
        changed = (np.abs(picked.astype(int) - first) > 8).any(axis=-1)
        highlighted = here.frame().cluster_id == found.cluster_id
        assert highlighted.sum() > 100
        assert changed[highlighted].mean() > 0.9
        assert not changed[~highlighted].any()
        cell.browser.wait(
            lambda: cell.picked().split() == str(found).split(), f"the text is not that of {found}"
        )

        cell.choose("clusters")
        here.view = "clusters"
        fine = cell.wait("the view of clusters is another")
        assert cell.status().startswith("clusters")
        before = triangles(cell.status())
        assert cell.pixel_error() == "1.00"
        cell.slide(60)
        cell.browser.wait(lambda: cell.pixel_error() != "1.00", "the slider does not move")
        # It has four steps for each doubling, and writes three digits.
        here.pixel_error = 2.0 ** (round(4 * math.log2(float(cell.pixel_error()))) / 4)
        assert here.pixel_error >= 2.0
        coarse = cell.wait("the picture does not follow the slider")
        assert (coarse != fine).any(axis=-1).mean() > 0.1
        cell.browser.wait(lambda: triangles(cell.status()) != before, "the count of triangles stays")
        assert here.stats.triangles < 0.7 * here.stats.source_triangles
        # What was picked is of a finer level, and the text owns up to it.
        assert here.selected_pixels == 0
        cell.browser.wait(lambda: "not seen now" in cell.picked(), "the text passes for one of the picture")

        cell.drag(x, y, 40, 20)
        here.orbit.turn(-0.4, 0.2)
        turned = cell.wait("a drag does not turn the camera")
        assert (turned != coarse).any(axis=-1).mean() > 0.1

        # The wheel is the canvas's once it was clicked, and the page's otherwise.
        cell.wheel(x, y, 200)
        here.orbit.zoom(1.0015**-200)
        cell.wait("the wheel does not zoom")
        cell.press("Freeze")
        here.freeze()
        cell.browser.wait(lambda: "frozen" in cell.status(), "the status does not say that it is frozen")
        cell.drag(x, y, -60, 0)
        here.orbit.turn(0.6, 0.0)
        cell.wait("the frozen cut is not shown from another place")
        cell.press("Reset")
        here.reset()
        cell.wait("the camera is not back where it was")
        assert cell.mistakes() == ""
