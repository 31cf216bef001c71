"""The page of the benchmarks, made of small meshes as its own command does it: so that it cannot rot."""

from __future__ import annotations

import json
import math
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

pyrender = pytest.importorskip("pyrender")  # one peer of the benchmarks
ROOT = Path(__file__).resolve().parents[2]
SECTIONS = {"build", "cut", "decimate", "distance", "files", "frames", "instances", "memory"}
HEAD = "|  | unit | nanite_rs | peer | peer's | × |"


@pytest.fixture(scope="module")
def page(tmp_path_factory) -> Path:
    """The folder of a page."""
    try:
        pyrender.OffscreenRenderer(8, 8).delete()
    except (ImportError, AttributeError, OSError) as error:
        pytest.skip(f"pyrender cannot draw here: {error}")
    folder = tmp_path_factory.mktemp("report")
    command = [sys.executable, "-m", "benchmarks.python.report", "--fast", "--output", str(folder)]
    path = os.pathsep.join([str(ROOT / "python"), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        command, cwd=ROOT, env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def parts(page: Path) -> list[str]:
    """The sections of the Markdown, after what comes before all of them."""
    return re.split(r"^## ", (page / "report.md").read_text(encoding="utf-8"), flags=re.MULTILINE)


def test_every_section_has_figures_beside_a_peer(page):
    _, *sections = parts(page)
    assert {re.search(r"\]\((\w+)\.png\)", section)[1] for section in sections} == SECTIONS
    for section in sections:
        rows = [line.strip("| ").split(" | ") for line in section.partition(HEAD)[2].splitlines()[2:] if line]
        assert len(rows) >= 2, section
        for what, unit, ours, peer, theirs, ratio in rows:
            assert what, section
            assert unit, section
            assert peer, section
            numbers = [float(text.replace(",", "")) for text in (ours, theirs, ratio)]
            assert all(math.isfinite(number) and number > 0 for number in numbers), (what, peer, numbers)
            assert numbers[2] == pytest.approx(numbers[1] / numbers[0], rel=0.02), (what, peer)


def test_pages_have_their_pictures(page):
    html = (page / "index.html").read_text(encoding="utf-8")
    assert re.findall(r'src="(\w+)\.png"', html) == [
        re.search(r"\((\w+)\.png\)", p)[1] for p in parts(page)[1:]
    ]
    for name in SECTIONS:
        with Image.open(page / f"{name}.png") as picture:
            pixels = np.asarray(picture.convert("RGB"))
        # Ours is drawn in one blue in every picture, and peers in one orange.
        for color in ((0x1F, 0x5F, 0xA8), (0xC8, 0x64, 0x2B)):
            assert (pixels == color).all(axis=-1).sum() > 50, (name, color)


def test_pages_hold_the_same_and_say_what_it_was_measured_on(page):
    html = (page / "index.html").read_text(encoding="utf-8")
    text = re.sub(r"\s+", " ", re.sub(r"<[^>]*>", " ", html)).replace("&#x27;", "'").replace("&quot;", '"')
    head, *sections = parts(page)
    for row in re.findall(r"^\| (.*) \|$", head + "".join(sections), re.MULTILINE):
        if row.strip("| "):
            assert " ".join(cell for cell in row.split(" | ") if cell.strip()) in text
    machine = json.loads((page / "results.json").read_text(encoding="utf-8"))["machine"]
    for value in (machine["processor"], machine["device"], machine["python"], str(machine["memory_gib"])):
        assert value in head
    for package, version in machine["packages"].items():
        assert version is None or f"{package} {version}" in head
    assert "not to quote" in head
