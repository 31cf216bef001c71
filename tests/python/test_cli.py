"""The command line: what it writes, what it says, and how it fails."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import trimesh
from PIL import Image

import nanite_rs as nrs
from nanite_rs import cli


@pytest.fixture
def built(tmp_path):
    path = tmp_path / "knot.nanite"
    assert cli.main(["build", "shape:torus_knot:20000", "-o", str(path), "--quiet"]) == 0
    return path


def run(*arguments: object, **options) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "nanite_rs", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=300, **options)


def test_build_says_what_it_did(tmp_path, capsys):
    path = tmp_path / "part.nanite"
    assert cli.main(["build", "shape:cad_part:5000:3", "--output", str(path), "--check"]) == 0
    text = capsys.readouterr().out
    assert "faces" in text
    assert "MB on disk" in text
    assert "every invariant holds" in text
    assert len(nrs.NaniteMesh.open(path)) > 4_000


def test_build_takes_its_name_from_the_input(tmp_path, monkeypatch):
    trimesh.creation.icosphere(subdivisions=3).export(tmp_path / "ball.v2.ply")
    monkeypatch.chdir(tmp_path)
    assert cli.main(["build", "ball.v2.ply", "-q"]) == 0
    assert len(nrs.NaniteMesh.open("ball.v2.nanite")) == 1280


def test_a_scene_is_rendered_with_its_textures(tmp_path):
    quad = trimesh.Trimesh([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    image = Image.fromarray(np.array([[[250, 20, 10], [10, 250, 20]]], np.uint8).repeat(8, 0).repeat(8, 1))
    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=image, roughnessFactor=1.0, metallicFactor=0.0
    )
    quad.visual = trimesh.visual.TextureVisuals(uv=[[0, 0], [1, 0], [1, 1], [0, 1]], material=material)
    quad.export(tmp_path / "sign.glb")
    pictures = {}
    for name, options in {"clay": [], "sign": ["--materials", "--samples", "4"]}.items():
        path = tmp_path / f"{name}.png"
        view = ["--size", "64x64", "--azimuth", "0", "--elevation", "0", "-q"]
        assert cli.main(["render", str(tmp_path / "sign.glb"), "-o", str(path), *view, *options]) == 0
        pictures[name] = np.asarray(Image.open(path)).astype(int)
    left, right = pictures["sign"][32, 20], pictures["sign"][32, 44]
    assert left[0] > 2 * left[1]
    assert right[1] > 2 * right[0]
    assert np.ptp(pictures["clay"][32, 20]) < 12


def test_build_options_reach_the_build(tmp_path):
    sizes = []
    for triangles in (32, 128):
        path = tmp_path / f"{triangles}.nanite"
        arguments = [
            "build",
            "shape:terrain:10000",
            "-o",
            str(path),
            "--cluster-triangles",
            str(triangles),
            "-q",
        ]
        assert cli.main(arguments) == 0
        sizes.append(nrs.NaniteMesh.open(path).report.clusters)
    assert sizes[0] > 3 * sizes[1]


def test_info_for_people_and_for_programs(built, capsys):
    assert cli.main(["info", str(built), "--check"]) == 0
    text = capsys.readouterr().out
    assert "bounds" in text
    assert "CheckReport" in text
    assert "At each level, finest first" in text
    assert cli.main(["info", str(built), "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["faces"] == data["report"]["input_faces"] == len(nrs.NaniteMesh.open(built))
    assert len(data["report"]["levels"]) >= data["levels"] - 1


def test_info_through_a_closed_pipe(built):
    code = f"{sys.executable} -m nanite_rs info {built} | head -n 1"
    result = subprocess.run(code, shell=True, capture_output=True, text=True, check=True)
    assert result.stdout.startswith("NaniteMesh(")
    assert result.stderr == ""


@pytest.mark.parametrize("suffix", ["ply", "obj", "stl", "glb", "off"])
def test_cut_writes_what_trimesh_reads(built, tmp_path, suffix):
    output = tmp_path / f"small.{suffix}"
    assert cli.main(["cut", str(built), "-o", str(output), "--target-faces", "2000"]) == 0
    mesh = trimesh.load_mesh(output)
    assert 500 < len(mesh.faces) <= 2_000
    assert mesh.is_watertight


def test_cut_writes_levels(built, tmp_path, capsys):
    output = tmp_path / "levels.glb"
    assert cli.main(["cut", str(built), "-o", str(output), "--levels", "0.5", "0.1"]) == 0
    assert capsys.readouterr().out.startswith(f"{output}: 2 levels of ")
    assert b"MSFT_lod" in output.read_bytes()
    assert cli.main(["cut", str(built), "-o", str(output), "--errors", "0.01", "0.1", "--separate"]) == 0
    assert (tmp_path / "levels_lod1.glb").exists()


def test_render_writes_the_picture_and_the_stages(built, tmp_path, capsys):
    from PIL import Image

    output = tmp_path / "levels.png"
    arguments = ["render", str(built), "-o", str(output), "--size", "160x90", "--view", "levels", "--stats"]
    assert cli.main(arguments) == 0
    assert Image.open(output).size == (160, 90)
    text = capsys.readouterr().out
    assert "instance_cull" in text
    assert "raster_small" in text


def test_render_takes_kinds_of_shadows(built, tmp_path, capsys):
    view = ["--size", "160x90", "--backend", "cpu", "--stats"]
    shown = {}
    for shadows in ([], ["--shadows"], ["--shadows", "virtual"], ["--shadows", "cascaded"]):
        output = tmp_path / "picture.png"
        # A file may follow the bare option.
        assert cli.main(["render", *shadows, str(built), "-o", str(output), *view]) == 0
        shown["=".join(shadows)] = np.asarray(Image.open(output)), capsys.readouterr().out
    plain, bare, virtual, cascaded = shown.values()
    assert np.array_equal(bare[0], virtual[0])
    assert not np.array_equal(plain[0], virtual[0])
    assert "pages wanted" in bare[1]
    assert "cascades" not in bare[1]
    assert "cascades" in cascaded[1]


def test_render_writes_arrays(built, tmp_path, capsys):
    import OpenImageIO as oiio

    output = tmp_path / "arrays.exr"
    assert cli.main(["render", str(built), "-o", str(output), "--size", "160x90"]) == 0
    assert oiio.ImageBuf(str(output)).spec().channelnames == ("R", "G", "B", "Z", "N.x", "N.y", "N.z")
    assert capsys.readouterr().out == f"{output}: 160 × 90\n"


def test_demo_on_a_small_mesh(tmp_path, capsys):
    folder = tmp_path / "demo"
    assert cli.main(["demo", "shape:gyroid_shell:50000", "-o", str(folder), "--size", "320x180"]) == 0
    text = capsys.readouterr().out
    for word in (
        "generate",
        "build",
        "check",
        "save",
        "open",
        "cut, −99.0%",
        "in the source",
        "drawn:",
        "ms",
    ):
        assert word in text
    assert "levels: red is the source" in text
    assert "replaced" not in text
    pictures = {p.name for p in folder.glob("*.png")}
    assert pictures == {"gyroid_shell_shadows.png"} | {
        f"gyroid_shell_{a}_{b}.png"
        for a in ("near", "whole", "far")
        for b in ("shaded", "clusters", "levels")
    }
    # The floor is brighter than the mesh's shadow on it.
    shaded = np.asarray(Image.open(folder / "gyroid_shell_shadows.png").convert("L"), float)
    assert np.ptp(shaded[90:]) > 60
    assert (folder / "gyroid_shell.nanite").exists()
    assert (folder / "gyroid_shell_report.txt").read_text(encoding="utf-8").strip() in text


def test_a_second_demo_leaves_the_first_ones_files(tmp_path, capsys):
    options = ["-o", str(tmp_path), "--size", "160x90", "-q", "--face-normals"]
    assert cli.main(["demo", "shape:torus_knot:5000", *options]) == 0
    first = {path: path.read_bytes() for path in tmp_path.iterdir()}
    assert cli.main(["demo", "shape:displaced_icosphere:5000", *options]) == 0
    assert "replaced" not in capsys.readouterr().out
    assert len(list(tmp_path.iterdir())) == 2 * len(first)
    assert all(path.read_bytes() == content for path, content in first.items())
    assert cli.main(["demo", "shape:displaced_icosphere:8000", *options]) == 0
    assert "files of an earlier demo of displaced_icosphere" in capsys.readouterr().out


def test_the_demos_legend_has_the_colours_of_the_levels(tmp_path):
    """Red for the source alone, where full detail is asked for; where it is not, others."""
    seen = {}
    for pixel_error in ("0", "8"):
        arguments = ["demo", "shape:torus_knot:40000", "-o", str(tmp_path), "--size", "320x180", "-q"]
        assert cli.main([*arguments, "--pixel-error", pixel_error]) == 0
        with Image.open(tmp_path / "torus_knot_whole_levels.png") as image:
            assert "nanite_rs:pose" in image.text
            picture = np.asarray(image.convert("RGB"))
        # The patches: a column through them, without their frame.
        colors, counts = np.unique(picture[:, 16], axis=0, return_counts=True)
        seen[pixel_error] = {
            tuple(map(int, color)) for color, n in zip(colors, counts, strict=True) if 12 <= n < 40
        }
    red = tuple(round(255 * x) for x in (0.97, 0.12, 0.12))
    assert red in seen["0"]
    assert red not in seen["8"]
    assert len(seen["8"]) >= 1


@pytest.mark.parametrize("name", ["--face-normals", "--flat"])
def test_faces_are_shaded_by_their_own_normals(tmp_path, name):
    counts = []
    for options in ([], [name]):
        path = tmp_path / "ball.png"
        view = ["--size", "120x120", "--pixel-error", "0", "-q", *options]
        assert cli.main(["render", "shape:torus_knot:500", "-o", str(path), *view]) == 0
        counts.append(len(np.unique(np.asarray(Image.open(path)).reshape(-1, 3), axis=0)))
    assert counts[1] < 0.5 * counts[0]


def test_help_teaches(capsys):
    assert cli.main(["--help"]) == 0
    text = capsys.readouterr().out
    for example in ("nanite-rs build dragon.ply", "--target-faces 10000", "--view clusters", "shape:NAME"):
        assert example in text
    for command in ("build", "info", "cut", "render", "demo"):
        assert cli.main([command, "--help"]) == 0
        assert f"example:\n  nanite-rs {command}" in capsys.readouterr().out


def test_version(capsys):
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out.strip() == f"nanite-rs {nrs.__version__}"


@pytest.mark.parametrize(
    "arguments",
    [[], ["fly"], ["build"], ["cut", "x.nanite", "-o", "x.ply"], ["render", "x.ply", "--size", "12"]],
)
def test_wrong_usage_exits_with_two(arguments):
    result = run(*arguments)
    assert result.returncode == 2
    assert result.stderr.startswith("usage: nanite-rs")
    assert "Traceback" not in result.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["info", "nowhere.ply"], "nanite-rs: nowhere.ply: No such file or directory"),
        (["info", "shape:banana"], "no such shape; choose from cad_part"),
        (["info", "shape:soup:many"], "expected shape:NAME[:FACES[:SEED]]"),
        (["build", "shape:soup:10", "-o", "x.ply"], "the output must end in .nanite"),
        (["build", "shape:soup:10", "-o", "nowhere/x.nanite"], "nowhere/x.nanite: No such file or directory"),
        (["build", "shape:soup:10", "--cluster-triangles", "7"], "cluster_triangles: must be between"),
        (["cut", "shape:soup:10", "-o", "x.xyzzy", "--error", "0"], "what can be written are 3mf"),
        (["render", "shape:soup:10", "-o", "x.jpg"], "x.jpg: extension .jpg is unknown"),
        (["cut", "shape:soup:10", "-o", "x.ply", "--error", "-1"], "error: must be 0 or more"),
    ],
)
def test_failures_are_one_line(tmp_path, arguments, message):
    result = run(*arguments, cwd=tmp_path)
    assert result.returncode == 1
    assert message in result.stderr
    assert result.stderr.count("\n") == 1
    assert result.stdout == ""
    assert list(tmp_path.iterdir()) == []


def test_ctrl_c_stops_a_build(tmp_path):
    # In the background of a shell SIGINT is ignored, and children inherit that.
    arguments = ["build", "shape:displaced_icosphere:6000000", "-q"]
    heed = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
    code = f"{heed}; from nanite_rs.cli import main; raise SystemExit(main({arguments}))"
    process = subprocess.Popen([sys.executable, "-c", code], cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    time.sleep(6.0)
    os.kill(process.pid, signal.SIGINT)
    # How soon it heeds is test_interrupt.py's.
    _, text = process.communicate(timeout=60)
    assert process.returncode == 130
    assert text.strip() == "nanite-rs: interrupted"
    assert list(tmp_path.iterdir()) == []


def test_warnings_are_a_line_and_name_no_code(tmp_path):
    """What is left out of a glTF is said, and how it is shown; what a picture lacks, without a line of Python."""
    vertices, faces = nrs.shapes.icosphere(faces=500)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.visual = trimesh.visual.TextureVisuals(
        uv=vertices[:, :2], material=trimesh.visual.material.PBRMaterial(baseColorFactor=[200, 30, 30, 255])
    )
    mesh.export(tmp_path / "ball.glb")
    far = trimesh.Trimesh(vertices + np.float32(1e7), faces, process=False)
    far.export(tmp_path / "far.ply")
    command = ["render", "ball.glb", "-o", "ball.png", "--size", "32x24", "--backend", "cpu"]
    plain = run(*command, cwd=tmp_path)
    assert plain.returncode == 0
    assert "nanite-rs: materials and textures are left out; --materials shows them" in plain.stderr
    shown = run(*command, "--materials", cwd=tmp_path)
    assert shown.returncode == 0
    assert "left out" not in shown.stderr
    single = run("info", "far.ply", cwd=tmp_path)
    assert single.returncode == 0
    assert single.stderr.startswith("nanite-rs: warning: vertices: ")
    for line in (plain.stderr + shown.stderr + single.stderr).splitlines():
        assert "Warning" not in line
        assert ".py:" not in line


def test_displace_and_terrain_build_what_they_say(tmp_path, capsys):
    quad = trimesh.Trimesh(
        [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]], process=False
    )
    quad.visual = trimesh.visual.TextureVisuals(uv=[[0, 0], [1, 0], [1, 1], [0, 1]])
    quad.export(tmp_path / "wall.glb")
    y, x = np.mgrid[:32, :32] / 32
    waves = np.sin(6 * x) * np.cos(5 * y)
    Image.fromarray((255 * np.abs(waves)).astype(np.uint8)).save(tmp_path / "waves.png")
    wall = [str(tmp_path / "wall.glb"), str(tmp_path / "waves.png"), "--scale", "0.1", "--tolerance", "0.002"]
    output = str(tmp_path / "wall.nanite")
    assert cli.main(["displace", *wall, "-o", output]) == 0
    assert "off by" in capsys.readouterr().out
    made = nrs.NaniteMesh.open(output)
    assert len(made) > 20
    assert made.cut(error=0).error < 0.003
    np.save(tmp_path / "waves.npy", 100 * waves)
    output = str(tmp_path / "hills.nanite")
    assert cli.main(["terrain", str(tmp_path / "waves.npy"), "-o", output, "--tolerance", "2"]) == 0
    assert "32 x 32 posts" in capsys.readouterr().out
    count = len(nrs.NaniteMesh.open(output))
    assert 10 < count < 2 * 31 * 31
    on_disk = ["-o", output, "--tolerance", "2", "--memory", "1MB"]
    assert cli.main(["terrain", str(tmp_path / "waves.npy"), *on_disk]) == 0
    assert "32 x 32 posts" in capsys.readouterr().out
    # Files larger than memory keep a part of the tolerance for their grid.
    stored = nrs.NaniteMesh.open(output)
    assert count <= len(stored) < 1.2 * count
    assert stored.cut(error=0).error <= 2.0
    np.arange(10, dtype=">i2").tofile(tmp_path / "odd.hgt")
    assert cli.main(["terrain", str(tmp_path / "odd.hgt"), "-o", output, "--tolerance", "2"]) != 0
    assert "no square" in capsys.readouterr().err
    assert cli.main(["displace", *wall, "-o", str(tmp_path / "wall.obj")]) != 0
    assert "must end in .nanite" in capsys.readouterr().err
