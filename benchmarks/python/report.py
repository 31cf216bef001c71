"""The page of a run: every benchmark as a plot, and its figures beside those of the peer.

``python -m benchmarks.python.report --fast`` measures on small meshes in less than half a minute, to see that all
of it works; ``python -m benchmarks.python`` writes the page of a whole run; and given a JSON file of results, the
page is made of that. It lies in ``target/report/``: index.html, report.md, pictures, and results.json.
"""

from __future__ import annotations

import argparse
import datetime
import html
import json
import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from matplotlib.figure import Figure as Plot
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from . import build, cut, decimate, distance, files, frames, gpu, instances, machine, memory, tables
from .tables import TITLES, cell

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.axes import Axes

BENCHMARKS = {
    "build": build,
    "cut": cut,
    "decimate": decimate,
    "distance": distance,
    "files": files,
    "frames": frames,
    "gpu": gpu,
    "instances": instances,
    "memory": memory,
}
#: What runs unless asked otherwise: all but what needs a device.
DEFAULT = tuple(name for name in BENCHMARKS if name != "gpu")
#: Peers whose versions a page has, besides those that every result has.
PEER_PACKAGES = ("DracoPy", "embreex", "meshoptimizer", "zstandard")
REPORT = Path(__file__).resolve().parents[2] / "target" / "report"

OURS, OURS_TOO, OURS_THREE = "#1f5fa8", "#6b9bd1", "#a9c6e8"
PEERS = ("#c8642b", "#e0a063", "#8a8a8a", "#bdbdbd", "#6d5a8c", "#a397bd")


class Figure(NamedTuple):
    """One figure of ours beside that of a peer, measured in the same run; less is better for both."""

    what: str
    unit: str
    ours: float
    peer: str
    theirs: float

    @property
    def ratio(self) -> float:
        """How many times ours the peer's is."""
        return self.theirs / self.ours


class Section(NamedTuple):
    """What a page says about one benchmark."""

    name: str
    text: str
    figures: list[Figure]
    draw: Callable[[Plot], None]
    #: Of the picture, inches.
    size: tuple[float, float] = (9.0, 3.4)


def measure(names: tuple[str, ...] = DEFAULT, *, fast: bool) -> dict[str, object]:
    """Run benchmarks one after the other; JSON-ready."""
    results: dict[str, object] = {
        "date": datetime.datetime.now(datetime.timezone.utc).date().isoformat(),
        "quick": fast,
        "machine": machine.describe(PEER_PACKAGES),
    }
    for name in names:
        start = time.perf_counter()
        results[name] = BENCHMARKS[name].run(quick=fast)
        print(
            f"{tables.section(name, results[name])}\nTook {time.perf_counter() - start:.1f} s.\n", flush=True
        )
    return results


# ------------------------------------------------------------------------------------------------ sections


def sections(results: dict) -> list[Section]:
    """One for each benchmark that is in the results."""
    return [SECTIONS[name](results[name]) for name in SECTIONS if name in results]


def _build(result: dict) -> Section:
    rows = {row["method"]: row for row in result["rows"]}
    two, estimated = list(build.OURS)[1:]
    figures = [
        Figure("proven errors, two threads", "s", rows[two]["s"], build.PEER, rows[build.PEER]["s"]),
        Figure("estimated errors, two threads", "s", rows[estimated]["s"], build.PEER, rows[build.PEER]["s"]),
    ]
    text = (
        "All levels of one mesh. The peer's are whole meshes of one detail each, by one thread, without stated "
        "errors; those of nanite_rs can be mixed without cracks."
    )
    if result["criterion"]:
        found = ", ".join(f"{name} {cell(s)} s" for name, s in result["criterion"].items())
        text += f" Criterion's latest medians, beside meshoptimizer's clod_build on the same arrays: {found}."

    def draw(plot: Plot) -> None:
        colors = (OURS, OURS_TOO, OURS_THREE, PEERS[0])
        _bars(plot.subplots(), {m: r["s"] for m, r in rows.items()}, "s", colors)

    return Section("build", text, figures, draw, (9.0, 2.4))


def _cut(result: dict) -> Section:
    rows = result["rows"]
    methods = list(dict.fromkeys(row["method"] for row in rows))
    shares = list(dict.fromkeys(row["removed"] for row in rows))
    by = {(row["method"], row["removed"]): row for row in rows}
    ours, given, best, _ = methods
    figures = [
        Figure(f"{share:.0%} removed", "ms", by[ours, share]["ms"], given, by[given, share]["ms"])
        for share in shares
    ] + [
        Figure(
            f"rms distance, {share:.0%} removed",
            "1e-4 of the diagonal",
            by[ours, share]["rms"],
            best,
            by[best, share]["rms"],
        )
        for share in shares
    ]

    def draw(plot: Plot) -> None:
        left, right = plot.subplots(1, 2)
        for axes, key, label in ((left, "ms", "ms"), (right, "rms", "rms, 1e-4 of the diagonal")):
            for method, color in zip(methods, (OURS, *PEERS), strict=False):
                values = [by[method, share][key] for share in shares]
                axes.plot([f"{share:.0%}" for share in shares], values, "o-", color=color, label=method)
            axes.set(yscale="log", xlabel="triangles removed", ylabel=label)
        left.legend(fontsize=8)

    text = (
        f"Cuts of a mesh of {result['source triangles']:,} triangles that is built already, to the NumPy arrays; "
        "fast-simplification starts from arrays, as given and scaled to a diagonal of 100, where it is most exact."
    )
    return Section("cut", text, figures, draw)


def _decimate(result: dict) -> Section:
    rows = {row["method"]: row for row in result["rows"]}
    figures = [
        Figure(f"{ours.rpartition(', ')[2]}, {what}", unit, rows[ours][key], peer, rows[peer][key])
        for ours in decimate.OURS
        for peer in (decimate.GIVEN, decimate.SCALED)
        for what, unit, key in (("time", "s", "s"), ("rms distance", "1e-4 of the diagonal", "rms"))
    ]

    def draw(plot: Plot) -> None:
        left, right = plot.subplots(1, 2, sharey=True)
        colors = (OURS, OURS_TOO, *PEERS)
        _bars(left, {method: row["s"] for method, row in rows.items()}, "s", colors)
        _bars(
            right, {method: row["rms"] for method, row in rows.items()}, "rms, 1e-4 of the diagonal", colors
        )

    text = (
        f"{result['source triangles']:,} triangles to a tenth, from arrays to arrays, on all cores; "
        "fast-simplification has one, and is most exact scaled to a diagonal of 100."
    )
    return Section("decimate", text, figures, draw, (9.0, 2.8))


def _distance(result: dict) -> Section:
    rows = [row for row in result["rows"] if row["points"]]
    sizes = list(dict.fromkeys(row["triangles"] for row in rows))
    methods = list(dict.fromkeys(row["method"] for row in rows))
    by = {(row["method"], row["triangles"]): row["µs per point"] for row in rows}
    figures = [
        Figure(f"{size:,} triangles", "µs per point", by[methods[0], size], peer, by[peer, size])
        for size in sizes
        for peer in methods[1:]
    ]

    def draw(plot: Plot) -> None:
        axes = plot.subplots()
        lines = {method: [by[method, size] for size in sizes] for method in methods}
        _lines(axes, sizes, lines, (OURS, *PEERS))
        axes.set(xlabel="triangles", ylabel="µs per point")

    text = "Nearest points on a mesh, processor time of all threads, building the tree included."
    return Section("distance", text, figures, draw)


def _files(result: dict) -> Section:
    rows = result["rows"]
    mesh = rows[-1]["mesh"]
    by = {row["method"]: row for row in rows if row["mesh"] == mesh}
    ours = by[files.OURS]
    peers = {m: r for m, r in by.items() if r["decoding ms"] and m != files.OURS}
    figures = [
        Figure("bytes per stored triangle", "B", ours["B/stored triangle"], m, r["B/stored triangle"])
        for m, r in peers.items()
    ] + [
        Figure(
            "decoding a stored triangle",
            "ns",
            1e3 / ours["M stored triangles/s"],
            m,
            1e3 / r["M stored triangles/s"],
        )
        for m, r in peers.items()
    ]

    def draw(plot: Plot) -> None:
        left, right = plot.subplots(1, 2, sharey=True)
        shown = {files.OURS: ours, **peers}
        colors = (OURS, *[PEERS[0]] * len(peers))
        _bars(
            left, {m: r["B/stored triangle"] for m, r in shown.items()}, "bytes per stored triangle", colors
        )
        _bars(
            right,
            {m: 1e3 / r["M stored triangles/s"] for m, r in shown.items()},
            "ns to decode a stored triangle",
            colors,
        )

    text = (
        f"{mesh}: {ours['triangles']:,} triangles on the same grid. The file holds all levels, some two triangles "
        "for each of the source, with hierarchy, errors and checksums; the codecs hold the source alone."
    )
    return Section("files", text, figures, draw, (9.0, 3.6))


def _frames(result: dict) -> Section:
    rows = result["rows"]
    figures = [
        Figure(f"{row['triangles']:,} triangles", "ms", row["nanite_rs ms"], "pyrender", row["pyrender ms"])
        for row in rows
    ]

    def draw(plot: Plot) -> None:
        axes = plot.subplots()
        lines = {
            "nanite_rs, one pixel of error": [row["nanite_rs ms"] for row in rows],
            "nanite_rs, full detail": [row["full detail ms"] for row in rows],
            "pyrender on OSMesa": [row["pyrender ms"] for row in rows],
        }
        _lines(axes, [row["triangles"] for row in rows], lines, (OURS, OURS_TOO, PEERS[0]))
        axes.set(xlabel="triangles", ylabel="ms per frame")

    driver = result.get("pyrender's driver", "")
    text = (
        f"{result['width']}×{result['height']}, CPU backend, colour and depth read as arrays, a moving camera. "
        f"pyrender draws with {driver or 'OSMesa'}."
    )
    return Section("frames", text, figures, draw)


def _gpu(result: dict) -> Section:
    rows = result["rows"]
    figures = []
    for row in rows:
        scene = f"{row['triangles']:,} triangles, {row['size']}"
        figures.append(Figure(scene, "ms", row["gpu ms"], "the CPU backend", row["cpu ms"]))
    few, beside = gpu.FEW * rows[0]["triangles"], result["beside others"]
    scene = f"{few:,} triangles, {rows[0]['size']}"
    figures += [
        Figure(scene, "ms", beside["gpu ms"], peer, beside[f"{peer} ms"])
        for peer in ("pyrender", "Embree's rays")
    ]

    def draw(plot: Plot) -> None:
        axes = plot.subplots()
        for size, style in zip(dict.fromkeys(row["size"] for row in rows), ("o-", "s--", "^:"), strict=False):
            of = [row for row in rows if row["size"] == size]
            for key, color in (("gpu ms", OURS), ("cpu ms", PEERS[0])):
                label = f"{key.removesuffix(' ms')}, {size}"
                axes.plot([r["triangles"] for r in of], [r[key] for r in of], style, color=color, label=label)
        for peer, color in (("pyrender", PEERS[1]), ("Embree's rays", PEERS[2])):
            axes.plot([few], [beside[f"{peer} ms"]], "D", color=color, label=peer)
        axes.set(xscale="log", yscale="log", xlabel="triangles in the scene", ylabel="ms per frame")
        axes.legend(fontsize=8)

    return Section("gpu", f"Device: {result['device']}.", figures, draw)


def _instances(result: dict) -> Section:
    rows = result["rows"]
    compared = [row for row in rows if row.get("pyrender ms")]
    figures = [
        Figure(f"{row['instances']} instances", "ms", row["ms"], "pyrender", row["pyrender ms"])
        for row in compared
    ]
    figures += [
        Figure(f"{row['instances']:,} instances", "ms", row["ms"], "one instance of ours", rows[0]["ms"])
        for row in rows[1:]
    ]

    def draw(plot: Plot) -> None:
        axes = plot.subplots()
        lines = {"nanite_rs": [row["ms"] for row in rows]}
        if compared:
            lines["pyrender on OSMesa"] = [row["pyrender ms"] for row in compared]
        _lines(axes, [row["instances"] for row in rows], lines, (OURS, PEERS[0]))
        axes.set(xlabel="instances", ylabel="ms per frame")

    text = f"Instances of {result['mesh triangles']:,} triangles, which together cover as many pixels as one."
    return Section("instances", text, figures, draw)


def _memory(result: dict) -> Section:
    rows = result["rows"]
    methods = list(dict.fromkeys(row["method"] for row in rows))
    sizes = list(dict.fromkeys(row["triangles"] for row in rows))
    by = {(row["method"], row["triangles"]): row[memory.PEAK] for row in rows}
    figures = [
        Figure(
            f"{method}, {size:,} triangles",
            "B per triangle",
            by[method, size],
            build.PEER,
            by[build.PEER, size],
        )
        for method in methods[:-1]
        for size in sizes
    ]

    def draw(plot: Plot) -> None:
        for axes, size in zip(
            plot.subplots(1, len(sizes), sharey=True, squeeze=False)[0], sizes, strict=True
        ):
            colors = (OURS, OURS_TOO, OURS_THREE, PEERS[0])
            _bars(axes, {m: by[m, size] for m in methods}, "bytes per triangle at the peak", colors)
            axes.set_title(f"{size:,} triangles", fontsize=9)

    text = "What a build takes at its peak beyond the arrays that it was given, each in a process of its own."
    return Section("memory", text, figures, draw, (9.0, 2.6))


SECTIONS: dict[str, Callable[[dict], Section]] = {
    "frames": _frames,
    "instances": _instances,
    "gpu": _gpu,
    "cut": _cut,
    "decimate": _decimate,
    "build": _build,
    "memory": _memory,
    "distance": _distance,
    "files": _files,
}


def _lines(axes: Axes, x: list[float], lines: dict[str, list[float]], colors: tuple[str, ...]) -> None:
    """Lines over logarithmic axes, ticks where something was measured; a line may end early."""
    for (label, values), color in zip(lines.items(), colors, strict=False):
        axes.plot(x[: len(values)], values, "o-", color=color, label=label)
    axes.set(xscale="log", yscale="log")
    axes.set_xticks(x, [f"{value:,}" for value in x])
    axes.set_xticks([], minor=True)
    axes.legend(fontsize=8)


def _bars(axes: Axes, values: dict[str, float], label: str, colors: tuple[str, ...]) -> None:
    """Horizontal bars with their numbers, the first on top."""
    bars = axes.barh(list(values), list(values.values()), color=colors[: len(values)])
    axes.bar_label(bars, [cell(value) for value in values.values()], padding=3, fontsize=8)
    axes.set(xlabel=label, xlim=(0, 1.18 * max(values.values())), ylim=(len(values) - 0.4, -0.6))


# ---------------------------------------------------------------------------------------------------- page


def write(results: dict, folder: Path) -> list[Section]:
    """Write the page and its pictures into a folder, which is made."""
    folder.mkdir(parents=True, exist_ok=True)
    found = sections(results)
    for section in found:
        _picture(section).savefig(folder / f"{section.name}.png", dpi=130)
    (folder / "report.md").write_text(_markdown(results, found), encoding="utf-8")
    (folder / "index.html").write_text(_html(results, found), encoding="utf-8")
    (folder / "results.json").write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    return found


def _picture(section: Section) -> Plot:
    plot = Plot(figsize=section.size, layout="constrained")
    section.draw(plot)
    for axes in plot.axes:
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(axis="both" if axes.lines else "x", color="#e5e5e5", linewidth=0.6)
        axes.set_axisbelow(True)
        if axes.get_yscale() == "log":
            axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.7g}"))
            axes.yaxis.set_minor_formatter(NullFormatter())
    return plot


def _title(results: dict) -> str:
    return f"Benchmarks of nanite_rs, {results['date']}" + (
        " (small meshes: not to quote)" if results["quick"] else ""
    )


def _machine(results: dict) -> list[tuple[str, str]]:
    """What it was measured on and with."""
    of = results["machine"]
    return [
        ("processor", f"{of['processor']}, {of['cores']} cores, {of['memory_gib']} GiB"),
        ("system", f"{of['system']}, Python {of['python']}"),
        ("GPU", str(of.get("device", "not asked for"))),
        ("OpenGL", str(results.get("frames", {}).get("pyrender's driver", "not asked for"))),
        ("versions", ", ".join(f"{name} {version}" for name, version in of["packages"].items() if version)),
        ("load before the first run", str(of["load"])),
    ]


NOTE = (
    "Medians of runs in turn, so that what else runs on the machine slows all contestants alike: quote ratios. "
    "What each benchmark measures, and how, is in benchmarks/README.md. × says how many times ours the peer's "
    "figure is; above 1, ours is the smaller and better one."
)
HEAD = ("", "unit", "nanite_rs", "peer", "peer's", "×")


def _cells(figure: Figure) -> tuple[str, ...]:
    return (
        figure.what,
        figure.unit,
        cell(figure.ours),
        figure.peer,
        cell(figure.theirs),
        f"{figure.ratio:.3g}" if figure.ratio < 1000 else f"{figure.ratio:,.0f}",
    )


def _markdown(results: dict, found: list[Section]) -> str:
    lines = [f"# {_title(results)}", "", NOTE, ""]
    lines += ["| | |", "|---|---|", *(f"| {name} | {value} |" for name, value in _machine(results)), ""]
    for section in found:
        lines += [
            f"## {TITLES[section.name]}",
            "",
            section.text,
            "",
            f"![{section.name}]({section.name}.png)",
            "",
        ]
        lines += ["| " + " | ".join(HEAD) + " |", "|---|---|---:|---|---:|---:|"]
        lines += ["| " + " | ".join(_cells(figure)) + " |" for figure in section.figures]
        lines.append("")
    return "\n".join(lines)


STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; color: #222 }
h1 { font-size: 1.5rem } h2 { font-size: 1.15rem; margin-top: 2.2rem }
table { border-collapse: collapse; font-size: 13px } td, th { padding: .2rem .7rem .2rem 0; text-align: left }
tr + tr td { border-top: 1px solid #eee } .n { text-align: right; font-variant-numeric: tabular-nums }
img { max-width: 100% }
"""


def _html(results: dict, found: list[Section]) -> str:
    escape = html.escape
    title = escape(_title(results))
    parts = [
        "<!doctype html>",
        '<html lang="en"><head><meta charset="utf-8">',
        f"<title>{title}</title><style>{STYLE}</style></head><body>",
        f"<h1>{title}</h1><p>{escape(NOTE)}</p><table>",
        *(f"<tr><td>{escape(name)}</td><td>{escape(value)}</td></tr>" for name, value in _machine(results)),
        "</table>",
    ]
    numbers = (2, 4, 5)
    for section in found:
        parts += [f"<h2>{escape(TITLES[section.name])}</h2><p>{escape(section.text)}</p>"]
        parts += [f'<img src="{section.name}.png" alt="{section.name}"><table><tr>']
        parts += [_td("th", text, k in numbers) for k, text in enumerate(HEAD)]
        parts.append("</tr>")
        for figure in section.figures:
            cells = "".join(_td("td", text, k in numbers) for k, text in enumerate(_cells(figure)))
            parts.append(f"<tr>{cells}</tr>")
        parts.append("</table>")
    return "\n".join([*parts, "</body></html>", ""])


def _td(tag: str, text: str, number: bool) -> str:
    kind = ' class="n"' if number else ""
    return f"<{tag}{kind}>{html.escape(text)}</{tag}>"


def bad(found: list[Section]) -> list[str]:
    """Figures that no measurement can have: not finite, or not positive."""
    return [
        f"{section.name}: {figure.what}, {figure.peer}"
        for section in found
        for figure in section.figures
        if not all(math.isfinite(value) and value > 0 for value in (figure.ours, figure.theirs))
    ]


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.python.report", description=__doc__)
    parser.add_argument(
        "results", nargs="?", type=Path, help="a JSON file of results; without, all is measured"
    )
    parser.add_argument("--fast", action="store_true", help="small meshes: to try it, not to quote")
    parser.add_argument("--output", type=Path, default=REPORT, help="folder for the page (%(default)s)")
    options = parser.parse_args()
    if options.results:
        results = json.loads(options.results.read_text(encoding="utf-8"))
    else:
        results = measure(fast=options.fast)
    found = write(results, options.output)
    if wrong := bad(found):
        raise SystemExit(f"not finite or not positive: {'; '.join(wrong)}")
    print(f"wrote {options.output / 'index.html'} and report.md")


if __name__ == "__main__":
    main()
