"""The page beside a tileset, in Chromium: what 3d-tiles-renderer shows is what the source looks like."""

from __future__ import annotations

import http.server
import json
import os
import threading
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy import ndimage

import nanite_rs as nrs
from nanite_rs._tiles import preview
from oracles.browser import Browser
from oracles.camera import look_at
from oracles.compare import psnr

if TYPE_CHECKING:
    from collections.abc import Iterator

#: Where `make test` puts it.
PACKAGES = Path(__file__).resolve().parents[2] / "target" / "tile-viewer" / "node_modules"
pytestmark = [
    pytest.mark.skipif(
        not (PACKAGES / "3d-tiles-renderer").exists(),
        reason="three.js and 3d-tiles-renderer are not there; tools/tile-viewer fetches them",
    ),
    pytest.mark.slow,
]
VIEWS = 60 if os.environ.get("NANITE_SOAK") else 8
IDLE = "view.tiles.stats.downloading + view.tiles.stats.parsing + view.tiles.stats.queued == 0"


@contextmanager
def served(folder: Path) -> Iterator[str]:
    """A static server: the folder, and packages by their names and versions."""

    class Handler(http.server.SimpleHTTPRequestHandler):
        def translate_path(self, path: str) -> str:
            path = path.partition("?")[0]
            if not path.startswith("/npm/"):
                return str(folder / path.lstrip("/"))
            package, _, rest = path.removeprefix("/npm/").partition("/")
            return str(PACKAGES / package.partition("@")[0] / rest)

        def log_message(self, *_: object) -> None:
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_address[1]}/"
        server.shutdown()


@contextmanager
def opened(folder: Path, profile: Path) -> Iterator[Browser]:
    """The page of a folder, in Chromium with WebGL."""
    with served(folder) as url:
        browser = Browser(profile, 400, 300, "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
        try:
            browser.call("Page.navigate", url=f"{url}index.html")
            yield browser
        finally:
            browser.close()


@contextmanager
def shown(folder: Path, profile: Path) -> Iterator[Browser]:
    """The page of a tileset, without its panel, and its camera left alone; packages come from here."""
    (folder / "index.html").write_bytes(preview.page("tiles", 1.0, "/npm/"))
    with opened(folder, profile) as browser:
        browser.until("window.view && view.placed")
        browser.value("document.getElementById('panel').style.display = 'none'; view.held = true")
        yield browser


def beyond(a: np.ndarray, b: np.ndarray) -> int:
    """Pixels of a mask that are more than two pixels from the other."""
    return int((a & ~ndimage.binary_dilation(b, np.ones((5, 5), bool))).sum())


def settled(browser: Browser) -> None:
    """Wait until the tiles of a view have come, and were drawn."""
    for _ in range(2):
        frames = browser.value("view.frames")
        browser.until(f"view.frames > {frames} + 3 && {IDLE}")


def test_silhouettes_along_a_path(tmp_path) -> None:
    mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.displaced_icosphere(faces=120_000))
    folder = tmp_path / "tiles"
    mesh.to_3dtiles(folder, triangles=3_000, preview=True)
    assert preview.PACKAGES in (folder / "index.html").read_text()
    scene = nrs.Scene()
    scene.add(mesh)
    levels, mixed = set(), 0
    with shown(folder, tmp_path / "chromium") as browser:
        browser.value("view.renderer.setClearColor(0xff00ff)")
        *center, radius = browser.value("[...view.sphere.center.toArray(), view.sphere.radius]")
        height, width = browser.seen().shape[:2]
        renderer = nrs.Renderer(width, height, backend="cpu")
        for k in range(VIEWS):
            around = 2.0 * np.pi * (k + 0.5) / VIEWS
            above = 0.4 * np.sin(3.0 * around)
            out = radius * (1.05 + 0.8 * (0.5 + 0.5 * np.cos(2.0 * around)))
            eye = out * np.array(
                [np.cos(around) * np.cos(above), np.sin(around) * np.cos(above), np.sin(above)]
            )
            target = 0.35 * radius * np.array([np.sin(around), -np.cos(around), 0.0])
            # The page has y up, about the middle.
            there = [[float(p[0]), float(p[2]), -float(p[1])] for p in (eye, target)]
            browser.value(f"view.camera.position.set(...{there[0]}); view.camera.lookAt(...{there[1]})")
            settled(browser)
            theirs = (np.abs(browser.seen().astype(int) - (255, 0, 255)) > 24).any(axis=2)
            pose = look_at(eye + center, target + center, (0.0, 0.0, 1.0))
            camera = nrs.PerspectiveCamera(yfov=np.radians(50.0), znear=1e-3 * radius)
            frame = renderer.render(scene, camera, pose, outputs=["depth"])
            ours = frame.depth > 0.0
            assert ours.mean() > 0.1
            assert beyond(theirs, ours) == beyond(ours, theirs) == 0
            # Holes. Not the other way: where a notch ends moves by more than its sides do.
            assert beyond(~theirs, ~ours) == 0
            seen = json.loads(
                browser.value(
                    "JSON.stringify([...view.tiles.visibleTiles].map((tile) => tile.metadata.properties.level))"
                )
            )
            levels |= set(seen)
            mixed += len(set(seen)) > 1
    assert len(levels) >= 2
    assert mixed > 0, "views have tiles of several levels"


def test_textures_as_ktx2(tmp_path) -> None:
    """They show what the images of the source do."""
    pixels = np.zeros((128, 128, 3), np.uint8)
    y, x = np.mgrid[:128, :128]
    pixels[..., 0], pixels[..., 1], pixels[..., 2] = 2 * x, 2 * y, 255 * ((x // 32 + y // 32) % 2)
    texture = nrs.Texture(nrs.Image(pixels))
    vertices, faces = nrs.shapes.icosphere(faces=5_000)
    uvs = 0.5 + 0.45 * vertices[:, :2].astype(np.float32)
    look = nrs.Material(base_color_texture=texture, metallic=0.0, roughness=1.0)
    mesh = nrs.NaniteMesh.from_arrays(vertices, faces, uvs=uvs, materials=[look])
    pictures = []
    for images in ("png", "ktx2"):
        folder = tmp_path / images
        mesh.to_3dtiles(folder, triangles=2_000, preview=True, images=images)
        with shown(folder, tmp_path / f"chromium-{images}") as browser:
            settled(browser)
            pictures.append(browser.seen())
    png, ktx2 = pictures
    assert png.std() > 30.0
    assert psnr(png, ktx2) >= 30.0
    assert (png != ktx2).any()
