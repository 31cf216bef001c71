"""The command line: ``python -m nanite_rs`` and ``nanite-rs``."""

from __future__ import annotations

import argparse
import itertools
import json
import math
import os
import platform
import sys
import time
import warnings
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar, get_args

import numpy as np

import nanite_rs as nrs
from nanite_rs import (
    _advice,
    _core,
    _export,
    _export_parts,
    _images,
    _overlay,
    _paint,
    _sources,
    _text,
    _upload,
    io,
    shapes,
)
from nanite_rs._export_packing import Compression, ImageFormat
from nanite_rs._preview import BACKGROUND, CLAY, UP, picture
from nanite_rs.exceptions import ArgumentError, FormatError, NaniteError
from nanite_rs.frame import ViewName
from nanite_rs.renderer import ShadowsName
from nanite_rs.texture import Wrap

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from numpy.typing import NDArray

T = TypeVar("T")

EPILOG: Final = """\
examples:
  nanite-rs build dragon.ply                        write dragon.nanite
  nanite-rs build *.ply -o built/                   write a file for each, and say which failed
  nanite-rs build tiles/ -o terrain.nanite          write one file of all meshes in a folder
  nanite-rs build dragon.ply -o s3://bucket/dragon.nanite
  nanite-rs displace wall.glb bricks.png --tolerance 0.001
  nanite-rs terrain N43E006.hgt --tolerance 5 --spacing 66 92
  nanite-rs info dragon.nanite                      what is in it, and what building did
  nanite-rs info https://example.org/dragon.nanite  the same, without loading the file
  nanite-rs cut dragon.nanite -o small.ply --target-faces 10000
  nanite-rs cut dragon.nanite -o close.obj --error 0.001
  nanite-rs render dragon.nanite -o dragon.png --size 1920x1080
  nanite-rs render dragon.nanite -o clusters.png --view clusters --pixel-error 4
  nanite-rs foliage tree.glb -o tree.nanite         leaf cards as geometry
  nanite-rs view dragon.nanite                      look around in a window
  nanite-rs demo                                    all of it, on a generated mesh
  nanite-rs demo dragon.ply                         all of it, on yours

INPUT is a .nanite file or its URL, any mesh file (PLY, OBJ, STL, GLB, glTF, OFF, …, also .gz), or a
generated mesh written as shape:NAME, shape:NAME:FACES or shape:NAME:FACES:SEED, where NAME is one of
{shapes}.
"""

SUN_DEGREES: Final = 0.53
"""The angle at which the sun is seen."""
_SHADOWS: Final = "--shadows"
SHAPE_PREFIX: Final = "shape:"
DEMO_SHAPE: Final = "shape:displaced_icosphere:2000000"
PICTURES: Final = ("whole", "near", "far")
PICTURE_VIEWS: Final = ("shaded", "clusters", "levels")
VIEWS: Final = get_args(ViewName)


# ---------------------------------------------------------------------------------------------------- input


def _generated(name: str) -> shapes.Mesh:
    """The mesh that shape:NAME[:FACES[:SEED]] stands for."""
    kind, *numbers = name.removeprefix(SHAPE_PREFIX).split(":")
    if kind not in shapes.SHAPES:
        raise ArgumentError(f"{name}: no such shape; choose from {', '.join(shapes.SHAPES)}")
    try:
        faces, seed = [*map(int, numbers), *(1_000_000, 0)[len(numbers) :]]
    except ValueError:
        raise ArgumentError(f"{name}: expected shape:NAME[:FACES[:SEED]]") from None
    return shapes.SHAPES[kind](faces=faces, seed=seed)


def _is_built(name: str) -> bool:
    return _sources.ending(name) == io.NANITE_SUFFIX


def _stem(name: str) -> str:
    """A file name without folder and extension, for outputs."""
    if name.startswith(SHAPE_PREFIX):
        return name.split(":")[1]
    return io.stem(name)


def _mesh(arguments: argparse.Namespace) -> nrs.NaniteMesh:
    """The mesh that INPUT names, built unless it is built already."""
    name: str = arguments.input
    progress = False if arguments.quiet else None
    if _is_built(name):
        return nrs.NaniteMesh.open(name)
    if name.startswith(SHAPE_PREFIX):
        return nrs.NaniteMesh.from_arrays(*_generated(name), options=_options(arguments), progress=progress)
    return nrs.NaniteMesh.from_file(name, options=_options(arguments), progress=progress)


def _options(arguments: argparse.Namespace) -> nrs.BuildOptions:
    known = asdict(nrs.BuildOptions())
    # `--error` is the cut's.
    values = vars(arguments) | {"error": arguments.error_measure}
    given = {k: v for k, v in values.items() if k in known and v is not None}
    return nrs.BuildOptions(**given)


# --------------------------------------------------------------------------------------------------- output


def _timed(work: Callable[[], T]) -> tuple[T, float]:
    start = time.perf_counter()
    result = work()
    return result, time.perf_counter() - start


# -------------------------------------------------------------------------------------------------- commands


def _build(arguments: argparse.Namespace) -> int:
    folder = arguments.output is not None and (
        arguments.output.endswith(("/", os.sep)) or os.path.isdir(arguments.output)
    )
    if len(arguments.inputs) > 1 or folder:
        return _build_many(arguments)
    (arguments.input,) = arguments.inputs
    output = arguments.output or f"{_stem(arguments.input)}{io.NANITE_SUFFIX}"
    if not _is_built(output):
        raise ArgumentError(f"{_sources.shown(output)}: the output must end in {io.NANITE_SUFFIX}")
    # A folder is a source in pieces, whatever its size.
    in_blocks = (
        arguments.memory is not None or arguments.scheduler is not None or os.path.isdir(arguments.input)
    )
    # What goes to a URL is built on disk: in this folder, where a build that is resumed finds its work folder.
    place = os.curdir if in_blocks and _sources.is_url(output) else None
    work = arguments.work or place
    progress = False if arguments.quiet else None
    with _upload.written(output, folder=place, progress=progress) as path:
        if in_blocks:
            name = arguments.input
            source = _generated(name) if name.startswith(SHAPE_PREFIX) else name
            with _cluster(arguments.scheduler) as client:
                how = {"executor": client, "folder": work, **_how(arguments)}
                mesh, seconds = _timed(lambda: nrs.build_file(source, path, **how))
        else:
            mesh, seconds = _timed(lambda: _mesh(arguments))
        if arguments.check:
            mesh.check()
        if not in_blocks:
            mesh.save(path)
        size = _text.megabytes(path.stat().st_size)
    if not arguments.quiet:
        checked = ", every invariant holds" if arguments.check else ""
        print(f"{_sources.shown(output)}: {mesh}, {size} on disk, {_text.seconds(seconds)}{checked}")
    return 0


def _how(arguments: argparse.Namespace) -> dict[str, Any]:
    """What `build_file` and `build_many` take alike."""
    given = {} if arguments.memory is None else {"memory": arguments.memory}
    progress = False if arguments.quiet else None
    return {"options": _options(arguments), "resume": arguments.resume, "progress": progress, **given}


def _build_many(arguments: argparse.Namespace) -> int:
    output = arguments.output or "."
    if _is_built(output):
        raise ArgumentError(f"{_sources.shown(output)}: several inputs are built into a folder")
    for name in arguments.inputs:
        if name.startswith(SHAPE_PREFIX):
            raise ArgumentError(f"{name}: is built alone, into a file")
    existing: Any = "skip" if arguments.skip_existing else "replace"
    with _cluster(arguments.scheduler) as client:
        results = nrs.build_many(
            arguments.inputs, output, client=client, existing=existing, **_how(arguments)
        )
    if arguments.check:
        results = nrs.BuildResults(map(_checked, results))
    if not arguments.quiet:
        print(results)
    elif results.failed:
        print(nrs.BuildResults(results.failed), file=sys.stderr)
    return 1 if results.failed else 0


def _checked(result: nrs.BuildResult) -> nrs.BuildResult:
    """Check what was built."""
    if result.error is None:
        try:
            nrs.NaniteMesh.open(result.path).check()
        except NaniteError as error:
            return replace(result, error=f"{type(error).__name__}: {_one_line(error)}")
    return result


@contextmanager
def _cluster(address: str | None) -> Iterator[Any]:
    """Yield a client of a scheduler; None where there is none."""
    if address is None:
        yield None
        return
    try:
        from distributed import Client
    except ImportError:
        raise _advice.missing("--scheduler", "distributed") from None
    try:
        client = Client(address, set_as_default=False)
    except ValueError as error:
        raise ArgumentError(f"--scheduler {address}: {error}") from None
    with client:
        yield client


def _info(arguments: argparse.Namespace) -> int:
    mesh = _mesh(arguments)
    if arguments.json:
        print(json.dumps({**mesh.info, "report": asdict(mesh.report)}, indent=2))
        return 0
    info = mesh.info
    low, high = info["bounds"]
    print(mesh)
    print(f"{'bounds':>13}  {_triple(low)} to {_triple(high)}")
    sets = info["uv_sets"]
    uvs = [] if not sets else ["UVs" if sets == 1 else f"{sets} UV sets"]
    attributes = ["normals", *(["colours"] if info["colors"] else []), *uvs, *info["channels"]]
    print(f"{'attributes':>13}  {', '.join(attributes)}")
    if mesh.materials:
        images = {id(texture.image) for look in mesh.materials for _, texture in _export_parts.textures(look)}
        print(f"{'materials':>13}  {len(mesh.materials):,}, with {len(images):,} images")
    if info["rounding"]:
        print(f"{'rounding':>13}  positions moved by {info['rounding']:.3g} at most")
    print(mesh.report)
    if arguments.check:
        print(mesh.check())
    if mesh.traffic is not None:
        print(f"{'read':>13}  {mesh.traffic}")
    return 0


def _triple(point: Sequence[float]) -> str:
    return "(" + ", ".join(f"{x:.6g}" for x in point) + ")"


def _cut(arguments: argparse.Namespace) -> int:
    output = Path(arguments.output)
    _export.ending_of(arguments.output)  # before anything is built
    mesh = _mesh(arguments)
    if arguments.levels is not None or arguments.errors is not None:
        chosen = {"levels": arguments.levels, "errors": arguments.errors}
        names = mesh.export(output, separate=arguments.separate, **chosen)
        if not arguments.quiet:
            print(
                f"{', '.join(names)}: {len(arguments.levels or arguments.errors)} levels of {len(mesh):,} faces"
            )
        return 0
    cut, seconds = _timed(
        lambda: mesh.cut(
            error=arguments.error,
            target_faces=arguments.target_faces,
            target_reduction=arguments.target_reduction,
            exact=False if arguments.whole_groups else None,
        )
    )
    cut.export(output)
    if not arguments.quiet:
        print(f"{output}: {cut} of {len(mesh):,} faces, in {_text.seconds(seconds)}")
    return 0


def _tiles(arguments: argparse.Namespace) -> int:
    folder = arguments.output or f"{_stem(arguments.input)}_tiles"
    up = arguments.up
    if up is None and arguments.crs is None and arguments.input.lower().endswith((".glb", ".gltf")):
        up = "y"
    chosen: dict[str, Any] = {
        "triangles": arguments.triangles,
        "compression": None if arguments.compression == "none" else arguments.compression,
        "images": arguments.images,
        "skirts": not arguments.no_skirts,
        "pixel_error": arguments.pixel_error,
        "up": up,
        "crs": arguments.crs,
        "preview": arguments.preview,
        "overwrite": arguments.overwrite,
    }
    mesh = _mesh(arguments)
    progress = False if arguments.quiet else None
    report, seconds = _timed(lambda: mesh.to_3dtiles(folder, progress=progress, **chosen))
    if not arguments.quiet:
        print(
            f"{report.path}: {report.tiles:,} tiles of {report.levels} levels, {_text.megabytes(report.bytes)}, "
            f"{report.median_bytes / 1000:,.0f} kB in the median, in {_text.seconds(seconds)}"
        )
    return 0


def _foliage(arguments: argparse.Namespace) -> int:
    from nanite_rs._foliage import command

    return command.run(arguments, replace(_options(arguments), preserve_area=True))


def _imposter(arguments: argparse.Namespace) -> int:
    name: str = arguments.input
    folder = arguments.output or f"{_stem(name)}_imposter"
    shown: nrs.NaniteMesh | nrs.LoadedScene
    if _is_built(name) or name.startswith(SHAPE_PREFIX):
        shown = _mesh(arguments)
    else:  # with the materials and instances of the file
        progress = False if arguments.quiet else None
        shown = nrs.load_scene(name, options=_options(arguments), progress=progress)
    how = {name: getattr(arguments, name) for name in ("views", "size", "up", "backend")}
    baked, seconds = _timed(lambda: nrs.bake_imposter(shown, full_sphere=not arguments.half, **how))
    baked.save(folder)
    if not arguments.quiet:
        said = str(baked).strip("<>").removeprefix("Imposter ")
        print(f"{folder}: {said}, {_text.megabytes(baked.nbytes)} of texels, in {_text.seconds(seconds)}")
    return 0


def _displace(arguments: argparse.Namespace) -> int:
    output = _built_name(arguments)
    source = io.from_file(arguments.input, name="input")
    uvs = source.uvs[0] if isinstance(source.uvs, list | tuple) and source.uvs else source.uvs
    if uvs is None or len(uvs) == 0:
        raise ArgumentError(f"{arguments.input}: it has no texture coordinates to lay a height map by")
    normals = None if source.normals is None else np.asarray(source.normals, np.float64)
    made, seconds = _timed(
        lambda: nrs.displace(
            source.vertices,
            source.faces,
            uvs=np.asarray(uvs, np.float64),
            normals=normals,
            height=arguments.height,
            scale=arguments.scale,
            midlevel=arguments.midlevel,
            tolerance=arguments.tolerance,
            wrap=arguments.wrap,
            max_triangles=arguments.max_triangles,
        )
    )
    progress = False if arguments.quiet else None
    mesh = made.build(
        face_materials=source.face_materials,
        face_channels=source.face_channels or None,
        materials=source.materials or None,
        options=_options(arguments),
        progress=progress,
    )
    mesh.save(output)
    if not arguments.quiet:
        torn = f", up to {made.tear:.4g} beside its torn edges" if made.tear else ""
        print(
            f"{output}: {mesh}, off by {made.error:.4g} or less{torn}, displaced in {_text.seconds(seconds)}"
        )
    return 0


def _terrain(arguments: argparse.Namespace) -> int:
    output = _built_name(arguments)
    heights = _heights(arguments.input)
    spacing = arguments.spacing[0] if len(arguments.spacing) == 1 else tuple(arguments.spacing)
    progress = False if arguments.quiet else None
    how: dict[str, Any] = {
        "spacing": spacing,
        "tolerance": arguments.tolerance,
        "nodata": arguments.nodata,
        "options": _options(arguments),
        "progress": progress,
    }
    memory = arguments.memory
    if memory is None:
        mesh, seconds = _timed(lambda: nrs.NaniteMesh.from_heightfield(heights, **how))
        mesh.save(output)
    else:
        mesh, seconds = _timed(lambda: nrs.build_heightfield(heights, output, memory=memory, **how))
    if not arguments.quiet:
        posts = f"{heights.shape[0]:,} x {heights.shape[1]:,} posts"
        print(f"{output}: {mesh} of {posts}, in {_text.seconds(seconds)}")
    return 0


def _heights(name: str) -> NDArray[Any]:
    """The heights of a file: .npy, .hgt of SRTM, or a grey picture, as the numbers that are in it."""
    if _sources.ending(name) == ".npy":
        try:
            array: NDArray[Any] = np.load(name, mmap_mode="r", allow_pickle=False)
        except ValueError as error:
            raise FormatError(f"{name}: {error}") from None
        return array
    if _sources.ending(name) == ".hgt":
        numbers = np.memmap(name, ">i2", "r")
        side = math.isqrt(len(numbers))
        if side * side != len(numbers):
            raise FormatError(f"{name}: {len(numbers):,} heights are no square")
        return numbers.reshape(side, side)
    pixels = nrs.Image.open(name).pixels
    if not (pixels == pixels[:, :, :1]).all():
        raise ArgumentError(f"{name}: heights are one channel, not {pixels.shape[2]} different ones")
    return pixels[:, :, 0]


def _built_name(arguments: argparse.Namespace) -> str:
    output: str = arguments.output or f"{_stem(arguments.input)}{io.NANITE_SUFFIX}"
    if not _is_built(output):
        raise ArgumentError(f"{output}: the output must end in {io.NANITE_SUFFIX}")
    return output


def _render(arguments: argparse.Namespace) -> int:
    _images.suffix(arguments.output)
    shown = _shown(arguments)
    # Of a .nanite file what the picture needs is read, however large the rest.
    with nrs.Renderer(
        *arguments.size, backend=arguments.backend, streaming=True, pool_bytes=1 << 40
    ) as renderer:
        frame = picture(
            renderer,
            shown,
            **_view(arguments),
            distance=arguments.distance,
            pixel_error=arguments.pixel_error,
            samples=arguments.samples,
            shadows=arguments.shadows,
        )
    frame.save(arguments.output, view=arguments.view)
    if not arguments.quiet:
        view = f", {arguments.view}" if arguments.view else ""
        print(f"{arguments.output}: {arguments.size[0]} × {arguments.size[1]}{view}")
    if arguments.stats:
        print(frame.stats)
    return 0


def _look(arguments: argparse.Namespace) -> int:
    shown = _shown(arguments)
    options = {name: getattr(arguments, name) for name in ("pixel_error", "backend", "up", "shadows")}
    options |= {name: getattr(arguments, name) for name in ("yfov", "azimuth", "elevation")}
    if isinstance(shown, nrs.NaniteMesh):
        options["material"] = replace(CLAY, smooth=not arguments.face_normals, double_sided=True)
    width, height = arguments.size
    view = arguments.view or "shaded"
    nrs.view(shown, canvas=arguments.canvas, width=width, height=height, view=view, **options)
    return 0


def _shown(arguments: argparse.Namespace) -> nrs.NaniteMesh | nrs.LoadedScene:
    """What INPUT names, with its materials if wished."""
    time = getattr(arguments, "time", None)
    if arguments.materials or time is not None:
        progress = False if arguments.quiet else None
        loaded = nrs.load_scene(arguments.input, options=_options(arguments), progress=progress)
        if time is not None:
            name: str = arguments.animation
            loaded.set_time(time, int(name) if name.isdecimal() else name)
        return loaded
    mesh = _mesh(arguments)
    if mesh.materials and not arguments.quiet:
        print("nanite-rs: materials and textures are left out; --materials shows them", file=sys.stderr)
    return mesh


def _view(arguments: argparse.Namespace) -> dict[str, Any]:
    """What `picture` takes of the options of a view."""
    angles = {name: getattr(arguments, name) for name in ("yfov", "azimuth", "elevation", "up")}
    return {**angles, "material": replace(CLAY, smooth=not arguments.face_normals)}


# ----------------------------------------------------------------------------------------------------- demo


def _demo(arguments: argparse.Namespace) -> int:
    folder = Path(arguments.output)
    folder.mkdir(parents=True, exist_ok=True)
    # Named after the mesh, so that several demos can share a folder.
    name, stem = arguments.input, folder / _stem(arguments.input)
    found = {path.name for path in folder.iterdir()}
    steps: list[tuple[str, str, str]] = [("step", "result", "time")]

    def step(what: str, work: Callable[[], T], result: Callable[[T], str]) -> T:
        if sys.stderr.isatty() and not arguments.quiet:
            print(f"{what} …", file=sys.stderr)
        value, seconds = _timed(work)
        steps.append((what, result(value), _text.seconds(seconds)))
        return value

    mesh = _demo_mesh(name, arguments, step)
    step(
        "check", mesh.check, lambda r: f"{r.clusters:,} clusters, {r.groups:,} groups: every invariant holds"
    )
    path = Path(f"{stem}{io.NANITE_SUFFIX}")
    step("save", lambda: mesh.save(path), lambda _: f"{path}, {_text.megabytes(path.stat().st_size)}")
    mesh = step("open", lambda: nrs.NaniteMesh.open(path), lambda _: "the same mesh again")
    for reduction in (0.9, 0.99, 0.999):
        step(
            f"cut, −{reduction:.1%}" + (", and reading the file" if reduction == 0.9 else ""),
            lambda reduction=reduction: mesh.cut(target_reduction=reduction),  # type: ignore[misc]
            lambda cut: f"{len(cut):,} triangles, error {cut.error:.3g}",
        )
    pictures = _demo_pictures(mesh, arguments, stem)
    lines = [
        f"nanite_rs {nrs.__version__}, {platform.machine()}, {os.cpu_count()} cores, "
        f"{arguments.size[0]} × {arguments.size[1]}, pixel error {arguments.pixel_error:g}",
        "",
        _text.table(steps, right=(2,)),
        "",
        "triangles",
        _text.table(pictures, right=(1, 2, 3, 4, 5)),
        "in the cut: of the clusters that show what is in sight within the pixel error",
        "drawn: of these, what faces the camera and may reach the centre of a pixel",
        "",
    ]
    Path(f"{stem}_report.txt").write_text("\n".join(lines), encoding="utf-8")
    print("\n".join(lines))
    print(
        f"pictures: {stem}_A_B.png, where A is {_listed(PICTURES)} and B is {_listed(PICTURE_VIEWS)}\n"
        f"  and {stem}_shadows.png, on a floor under a sun\n"
        f"  clusters: a colour for each; levels: red is the source, towards blue each has half the triangles\n"
        f"what each stage received, passed on and took: {stem}_stages.txt"
    )
    if f"{stem.name}_report.txt" in found:
        print(f"files of an earlier demo of {stem.name} in {folder} were replaced")
    return 0


def _listed(names: Sequence[str]) -> str:
    return f"{', '.join(names[:-1])} or {names[-1]}"


def _demo_pictures(mesh: nrs.NaniteMesh, arguments: argparse.Namespace, stem: Path) -> list[tuple[str, ...]]:
    """Save pictures from near and far; return the table of what each skipped, headed."""
    rows: list[tuple[str, ...]] = [
        ("picture", "in the source", "in the cut", "drawn", "covered pixels", "frame")
    ]
    shown = arguments.pixel_error
    views = {
        "whole": (1.0, shown),
        "near": (0.5, shown),
        "far": (8.0, shown),
        "whole, full detail": (1.0, 0.0),
    }
    with nrs.Renderer(*arguments.size, backend=arguments.backend) as renderer:
        for label, (distance, pixel_error) in views.items():
            for _ in range(2):  # the first frame allocates; the second is timed
                frame = picture(
                    renderer, mesh, **_view(arguments), distance=distance, pixel_error=pixel_error
                )
            rows.append(_numbers(label, frame.stats))
            if label in PICTURES:
                for view in PICTURE_VIEWS:
                    path = f"{stem}_{label}_{view}.png"
                    if view == "levels":
                        _images.write_png(path, _with_legend(frame, mesh), frame._texts())
                    else:
                        frame.save(path, view=view)
            if label == "whole":
                Path(f"{stem}_stages.txt").write_text(f"{frame.stats}\n", encoding="utf-8")
        in_the_sun = _in_the_sun(mesh, arguments)
        for _ in range(2):  # the first frame draws the pages that the second looks up
            frame = renderer.render(*in_the_sun, pixel_error=arguments.pixel_error, shadows=True)
        frame.save(f"{stem}_shadows.png")
        rows.append(_numbers("on a floor, shadows", frame.stats))
    return rows


def _numbers(label: str, stats: nrs.FrameStats) -> tuple[str, ...]:
    """What a picture shows and skipped, as a row of the demo's table."""
    drawn = stats.drawn_small + stats.drawn_large
    numbers = (stats.source_triangles, stats.triangles, drawn, stats.covered_pixels)
    return (label, *(f"{n:,}" for n in numbers), f"{stats.total_ms:.1f} ms")


def _in_the_sun(
    mesh: nrs.NaniteMesh, arguments: argparse.Namespace
) -> tuple[nrs.Scene, nrs.Camera, NDArray[np.float64]]:
    """The mesh on a floor, under a sun: scene, camera and pose."""
    axes = UP[arguments.up]
    low, high = mesh.bounds @ axes
    low, high = np.minimum(low, high), np.maximum(low, high)
    middle, radius = 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low))
    square = np.array([[-1, 0, 1], [1, 0, 1], [1, 0, -1], [-1, 0, -1]], np.float64)
    floor = square * 20.0 * radius + [middle[0], low[1], middle[2]]
    scene = nrs.Scene(ambient_light=(0.12, 0.12, 0.14), bg_color=BACKGROUND)
    scene.add(mesh, material=replace(CLAY, smooth=not arguments.face_normals, double_sided=True))
    scene.add(nrs.NaniteMesh.from_arrays(floor @ axes.T, [[0, 1, 2], [0, 2, 3]]), material=CLAY)
    turn = np.radians(arguments.azimuth)

    def placed(around: float, above: float, away: float) -> NDArray[np.float64]:
        direction = np.array([np.cos(above) * np.sin(around), np.sin(above), np.cos(above) * np.cos(around)])
        return nrs.look_at(axes @ (middle + away * direction), axes @ middle, up=axes[:, 1])

    sun = nrs.DirectionalLight(intensity=3.0, angle=np.radians(SUN_DEGREES))
    scene.add(sun, pose=placed(turn + 1.2, 0.7, radius))
    away = 1.25 * radius / np.sin(0.5 * np.radians(arguments.yfov))
    camera = nrs.PerspectiveCamera(yfov=np.radians(arguments.yfov), znear=1e-3 * away)
    return scene, camera, placed(turn, np.radians(max(arguments.elevation, 5.0)), away)


def _with_legend(frame: nrs.Frame, mesh: nrs.NaniteMesh) -> NDArray[np.uint8]:
    """The picture of levels, with the name and colour of each that it shows."""
    shown = frame.view("levels")
    table = _core.cluster_table(mesh._core)
    rows = np.searchsorted(table["id"], np.unique(frame.cluster_id[frame.depth > 0.0]))
    levels = np.unique(table["level"][rows])
    colors = np.rint(_paint.levels(levels) * 255.0).astype(np.uint8)
    names = [f"level {level}{' (source)' if level == 0 else ''}" for level in levels]
    _overlay.legend(shown, names, colors)
    return shown


def _demo_mesh(name: str, arguments: argparse.Namespace, step: Callable[..., Any]) -> nrs.NaniteMesh:
    """Load or generate, then build, as steps of the demo."""
    if _is_built(name):
        opened: nrs.NaniteMesh = step("open", lambda: nrs.NaniteMesh.open(name), str)
        return opened
    if name.startswith(SHAPE_PREFIX):
        arrays = step(
            "generate",
            lambda: dict(zip(("vertices", "faces"), _generated(name), strict=True)),
            lambda a: f"{name.split(':')[1]}, {len(a['faces']):,} triangles",
        )
    else:
        arrays = step(
            "load",
            lambda: io.from_file(name).arrays(),
            lambda a: f"{name}, {len(a['faces']):,} triangles",
        )
    built: nrs.NaniteMesh = step(
        "build",
        lambda: nrs.NaniteMesh.from_arrays(
            **arrays, options=_options(arguments), progress=False if arguments.quiet else None
        ),
        lambda m: str(m).removeprefix("NaniteMesh(").removesuffix(")"),
    )
    return built


# ------------------------------------------------------------------------------------------------- arguments


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.lower().replace("×", "x").partition("x")
    if not (width.isdigit() and height.isdigit() and int(width) and int(height)):
        raise argparse.ArgumentTypeError(f"expected WIDTHxHEIGHT such as 1280x720, not {text!r}")
    return int(width), int(height)


INPUT_HELP: Final = ".nanite file, mesh file, or shape:NAME:FACES"


def _formatter(prog: str) -> argparse.HelpFormatter:
    return argparse.RawDescriptionHelpFormatter(prog, max_help_position=34, width=100)


def _command(
    commands: Any, name: str, run: Callable[[argparse.Namespace], int], text: str, example: str
) -> Any:
    sub = commands.add_parser(
        name, help=text, description=text, epilog=f"example:\n  {example}", formatter_class=_formatter
    )
    sub.set_defaults(run=run)
    sub.add_argument("--quiet", "-q", action="store_true", help="no progress, no summary")
    return sub


def _add_building(sub: Any) -> None:
    group = sub.add_argument_group("building, where INPUT is not built yet")
    group.add_argument("--cluster-triangles", type=int, metavar="N", help="most triangles of a cluster (128)")
    group.add_argument("--group-clusters", type=int, metavar="N", help="clusters simplified together (16)")
    group.add_argument("--quality", choices=("fast", "best"), help="fast: less time for more error (best)")
    group.add_argument(
        "--error-measure",
        dest="error_measure",
        choices=("quadric", "bound"),
        help="how stated errors are found: bound proves them, quadric is faster (bound)",
    )
    group.add_argument(
        "--preserve-area",
        action="store_const",
        const=True,
        help="foliage and hair go on covering as much as they do",
    )
    group.add_argument("--threads", type=int, metavar="N", help="threads; the result is the same (all cores)")


def _add_viewing(sub: Any) -> None:
    group = sub.add_argument_group("view")
    group.add_argument("--size", type=_size, default=(1280, 720), metavar="WxH", help="pixels (1280x720)")
    group.add_argument(
        "--pixel-error", type=float, default=1.0, metavar="PX", help="largest error; 0 is full detail (1)"
    )
    group.add_argument("--yfov", type=float, default=45.0, metavar="DEG", help="vertical field of view (45)")
    group.add_argument("--azimuth", type=float, default=30.0, metavar="DEG", help="around the Y axis (30)")
    group.add_argument("--elevation", type=float, default=20.0, metavar="DEG", help="above the horizon (20)")
    group.add_argument("--up", default="y", choices=sorted(UP), help="which axis of the mesh points up (y)")
    group.add_argument(
        "--face-normals", action="store_true", help="shade each face by its own normal, not by vertex normals"
    )
    # What that was called at first. shading="flat" is something else: no light.
    group.add_argument("--flat", dest="face_normals", action="store_true", help=argparse.SUPPRESS)
    names = get_args(ShadowsName)
    how = f"lights cast shadows, {' or '.join(names)} (virtual)"
    group.add_argument(_SHADOWS, nargs="?", default=False, const=True, choices=names, help=how)
    group.add_argument("--backend", default="auto", choices=("auto", "cpu", "gpu"), help="(auto)")


def _add_build(commands: Any) -> None:
    text = "Build meshes and write them as .nanite files."
    sub = _command(commands, "build", _build, text, "nanite-rs build dragon.ply -o dragon.nanite")
    sub.add_argument(
        "inputs",
        metavar="INPUT",
        nargs="+",
        help="mesh file, folder of tiles that are one mesh, or shape:NAME:FACES; of several files each is built "
        "by itself",
    )
    sub.add_argument(
        "--output",
        "-o",
        metavar="FILE",
        help="the .nanite file, its URL, or a folder (INPUT's name, in this folder)",
    )
    sub.add_argument("--check", action="store_true", help="verify every invariant")
    sub.add_argument(
        "--memory",
        metavar="SIZE",
        help="bytes that building may take, such as 4GiB: what is larger is built on disk",
    )
    sub.add_argument("--resume", action="store_true", help="with --memory: go on where a build was stopped")
    sub.add_argument(
        "--work",
        metavar="FOLDER",
        help="with --memory: where the work folder is made, a folder or a URL such as s3://bucket/work",
    )
    sub.add_argument(
        "--skip-existing",
        action="store_true",
        help="of several inputs: leave files that are there as they are",
    )
    sub.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="build on the workers of a Dask cluster, which share the folders or --work, such as tcp://host:8786",
    )
    _add_building(sub)


def _add_info(commands: Any) -> None:
    text = "Say what is in a mesh and what building did."
    sub = _command(commands, "info", _info, text, "nanite-rs info dragon.nanite --check")
    sub.add_argument("input", metavar="INPUT", help=INPUT_HELP)
    sub.add_argument("--json", action="store_true", help="print JSON")
    sub.add_argument("--check", action="store_true", help="verify every invariant")
    _add_building(sub)


def _add_cut(commands: Any) -> None:
    text = "Cut a mesh for an error or a number of triangles, or for levels of detail, and write it."
    sub = _command(
        commands, "cut", _cut, text, "nanite-rs cut dragon.nanite -o small.ply --target-reduction 0.99"
    )
    sub.add_argument("input", metavar="INPUT", help=INPUT_HELP)
    sub.add_argument("--output", "-o", required=True, metavar="FILE", help="PLY, OBJ, STL, GLB, OFF, …")
    selector = sub.add_mutually_exclusive_group(required=True)
    selector.add_argument("--error", type=float, metavar="E", help="largest error, in units of the mesh")
    selector.add_argument("--target-faces", type=int, metavar="N", help="triangles to keep")
    selector.add_argument("--target-reduction", type=float, metavar="R", help="fraction to remove, 0 to 1")
    selector.add_argument(
        "--levels",
        type=float,
        nargs="+",
        metavar="PART",
        help="parts of the faces of several levels: 1 0.2 0.04",
    )
    selector.add_argument("--errors", type=float, nargs="+", metavar="E", help="errors of several levels")
    sub.add_argument(
        "--separate", action="store_true", help="a file for each level, not one of glTF with all"
    )
    sub.add_argument(
        "--whole-groups", action="store_true", help="stay below a number of triangles rather than meet it"
    )
    _add_building(sub)


def _add_tiles(commands: Any) -> None:
    text = "Write a mesh as 3D Tiles, which web viewers stream; geometricError is a proven bound."
    sub = _command(commands, "tiles", _tiles, text, "nanite-rs tiles scan.nanite -o tiles --crs EPSG:32632")
    sub.add_argument("input", metavar="INPUT", help=INPUT_HELP)
    sub.add_argument("--output", "-o", metavar="FOLDER", help="folder or URL (INPUT's name and _tiles)")
    sub.add_argument("--triangles", type=int, default=30_000, metavar="N", help="of a tile, about (30000)")
    names = [*get_args(Compression), "none"]
    sub.add_argument("--compression", choices=names, default="meshopt", help="of contents (meshopt)")
    sub.add_argument(
        "--images", choices=get_args(ImageFormat), help="what images are encoded as (as they were)"
    )
    sub.add_argument("--no-skirts", action="store_true", help="no strips along the planes between tiles")
    sub.add_argument(
        "--pixel-error", type=float, default=16.0, metavar="P", help="that viewers allow: for images (16)"
    )
    sub.add_argument(
        "--up", choices=("y", "z"), help="the axis of the mesh that points up (y of glTF, else z)"
    )
    sub.add_argument("--crs", metavar="NAME", help="coordinate reference system of the mesh: EPSG:32632")
    sub.add_argument("--preview", action="store_true", help="write a page, too, that shows the tiles")
    sub.add_argument("--overwrite", action="store_true", help="replace a tileset that is there")
    _add_building(sub)


def _add_foliage(commands: Any) -> None:
    text = (
        "Replace leaves that are holes in images by triangles, and build the trees with their area preserved."
    )
    example = "nanite-rs foliage tree.obj -o tree.nanite --texture Leaves=leaves.png --preview pictures"
    sub = _command(commands, "foliage", _foliage, text, example)
    sub.add_argument(
        "inputs", metavar="INPUT", nargs="+", help="mesh file with materials, or folder of such files"
    )
    sub.add_argument("--output", "-o", metavar="FILE", help="the .nanite file, or a folder (INPUT's name)")
    sub.add_argument(
        "--config", metavar="FILE", help="TOML of the settings below, also by files (docs/nature.md)"
    )
    sub.add_argument("--preview", metavar="FOLDER", help="write pictures of cards, geometry and outlines")
    group = sub.add_argument_group("leaves")
    group.add_argument(
        "--leaf-material",
        dest="leaf_materials",
        action="append",
        metavar="NAME",
        help="a material of leaves; may be given again (those with holes in their images)",
    )
    group.add_argument("--cutoff", type=float, metavar="A", help="alpha below it is a hole (the material's)")
    group.add_argument("--tolerance", type=float, metavar="T", help="of outlines, in texels (0.5)")
    group.add_argument(
        "--triangles-per-leaf", type=float, metavar="N", help="most for a part of an image, in the mean"
    )
    group.add_argument(
        "--texture",
        dest="textures",
        action="append",
        metavar="MATERIAL=FILE",
        help="an image with alpha for a material without; may be given again",
    )
    group.add_argument("--wind", action="store_true", help="add channels that an animation needs")
    group.add_argument("--up", choices=("x", "y", "z"), help="the axis that points up (y)")
    _add_building(sub)


def _add_imposter(commands: Any) -> None:
    text = "Bake pictures of a mesh from a grid of directions: PNG files, and JSON that says what they mean."
    sub = _command(commands, "imposter", _imposter, text, "nanite-rs imposter tree.glb -o tree --half")
    sub.add_argument("input", metavar="INPUT", help=INPUT_HELP)
    sub.add_argument("--output", "-o", metavar="FOLDER", help="folder (INPUT's name and _imposter)")
    sub.add_argument("--views", type=int, default=12, metavar="N", help="along each side of the grid (12)")
    sub.add_argument("--size", type=int, default=128, metavar="N", help="texels of a side of a view (128)")
    sub.add_argument("--half", action="store_true", help="from above the horizon alone")
    sub.add_argument("--up", choices=("y", "z"), default="y", help="the axis that points up (y)")
    sub.add_argument("--backend", default="cpu", choices=("auto", "cpu", "gpu"), help="what draws (cpu)")
    _add_building(sub)


def _add_displace(commands: Any) -> None:
    text = "Put a height map on a mesh, within a tolerance of the exact surface, and build what comes of it."
    example = "nanite-rs displace wall.glb bricks.png -o wall.nanite --scale 0.05 --tolerance 0.001"
    sub = _command(commands, "displace", _displace, text, example)
    sub.add_argument("input", metavar="INPUT", help="mesh file with texture coordinates")
    sub.add_argument("height", metavar="HEIGHT", help="picture: grey of heights, or RGB of vectors")
    sub.add_argument("--output", "-o", metavar="FILE", help="(INPUT's name and .nanite)")
    sub.add_argument("--tolerance", type=float, required=True, metavar="E", help="in units of the mesh")
    sub.add_argument("--scale", type=float, default=1.0, metavar="S", help="times the heights (1)")
    sub.add_argument("--midlevel", type=float, default=0.0, metavar="M", help="height that stays (0)")
    names = get_args(Wrap)
    sub.add_argument("--wrap", choices=names, default="repeat", help="beyond the map (repeat)")
    sub.add_argument("--max-triangles", type=int, default=20_000_000, metavar="N", help="at most (20000000)")
    _add_building(sub)


def _add_terrain(commands: Any) -> None:
    text = "Build terrain from heights (.npy, .hgt, a grey picture), within a tolerance of all posts."
    example = "nanite-rs terrain N43E006.hgt -o coast.nanite --spacing 66 92 --tolerance 5 --nodata -32768"
    sub = _command(commands, "terrain", _terrain, text, example)
    sub.add_argument("input", metavar="INPUT", help="rows of heights from the north")
    sub.add_argument("--output", "-o", metavar="FILE", help="(INPUT's name and .nanite)")
    sub.add_argument("--tolerance", type=float, required=True, metavar="E", help="vertical, as the heights")
    sub.add_argument(
        "--spacing", type=float, nargs="+", default=[1.0], metavar="D", help="between columns, and rows (1)"
    )
    sub.add_argument("--nodata", type=float, metavar="H", help="what stands for no height")
    sub.add_argument(
        "--memory", metavar="SIZE", help="bytes that building may take, such as 4GiB: the rest is on disk"
    )
    _add_building(sub)


def _add_render(commands: Any) -> None:
    text = "Render a mesh into a PNG, or its linear colour, depth, normals and ids into an EXR."
    example = "nanite-rs render dragon.nanite -o levels.png --view levels --azimuth 200"
    sub = _command(commands, "render", _render, text, example)
    sub.add_argument("input", metavar="INPUT", help=INPUT_HELP)
    sub.add_argument("--output", "-o", default="render.png", metavar="FILE", help=".png or .exr (render.png)")
    sub.add_argument("--view", choices=VIEWS, help="what a PNG shows (shaded)")
    sub.add_argument(
        "--stats", action="store_true", help="print what each stage received, passed on and took"
    )
    _add_materials(sub)
    sub.add_argument(
        "--time",
        type=float,
        metavar="SECONDS",
        help="show a scene (glTF) as an animation has it then, with its materials",
    )
    sub.add_argument(
        "--animation", default="0", metavar="NAME", help="the name or the number of the animation (0)"
    )
    sub.add_argument(
        "--samples", type=int, default=1, choices=(1, 4, 16), help="of each pixel, against jagged edges (1)"
    )
    _add_viewing(sub)
    sub.add_argument(
        "--distance", type=float, default=1.0, metavar="D", help="camera distance; 1 fills the picture (1)"
    )
    _add_building(sub)


def _add_materials(sub: Any) -> None:
    sub.add_argument(
        "--materials",
        action="store_true",
        help="show a scene (glTF, OBJ …) with its materials and textures, shaded as glTF defines it",
    )


def _add_view(commands: Any) -> None:
    text = (
        "Look around in a window: turn, move, zoom, change the error, freeze the cut, ask what a pixel shows."
    )
    sub = _command(commands, "view", _look, text, "nanite-rs view dragon.nanite --view clusters")
    sub.add_argument("input", metavar="INPUT", help=INPUT_HELP)
    sub.add_argument(
        "--view",
        choices=(*nrs.viewer.VIEWS, *nrs.viewer.SHADOW_VIEWS),
        help="what is shown at first (shaded)",
    )
    sub.add_argument("--canvas", choices=("glfw", "qt", "wx"), default="glfw", help="what opens it (glfw)")
    _add_materials(sub)
    _add_viewing(sub)
    _add_building(sub)


def _add_demo(commands: Any) -> None:
    text = "Build, save, open, cut and render a mesh; print what was skipped and how long it took."
    sub = _command(commands, "demo", _demo, text, "nanite-rs demo dragon.ply --output dragon_demo")
    sub.add_argument(
        "input", metavar="INPUT", nargs="?", default=DEMO_SHAPE, help=f"see `nanite-rs --help` ({DEMO_SHAPE})"
    )
    sub.add_argument("--output", "-o", default="demo_output", metavar="FOLDER", help="(demo_output)")
    _add_viewing(sub)
    _add_building(sub)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="nanite-rs",
        description="Virtualized geometry: build a mesh into a cluster LOD DAG, cut it, render it.",
        epilog=EPILOG.format(shapes=", ".join(shapes.SHAPES)),
        formatter_class=_formatter,
    )
    parser.add_argument("--version", action="version", version=f"nanite-rs {nrs.__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    adds = (
        *(_add_build, _add_displace, _add_terrain, _add_info, _add_cut, _add_tiles),
        *(_add_foliage, _add_imposter, _add_render, _add_view, _add_demo),
    )
    for add in adds:
        add(commands)
    return parser


def _one_line(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return " ".join(str(error).split())


def _say(message: Warning | str, *_: object, **__: object) -> None:
    """Print a warning as the shell's users read it: there is no line of theirs that it comes from."""
    print(f"nanite-rs: warning: {' '.join(str(message).split())}", file=sys.stderr)


def _given(argv: Sequence[str]) -> list[str]:
    """Arguments, where a file that follows ``--shadows`` is not taken for a name of them."""
    out = list(argv)
    for place, (name, following) in enumerate(itertools.pairwise([*argv, ""])):
        if name == _SHADOWS and following not in get_args(ShadowsName):
            out[place] = f"{_SHADOWS}=virtual"
    return out


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments; those of the process by default.

    Returns
    -------
    int
        0; 1 when something failed, in one line on stderr; 2 for wrong usage; 130 after Ctrl-C.
    """
    try:
        arguments = _parser().parse_args(_given(sys.argv[1:] if argv is None else argv))
    except SystemExit as stop:  # argparse has printed usage, help or version
        return int(stop.code or 0)
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _say
            code: int = arguments.run(arguments)
        sys.stdout.flush()
    except BrokenPipeError:  # such as `nanite-rs info x | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (NaniteError, OSError) as error:
        print(f"nanite-rs: {_one_line(error)}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("nanite-rs: interrupted", file=sys.stderr)
        return 130
    return code
