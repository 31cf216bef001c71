"""`nanite-rs foliage`: one tree, or folders of them with one file of settings."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from nanite_rs import _text, foliage, io
from nanite_rs._foliage.settings import NAMES, Settings
from nanite_rs.exceptions import ArgumentError, NaniteError

if TYPE_CHECKING:
    import argparse

    from nanite_rs.options import BuildOptions

# What trees come as; a folder may hold anything else, too.
_ENDINGS: Final = (*io.READERS, "dae", "3mf")


def run(arguments: argparse.Namespace, options: BuildOptions) -> int:
    """Convert and build all inputs; one that fails does not stop the others."""
    settings = None if arguments.config is None else Settings(arguments.config)
    files = [file for name in arguments.inputs for file in _files(Path(name))]
    output = arguments.output
    several = len(files) > 1 or os.path.isdir(arguments.inputs[0]) or (output or "").endswith(("/", os.sep))
    several = several or (output is not None and os.path.isdir(output))
    if several and output is not None and output.endswith(io.NANITE_SUFFIX):
        raise ArgumentError(f"{output}: several trees are built into a folder")
    if not several and output is not None and not output.endswith(io.NANITE_SUFFIX):
        raise ArgumentError(f"{output}: the output must end in {io.NANITE_SUFFIX}")
    failed, taken = 0, set[Path]()
    for file in files:
        own = f"{io.stem(str(file))}{io.NANITE_SUFFIX}"
        path = Path(output or ".") / own if several else Path(output or own)
        try:
            if path in taken:
                raise ArgumentError(f"{path}: two trees would be written to it; build them into two folders")
            taken.add(path)
            _one(
                file,
                path,
                {**(settings.of(file) if settings else {}), **_given(arguments)},
                arguments,
                options,
            )
        except (NaniteError, OSError) as error:
            if not several:
                raise
            failed += 1
            print(f"nanite-rs: {file}: failed: {' '.join(str(error).split())}", file=sys.stderr)
    return 1 if failed else 0


def _one(
    file: Path, path: Path, how: dict[str, Any], arguments: argparse.Namespace, options: BuildOptions
) -> None:
    start = time.perf_counter()
    tree = foliage.to_geometry(str(file), **how)
    if arguments.preview is not None:
        folder = Path(arguments.preview)
        tree.save_previews(folder / io.stem(str(file)) if len(arguments.inputs) > 1 else folder)
    mesh = tree.build(options=options, progress=False if arguments.quiet else None)
    path.parent.mkdir(parents=True, exist_ok=True)
    mesh.save(path)
    if not arguments.quiet:
        print(tree.report)
        size = _text.megabytes(path.stat().st_size)
        print(f"{path}: {mesh}, {size} on disk, {_text.seconds(time.perf_counter() - start)}")


def _files(given: Path) -> list[Path]:
    """Return the trees of a folder, in the order of their names, or the one file."""
    if not given.is_dir():
        return [given]
    found = sorted(path for path in given.rglob("*") if path.is_file() and io.ending(path)[0] in _ENDINGS)
    if not found:
        raise ArgumentError(f"{given}: there is no mesh in it ({', '.join(_ENDINGS)})")
    return found


def _given(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return what the command line says of trees; it counts more than files of settings."""
    out = {name: value for name in NAMES if (value := getattr(arguments, name)) not in (None, False)}
    if "textures" in out:
        pairs = [text.partition("=") for text in out["textures"]]
        for text, (name, equals, file) in zip(out["textures"], pairs, strict=True):
            if not (name and equals and file):
                raise ArgumentError(f"--texture: expected MATERIAL=FILE, not {text!r}")
        out["textures"] = {name: file for name, _, file in pairs}
    return out
