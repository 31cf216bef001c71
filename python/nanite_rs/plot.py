"""Plots of meshes and frames with matplotlib, which ``pip install matplotlib`` installs.

Each function draws on the `matplotlib.axes.Axes` given, or on those of a new figure, and returns them. Levels have
one colour in all plots: red is the finest, then towards blue, as in ``frame.view("levels")``.

Examples
--------
>>> mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=20_000))
>>> ax = nrs.plot.levels(mesh)
>>> ax.get_ylabel()
'triangles'
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from nanite_rs import _advice, _core
from nanite_rs.exceptions import ArgumentError, DtypeError
from nanite_rs.frame import Frame
from nanite_rs.mesh import NaniteMesh

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import ListedColormap

    from nanite_rs.io import PathLike

__all__ = ["error_against_triangles", "funnel", "levels", "pages"]

_FINEST: Final = "0: the source"

_LABELLED: Final = 24
"""Most bars that numbers are written on."""

_PAGE_KIB: Final = 128
"""Most that a page takes in memory."""


def levels(
    mesh: NaniteMesh, *, what: Literal["triangles", "clusters"] = "triangles", ax: Axes | None = None
) -> Axes:
    """Draw how many triangles or clusters each level of the DAG has, on a logarithmic axis.

    These are the counts of ``mesh.report.levels``: what each level simplified, with what an earlier
    level could not. Of a file nothing more is read.

    Parameters
    ----------
    mesh : NaniteMesh
        The mesh.
    what : str
        ``"triangles"`` or ``"clusters"``.
    ax : matplotlib.axes.Axes, optional
        Where to draw; by default a new figure.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    ArgumentError, DtypeError
        The arguments are none of these.
    DependencyError
        Without matplotlib.

    Examples
    --------
    >>> mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=20_000))
    >>> ax = nrs.plot.levels(mesh)
    >>> heights = [bar.get_height() for bar in ax.patches]
    >>> int(heights[0]), heights == sorted(heights, reverse=True)
    (20480, True)
    """
    _check(mesh, NaniteMesh, "mesh")
    if what not in ("triangles", "clusters"):
        raise ArgumentError(f'what: must be "triangles" or "clusters", not {what!r}')
    ax = _axes(ax, "levels")
    counts = [getattr(level, what) for level in mesh.report.levels]
    bars = ax.bar(range(len(counts)), counts, color=_palette(len(counts)).colors)
    if len(counts) <= _LABELLED:
        ax.bar_label(bars, [_short(count) for count in counts], fontsize="x-small", padding=2)
    _whole_ticks(ax.xaxis)
    ax.set_yscale("log")
    # A bar of 1 is visible, and the number of the highest has room.
    ax.set_ylim(0.5, 0.5 * (max(counts) / 0.5) ** 1.08)
    ax.set_xlabel(f"level ({_FINEST})")
    ax.set_ylabel(what)
    return ax


def error_against_triangles(mesh: NaniteMesh, *, cuts: int = 24, ax: Axes | None = None) -> Axes:
    """Draw the stated error of cuts over their number of triangles, both axes logarithmic.

    Cuts are made from full detail down to the coarsest, each of some part of the triangles of the one before; of
    a file all is read. Errors of 0 have no place on the axis. Where the mesh carries attributes, a second line is
    `Cut.attribute_error`.

    Parameters
    ----------
    mesh : NaniteMesh
        The mesh.
    cuts : int
        How many to make at most, 2 or more. Those that are the same are drawn once.
    ax : matplotlib.axes.Axes, optional
        Where to draw; by default a new figure.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    ArgumentError, DtypeError
        The arguments are none of these.
    DependencyError
        Without matplotlib.
    FormatError, FileError
        The file that the mesh was opened from is damaged, or cannot be read.

    Examples
    --------
    >>> mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.displaced_icosphere(faces=20_000))
    >>> ax = nrs.plot.error_against_triangles(mesh)
    >>> triangles, errors = ax.lines[0].get_data()
    >>> bool((np.diff(triangles) < 0).all() and errors[0] < errors[-1])
    True
    >>> bool(errors[-1] == mesh.cut(target_faces=1).error)
    True
    """
    _check(mesh, NaniteMesh, "mesh")
    if isinstance(cuts, bool) or not isinstance(cuts, int | np.integer):
        raise DtypeError(f"cuts: expected an integer, not {type(cuts).__name__}")
    if cuts < 2:
        raise ArgumentError(f"cuts: must be 2 or more, not {cuts}")
    ax = _axes(ax, "error_against_triangles")
    made = {}
    for target in np.geomspace(len(mesh), len(mesh.cut(target_faces=1)), int(cuts)):
        cut = mesh.cut(target_faces=max(int(target), 1))
        made[len(cut)] = (cut.error, cut.attribute_error)
    sizes = np.array(list(made))
    ax.set_xscale("log")
    ax.set_yscale("log")
    shape, attributes = np.array(list(made.values())).T
    for name, style, errors in (("shape", "o-", shape), ("attributes", "s--", attributes)):
        above = errors > 0.0
        if above.any():
            ax.plot(sizes[above], errors[above], style, label=name, markersize=3.5, linewidth=1.2)
    if not len(ax.lines):
        # Logarithmic axes need values even where there is nothing to draw.
        ax.set(xlim=(1, 10 * len(mesh)), ylim=(0.1, 1))
        ax.text(0.5, 0.5, "no cut has an error above 0", transform=ax.transAxes, ha="center")
    ax.grid(alpha=0.3)
    ax.set_xlabel("triangles of the cut")
    ax.set_ylabel("stated error, units of the mesh")
    if attributes.any():
        ax.legend()
    return ax


def funnel(frame: Frame, *, ax: Axes | None = None) -> Axes:
    """Draw what each stage of a frame received and passed on, in the order in which they ran.

    Stages that ran in both passes of occlusion culling come twice, the second time with "(2)". What is counted
    stands beside each bar.

    Parameters
    ----------
    frame : Frame
        The frame; its `Frame.stats` are drawn.
    ax : matplotlib.axes.Axes, optional
        Where to draw; by default a new figure.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    DtypeError
        The argument is no frame.
    DependencyError
        Without matplotlib.

    Examples
    --------
    >>> ax = nrs.plot.funnel(frame)
    >>> received, passed = ax.containers
    >>> [int(bar.get_width()) for bar in received] == [stage.received for stage in frame.stats]
    True
    """
    _check(frame, Frame, "frame")
    stats = frame.stats
    ax = _axes(ax, "funnel", (8.0, 1.2 + 0.4 * len(stats.stages)))
    rows = np.arange(len(stats.stages))
    names = [s.stage if s.pass_number == 1 else f"{s.stage} (2)" for s in stats]
    largest = max(1, *(max(s.received, s.passed) for s in stats))
    for label, color, shift, counts, units in (
        ("received", "C0", -0.2, [s.received for s in stats], [s.received_unit for s in stats]),
        ("passed on", "C1", 0.2, [s.passed for s in stats], [s.passed_unit for s in stats]),
    ):
        ax.barh(rows + shift, counts, 0.4, color=color, label=label)
        for row, count, unit in zip(rows, counts, units, strict=True):
            # A logarithmic axis has no place for 0: its text stands where bars begin.
            place = (max(count, 0.5), row + shift)
            ax.annotate(
                f"{count:,} {unit}",
                place,
                (3, 0),
                textcoords="offset points",
                va="center",
                fontsize="x-small",
            )
    ax.set_xscale("log")
    ax.set_xlim(0.5, 0.5 * (largest / 0.5) ** 1.3)  # room for the text of the longest bar
    ax.set_yticks(rows, names)
    ax.set_ylim(len(rows) - 0.4, -0.6)
    ax.set_xlabel("count")
    ax.set_title(
        f"{stats.source_triangles:,} triangles in the source, {stats.triangles:,} in the cut, "
        f"{stats.covered_pixels:,} pixels covered, {stats.total_ms:.1f} ms",
        fontsize="small",
    )
    ax.legend(fontsize="small")
    return ax


def pages(source: NaniteMesh | PathLike, *, ax: Axes | None = None) -> Axes:
    """Draw the pages of a ``.nanite`` file, the coarsest first: how full each is, and the level of its clusters.

    A page takes at most 128 KiB in memory. Of a file the line is what the page takes there, compressed. The first
    pages are root pages, which hold the coarsest clusters of all levels and count for that of their first.

    Parameters
    ----------
    source : path or NaniteMesh
        The file, of which only the beginning is read, whatever its size; or a mesh.
    ax : matplotlib.axes.Axes, optional
        Where to draw; by default a new figure.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    DtypeError
        The source is none of these.
    MissingFileError, FileError, FormatError
        As for `NaniteMesh.open`.
    DependencyError
        Without matplotlib.

    Examples
    --------
    >>> mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=20_000))
    >>> mesh.save("sphere.nanite")
    >>> ax = nrs.plot.pages("sphere.nanite")
    >>> len(ax.collections[0].get_paths()) == nrs.NaniteMesh.file_info("sphere.nanite")["pages"]
    True
    """
    if not isinstance(source, NaniteMesh | str | os.PathLike):
        raise DtypeError(f"source: expected a path or a NaniteMesh, not {type(source).__name__}")
    ax = _axes(ax, "pages", (8.0, 4.0))
    from matplotlib import rcParams
    from matplotlib.collections import PolyCollection

    if isinstance(source, NaniteMesh):
        table = _core.page_table(source._core)
    else:
        table = _core.page_table_of_file(os.fsdecode(source))
    count, deepest = len(table["level"]), int(table["level"].max())
    kib = table["words"] * (4 / 1024)
    # A gap between few pages, so that each is seen.
    half = 0.45 if count <= 200 else 0.5
    left, right, low = np.arange(count) - half, np.arange(count) + half, np.zeros(count)
    corners = np.stack([left, low, left, kib, right, kib, right, low], axis=1).reshape(count, 4, 2)
    bars = PolyCollection(list(corners), array=table["level"], cmap=_palette(deepest + 1), linewidths=0)
    bars.set_clim(-0.5, deepest + 0.5)
    ax.add_collection(bars)
    if "bytes" in table:
        edges = np.arange(count + 1) - 0.5
        ax.stairs(
            table["bytes"] / 1024,
            edges,
            baseline=None,
            color=rcParams["text.color"],
            label="in the file, compressed",
        )
    ax.axhline(_PAGE_KIB, color="gray", linestyle=":", linewidth=1.0, label=f"{_PAGE_KIB} KiB, the most")
    ax.set_xlim(-0.6, count - 0.4)
    ax.set_ylim(0, _PAGE_KIB * 1.2)
    ax.set_yticks(range(0, _PAGE_KIB + 1, 32))
    _whole_ticks(ax.xaxis)
    ax.set_xlabel("page")
    ax.set_ylabel("KiB (bars: in memory)")
    ax.set_title(f"{count:,} page{'s' * (count > 1)}, {_size(float(kib.sum()))} in memory", fontsize="small")
    ax.legend(loc="upper right", ncols=2, fontsize="small")
    scale = ax.figure.colorbar(bars, ax=ax, label=f"level ({_FINEST})")
    _whole_ticks(scale.ax.yaxis)
    scale.ax.minorticks_off()
    return ax


def _check(value: object, kind: type, name: str) -> None:
    if not isinstance(value, kind):
        raise DtypeError(f"{name}: expected {kind.__name__}, not {type(value).__name__}")


def _axes(ax: Axes | None, name: str, size: tuple[float, float] | None = None) -> Axes:
    """What is given, or the axes of a new figure of ``size`` inches."""
    try:
        import matplotlib.axes
        from matplotlib import pyplot
    except ImportError as error:
        raise _advice.missing(f"plot.{name}", "matplotlib") from error
    if ax is None:
        made: Axes = pyplot.subplots(figsize=size, layout="constrained")[1]
        return made
    _check(ax, matplotlib.axes.Axes, "ax")
    return ax


def _palette(count: int) -> ListedColormap:
    """A colour for each level, without the darkest ones at either end."""
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap

    return ListedColormap(colormaps["turbo"](np.linspace(0.9, 0.1, count)))


def _whole_ticks(axis: Any) -> None:
    from matplotlib.ticker import MaxNLocator

    axis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))


def _short(count: int) -> str:
    """Three digits at most: 999, 1.23k, 45.6M."""
    for unit, name in ((10**9, "G"), (10**6, "M"), (10**3, "k")):
        if count >= unit:
            return f"{count / unit:.3g}{name}"
    return str(count)


def _size(kib: float) -> str:
    return f"{kib:.1f} KiB" if kib < 1024 else f"{kib / 1024:,.1f} MiB"
