"""Reports of builds and checks, as objects that read well in a terminal and in a notebook."""

from __future__ import annotations

import json
from dataclasses import dataclass, fields
from typing import Any

from nanite_rs._notebook import pairs, table

__all__ = ["BuildReport", "CheckReport", "LevelReport", "RebakedPart", "StuckGroup", "TilesReport"]


_LEVELS = """\
At each level, finest first, clusters are gathered into groups, and the triangles of each group are halved.
retried: groups that go on to the next level as they are. by step: groups simplified with their attributes / with
another topology / permissively / sloppily. max error, of attributes: the largest made, in units of the mesh."""


@dataclass(frozen=True)
class LevelReport:
    """What grouping and simplifying one level did."""

    clusters: int
    """Clusters at the level."""
    triangles: int
    """Triangles in them."""
    groups: int
    """Groups they were gathered into."""
    retried: int
    """Groups whose clusters went on to the next level unchanged."""
    steps: tuple[int, ...]
    """Groups simplified by each step of the chain: attributes, the same with a change of topology, permissive,
    sloppy."""
    max_error: float
    """Largest error of the shape made, in the units of the mesh."""
    max_attribute_error: float
    """Largest deviation of attributes made, as a length in the units of the mesh: see `Cut.attribute_error`."""


@dataclass(frozen=True)
class StuckGroup:
    """A group from which nothing coarser could be made, besides the last one."""

    level: int
    """Round of grouping."""
    clusters: int
    """Number of clusters."""
    triangles: int
    """Number of triangles."""
    reason: str
    """Why: ``too_few_collapses``, ``border_changed``, ``mixed_materials`` or ``vanished``."""


@dataclass(frozen=True)
class RebakedPart:
    """A part of a level that has an image of its own: see `rebake`."""

    level: int
    """Times its surface was simplified."""
    material: int
    """The number of the material that shows the image."""
    triangles: int
    """Number of triangles."""
    texel: float
    """The size of a texel, in the units of the mesh."""


@dataclass(frozen=True)
class BuildReport:
    """What a build was given, what it mended, and what it made.

    Examples
    --------
    >>> report = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=5_000)).report
    >>> report.input_faces, report.degenerate_faces, report.border_edges
    (5120, 0, 0)
    """

    input_faces: int
    """Faces given."""
    input_vertices: int
    """Vertices given."""
    degenerate_faces: int
    """Faces dropped because two corners coincide."""
    duplicate_faces: int
    """Faces dropped because an identical face came before."""
    unreferenced_vertices: int
    """Vertices that no remaining face uses."""
    welded_vertices: int
    """Vertices merged into one with the same bits."""
    non_manifold_edges: int
    """Edges, by position, with more than two faces."""
    border_edges: int
    """Edges, by position, with one face."""
    mended_normals: int
    """Given normals of zero length, replaced by computed ones."""
    computed_normals: bool
    """Normals were computed, because none were given."""
    clusters: int
    """Clusters of all levels."""
    triangles: int
    """Triangles of all levels."""
    fill: float
    """Mean triangles per cluster over the most a cluster holds."""
    levels: tuple[LevelReport, ...]
    """One entry per level, finest first."""
    stuck: tuple[StuckGroup, ...]
    """Groups that stayed roots, besides the last one, each with its reason."""
    rebaked: tuple[RebakedPart, ...] = ()
    """Parts of levels with images of their own, finest first."""

    @classmethod
    def _from_json(cls, text: str) -> BuildReport:
        data: dict[str, Any] = json.loads(text)
        levels = tuple(
            LevelReport(**{**level, "steps": tuple(level["steps"])}) for level in data.pop("levels")
        )
        stuck = tuple(StuckGroup(**group) for group in data.pop("stuck"))
        rebaked = tuple(RebakedPart(**part) for part in data.pop("rebaked", ()))
        known = {f.name for f in fields(cls)}
        return cls(
            levels=levels, stuck=stuck, rebaked=rebaked, **{k: v for k, v in data.items() if k in known}
        )

    def _mended(self) -> str:
        counts = {
            "degenerate faces": self.degenerate_faces,
            "duplicate faces": self.duplicate_faces,
            "unreferenced vertices": self.unreferenced_vertices,
            "zero normals": self.mended_normals,
        }
        found = [f"{count:,} {what}" for what, count in counts.items() if count]
        return ", ".join(found) or "nothing"

    def _summary(self) -> list[tuple[str, str]]:
        stuck: dict[str, int] = {}
        for group in self.stuck:
            stuck[group.reason] = stuck.get(group.reason, 0) + 1
        reasons = ", ".join(f"{count:,} × {reason}" for reason, count in sorted(stuck.items()))
        return [
            ("given", f"{self.input_faces:,} faces, {self.input_vertices:,} vertices"),
            ("mended", self._mended()),
            ("welded", f"{self.welded_vertices:,} vertices"),
            ("edges", f"{self.border_edges:,} at borders, {self.non_manifold_edges:,} non-manifold"),
            ("normals", "computed" if self.computed_normals else "given"),
            ("made", f"{self.clusters:,} clusters, {self.triangles:,} triangles, {self.fill:.1%} full"),
            ("stuck groups", reasons or "none"),
            *([("rebaked", self._images())] if self.rebaked else []),
        ]

    def _images(self) -> str:
        images = len({part.material for part in self.rebaked})
        finest, coarsest = self.rebaked[0], self.rebaked[-1]
        return (
            f"{len(self.rebaked)} parts of {finest.triangles:,} to {coarsest.triangles:,} triangles "
            f"show {images} images, texels of {finest.texel:.4g} to {coarsest.texel:.4g}"
        )

    _COLUMNS = (
        "level",
        "clusters",
        "triangles",
        "groups",
        "retried",
        "by step",
        "max error",
        "of attributes",
    )

    def _rows(self) -> list[tuple[str, ...]]:
        return [
            (
                str(number),
                f"{level.clusters:,}",
                f"{level.triangles:,}",
                f"{level.groups:,}",
                f"{level.retried:,}",
                "/".join(str(n) for n in level.steps),
                f"{level.max_error:.4g}",
                f"{level.max_attribute_error:.4g}",
            )
            for number, level in enumerate(self.levels)
        ]

    def __str__(self) -> str:
        """Summary and one line per level, with what its columns are."""
        lines = [f"{name:>13}  {value}" for name, value in self._summary()]
        rows = [self._COLUMNS, *self._rows()]
        widths = [max(len(row[k]) for row in rows) for k in range(len(self._COLUMNS))]
        lines += [
            "  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)) for row in rows
        ]
        lines.append(_LEVELS)
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        return pairs(self._summary()) + table(self._COLUMNS, self._rows())


@dataclass(frozen=True)
class CheckReport:
    """How many of each thing was verified by `NaniteMesh.check`."""

    clusters: int
    """Clusters whose bounds, links, errors and streams hold."""
    groups: int
    """Groups whose spheres, errors and borders hold."""
    nodes: int
    """Nodes that enclose what is below them."""
    vertices: int
    """Vertex identities that have one position everywhere."""
    borders: int
    """Groups whose boundary was compared before and after simplification."""

    def _repr_html_(self) -> str:
        return pairs([(name, f"{count:,}") for name, count in vars(self).items()])


@dataclass(frozen=True)
class TilesReport:
    """What `NaniteMesh.to_3dtiles` or `Scene.to_3dtiles` wrote."""

    path: str
    """The ``tileset.json`` that viewers open."""
    tiles: int
    """Tiles that show something."""
    levels: int
    """Levels of detail."""
    triangles: int
    """Triangles of all tiles, without those of skirts."""
    bytes: int
    """Bytes of all contents, and of the images that they share."""
    median_bytes: int
    """Bytes of a content in the median."""
