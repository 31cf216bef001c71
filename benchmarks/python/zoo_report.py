"""The rows of ``zoo.py`` as lines and as Markdown."""

from __future__ import annotations

from typing import Any

import numpy as np

Row = dict[str, Any]
TURNED = 1e-3
"""Share of the area that may be turned beyond VTK's."""
WORST = 10
"""Rows of each quality that are told apart."""
ROUNDING = 5e-3
"""Of a ratio that counts as 1.0."""


def _vtk(row: Row) -> Row | None:
    found = row["peers"].get("vtk")
    return found if found and "failed" not in found else None


def _ratio(row: Row) -> float | None:
    vtk = _vtk(row)
    return vtk["ratio"] if vtk else None


def _key(row: Row) -> tuple[str, str, float]:
    return row["mesh"], row["quality"], row["removed"]


def new_shared(row: Row) -> bool:
    """Whether a cut has edges of more than two faces where the source has none."""
    return row["shared"] > 0 and row["source"]["shared"] == 0


def new_open(row: Row) -> bool:
    """Whether a cut has open edges where the source has none."""
    return row["open"] > 0 and row["source"]["open"] == 0


def too_many(row: Row) -> bool:
    """Whether a cut has more triangles than it was asked for."""
    return row["of target"] > 1 + 1e-9


def turned_beyond(row: Row) -> bool:
    """Whether more of a cut is turned than of VTK's mesh."""
    vtk = _vtk(row)
    return row["turned"] > (vtk["turned"] if vtk else 0) + TURNED


def flags(row: Row) -> list[str]:
    """What is wrong with a row, in words."""
    vtk = _vtk(row)
    found = []
    if row["violated"]:
        found.append(f"BOUND VIOLATED {row['stated']:.6g} < {row['max']:.6g}")
    if too_many(row):
        found.append("over budget" + (", coarsest" if row["coarsest"] else ""))
    if turned_beyond(row):
        found.append(f"turned {row['turned']:.2%}" + (f" (VTK {vtk['turned']:.2%})" if vtk else ""))
    folded = row["folded"] - row["source"]["folded"]
    if folded > 0:
        theirs = vtk["folded"] - row["source"]["folded"] if vtk else 0
        found.append(f"folded {folded:+d} (VTK {theirs:+d})")
    if new_open(row):
        found.append(f"OPENED {row['open']} edges")
    if new_shared(row):
        found.append(f"shared {row['shared']}" + (f" (VTK {vtk['shared']})" if vtk else ""))
    return found


def line(row: Row, earlier: list[Row]) -> str:
    """A row for the terminal."""
    text = (
        f"{row['kind'][:8]:8} {row['mesh'][:24]:24} {row['quality']} {row['removed']:<4}"
        f" {row['triangles']:6} {row['of target']:5.0%} rms {row['rms']:8.3g} max {row['max']:7.3g}"
    )
    for peer, found in row["peers"].items():
        value = "failed" if "failed" in found else f"{found['ratio']:.2f}×"
        text += f" {_short(peer)} {value}" + ("e" if "early" in found else "")
    before = next((r for r in earlier if _key(r) == _key(row)), None)
    if before:
        text += f" was {_number(_ratio(before), '.2f')}× rms {before['rms']:.3g}"
    tight = _number(row["tightness"], ".2f")
    return text + f" tight {tight} " + "; ".join(flags(row))


def _short(peer: str) -> str:
    return {"fast-simplification": "f-s", "fast-simplification 100": "f-s100", "meshoptimizer": "mo"}.get(
        peer, peer
    )


def _number(value: float | None, form: str) -> str:
    return "–" if value is None else format(value, form)


def document(rows: list[Row], errors: list[str], earlier: list[Row]) -> str:
    """Everything as Markdown: the table by kind, then what stands out."""
    if not rows:
        return "Nothing was measured.\n" + "".join(f"- {error}\n" for error in errors)
    peers = list(rows[0]["peers"])
    lines = ["# Cuts of many kinds of meshes", "", summary(rows), "", by_kind(rows), ""]
    if errors:
        lines += ["## Failed", "", *(f"- {error}" for error in errors), ""]
    lines += ["## Worst", "", *worst(rows), ""]
    if earlier:
        lines += ["## Against the earlier run", "", *changes(rows, earlier), ""]
    heads = ["mesh", "quality", "removed", "triangles", "of target", "rms", "mean", "max", "stated/max"]
    heads += [f"÷ {_short(peer)}" for peer in peers]
    heads += ["turned, VTK's", "folded, VTK's", "open, source's", "shared, source's", "build s", "remarks"]
    for kind in dict.fromkeys(row["kind"] for row in sorted(rows, key=lambda row: row["kind"])):
        lines += [f"## {kind}", "", f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
        lines += [_cells(row, peers) for row in rows if row["kind"] == kind]
        lines.append("")
    return "\n".join(lines)


def _cells(row: Row, peers: list[str]) -> str:
    vtk, source = _vtk(row), row["source"]
    cells = [row["mesh"], row["quality"], f"{row['removed']:g}", f"{row['triangles']:,}"]
    cells += [f"{row['of target']:.0%}", f"{row['rms']:.3g}", f"{row['mean']:.3g}", f"{row['max']:.3g}"]
    cells.append(_number(row["tightness"], ".2f"))
    for peer in peers:
        found = row["peers"][peer]
        if "failed" in found:
            cells.append(found["failed"])
        else:
            early = f" ({found['ratio as asked']:.2f} as asked)" if "early" in found else ""
            cells.append(f"{found['ratio']:.2f}{early}")
    cells += [
        f"{row['turned']:.2%}" + (f", {vtk['turned']:.2%}" if vtk else ""),
        f"{row['folded'] - source['folded']:+d}"
        + (f", {vtk['folded'] - source['folded']:+d}" if vtk else ""),
        f"{row['open']}, {source['open']}",
        f"{row['shared']}, {source['shared']}",
        f"{row['build s']:.2f}",
        "; ".join(flags(row)),
    ]
    return f"| {' | '.join(cells)} |"


def summary(rows: list[Row]) -> str:
    """A row for each quality and part removed."""
    heads = ["quality", "removed", "meshes", "≤ 1.0× VTK", "≤ 1.15×", "median ratio", "worst ratio"]
    heads += ["median stated/max", "bounds violated", "turned beyond VTK", "new folds beyond VTK", "opened"]
    heads += ["newly shared edges, VTK's", "over budget", "of those coarsest"]
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for quality in sorted({row["quality"] for row in rows}):
        for removed in sorted({row["removed"] for row in rows}):
            these = [r for r in rows if (r["quality"], r["removed"]) == (quality, removed)]
            if these:
                lines.append(_summary(quality, removed, these))
    return "\n".join(lines)


def _summary(quality: str, removed: float, rows: list[Row]) -> str:
    ratios = np.array([r for r in map(_ratio, rows) if r is not None])
    tight = [r["tightness"] for r in rows if r["tightness"] is not None]
    folds = sum(bool((v := _vtk(r)) and r["folded"] > max(v["folded"], r["source"]["folded"])) for r in rows)
    theirs = sum(bool((v := _vtk(r)) and v["shared"] and not r["source"]["shared"]) for r in rows)
    cells = [
        quality,
        f"{removed:g}",
        len(rows),
        f"{(ratios <= 1.0 + ROUNDING).sum()} of {len(ratios)}",
        (ratios <= 1.15).sum(),
        f"{np.median(ratios):.2f}" if len(ratios) else "–",
        f"{ratios.max():.2f}" if len(ratios) else "–",
        f"{np.median(tight):.2f}" if tight else "–",
        sum(r["violated"] for r in rows),
        sum(map(turned_beyond, rows)),
        folds,
        sum(map(new_open, rows)),
        f"{sum(map(new_shared, rows))}, {theirs}",
        sum(map(too_many, rows)),
        sum(r["coarsest"] for r in rows if too_many(r)),
    ]
    return f"| {' | '.join(map(str, cells))} |"


def by_kind(rows: list[Row]) -> str:
    """The median ratio to VTK of each kind, and the number of meshes that are no worse."""
    levels = sorted({(row["quality"], row["removed"]) for row in rows})
    heads = ["kind", *(f"{quality} {removed:g}" for quality, removed in levels)]
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for kind in sorted({row["kind"] for row in rows}):
        cells = [kind]
        for level in levels:
            these = [r for r in rows if r["kind"] == kind and (r["quality"], r["removed"]) == level]
            ratios = np.array([r for r in map(_ratio, these) if r is not None])
            good = (ratios <= 1.0 + ROUNDING).sum()
            cells.append(f"{np.median(ratios):.2f} ({good} of {len(ratios)})" if len(ratios) else "–")
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def worst(rows: list[Row]) -> list[str]:
    """The rows that are farthest behind VTK, for each quality; then violated bounds and opened borders."""
    lines = []
    for quality in sorted({row["quality"] for row in rows}):
        some = sorted(
            (r for r in rows if r["quality"] == quality and _ratio(r) is not None), key=_ratio, reverse=True
        )
        lines += [f"Rms against VTK, {quality}:", ""]
        for row in some[:WORST]:
            vtk = row["peers"]["vtk"]
            lines.append(
                f"- {_ratio(row):.2f}× {row['mesh']} ({row['kind']}), {row['removed']:g} removed:"
                f" rms {row['rms']:.3g}, VTK {vtk['rms']:.3g} with {vtk['triangles']:,} of {row['triangles']:,}"
            )
        lines.append("")
    loud = [r for r in rows if r["violated"] or new_open(r) or turned_beyond(r)]
    lines += [f"- {r['mesh']}, {r['quality']}, {r['removed']:g}: {'; '.join(flags(r))}" for r in loud]
    return lines


def changes(rows: list[Row], earlier: list[Row]) -> list[str]:
    """Rows whose rms moved by more than 3 %, the ones that lost most first."""
    old = {_key(row): row for row in earlier}
    moved = []
    for row in rows:
        if before := old.get(_key(row)):
            change = max(row["rms"], 1e-2) / max(before["rms"], 1e-2)
            if abs(change - 1) > 0.03:
                moved.append((change, row, before))
    lines = [
        f"{len(moved)} of {len(rows)} rows moved by more than 3 %, {sum(c > 1 for c, *_ in moved)} up.",
        "",
    ]
    for change, row, before in sorted(moved, key=lambda item: -item[0]):
        lines.append(
            f"- {change:.2f}× {row['mesh']}, {row['quality']}, {row['removed']:g}:"
            f" rms {before['rms']:.3g} → {row['rms']:.3g},"
            f" ÷ VTK {_number(_ratio(before), '.2f')} → {_number(_ratio(row), '.2f')}"
        )
    return lines
