"""Results as Markdown: what is kept in ``benchmarks/results``."""

from __future__ import annotations

import datetime
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

TITLES = {
    "build": "Building a displaced icosphere, against fast-simplification",
    "cut": "A cut against fast-simplification (deviation in 1e-4 of the diagonal)",
    "decimate": "One level at once, against fast-simplification (deviation in 1e-4 of the diagonal)",
    "distance": "Distances of points to a mesh, and between meshes",
    "files": "One surface as a file, and by the codecs of glTF",
    "frames": "A frame of a displaced icosphere over 22.9 % of 1280×720, ms, against pyrender on OSMesa",
    "gpu": "Crowds at equal coverage on a device of wgpu, its CPU twin, pyrender on OSMesa, Embree",
    "memory": "Memory of a build beyond the arrays given, and its time, against fast-simplification",
    "instances": "Instances of one mesh at equal coverage, 1280×720, against pyrender on OSMesa",
}


def today() -> str:
    """The day, as results are named after it."""
    return datetime.datetime.now(datetime.timezone.utc).date().isoformat()


def publish(lines: list[str], folder: Path, name: str, *, quick: bool = False) -> None:
    """Write a page of results, named after the day and what was measured, and print it."""
    text = "\n".join(lines)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{today()}-{name}{'-quick' if quick else ''}.md").write_text(text)
    print(text)


def document(results: dict) -> str:
    """The whole report."""
    machine = results["machine"]
    versions = ", ".join(f"{name} {version}" for name, version in machine["packages"].items() if version)
    head = [
        f"# Python benchmarks, {results['date']}" + (" (quick: not to quote)" if results["quick"] else ""),
        "",
        f"{machine['processor']}, {machine['cores']} cores, {machine['memory_gib']} GiB, {machine['system']},"
        f" Python {machine['python']}; {versions}. Medians of interleaved runs."
        f" Load of the machine before the first run: {machine['load']}.",
        "",
    ]
    return "\n".join(head) + "\n".join(section(name, results[name]) for name in TITLES if name in results)


def section(name: str, result: dict) -> str:
    """One benchmark: its title, its table and its single figures."""
    rows = [{k: v for k, v in row.items() if not isinstance(v, dict)} for row in result["rows"]]
    lines = [f"## {TITLES[name]}", "", table(rows).rstrip()]
    singles = {k: v for k, v in result.items() if k != "rows" and not isinstance(v, dict)}
    if singles:
        lines += ["", "; ".join(f"{k}: {cell(v)}" for k, v in singles.items()) + "."]
    for key, entries in result.items():
        if isinstance(entries, dict) and entries:
            lines += ["", f"{key}:", "", *(f"- {k}: {cell(v)}" for k, v in entries.items())]
    return "\n".join(lines) + "\n"


def table(rows: list[dict]) -> str:
    """A table with a column for each key."""
    columns = list(rows[0])
    lines = ["| " + " | ".join(columns) + " |", "|" + "---|" * len(columns)]
    lines += ["| " + " | ".join(cell(row[c]) for c in columns) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def cell(value: object) -> str:
    """A value as tables have it: three digits, or thousands with commas."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return str(value)
    if isinstance(value, int):
        return f"{value:,}"
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"
