"""`Clusters`: all clusters of a mesh as arrays, for renderers of one's own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from nanite_rs import _core

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from nanite_rs.mesh import NaniteMesh

__all__ = ["Clusters"]


@dataclass(frozen=True, eq=False)
class Clusters:
    """All clusters of all levels, of which a renderer draws some: made by `NaniteMesh.clusters`.

    C clusters follow each other, with V vertices and T triangles in all: those of cluster ``c`` are
    ``vertices[vertex_offsets[c]:vertex_offsets[c + 1]]`` and so on, and corners of its triangles count from its
    first vertex. A cluster has at most 128 triangles and 255 vertices, one material, and shares no vertex with
    another; where two touch, both have one at the same position, bit for bit.

    **The rule of the cut.** A cluster is drawn where its own error, seen at its sphere, takes no more than τ
    pixels, and that of its group takes more: ::

        pixels(errors[c], spheres[c]) <= τ < pixels(group_errors[groups[c]], group_spheres[groups[c]])

    Errors rise from a cluster to its group, and the sphere of the group is around that of the cluster. So
    whatever ``pixels`` is, if it rises with the error and with the sphere, what is drawn is the surface, once and
    without a crack. For a pinhole, ``error / max(distance of the eye from the centre - radius, near) * height /
    (2 tan(fov / 2))`` is one. After Karis, Stubbe and Wihlidal (2021). Lengths are in units of the mesh.

    These arrays are a stable view of the DAG; files and pages may change under them.

    Examples
    --------
    >>> mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=20_000))
    >>> all = mesh.clusters()
    >>> cut = mesh.cut(error=0.01)
    >>> drawn = (all.errors <= 0.01) & (all.group_errors[all.groups] > 0.01)
    >>> int(np.diff(all.triangle_offsets)[drawn].sum()) == len(cut)
    True
    """

    vertices: NDArray[np.float32] | NDArray[np.float64]
    """Positions: (V, 3), float64 where the source needed it."""
    normals: NDArray[np.float32]
    """Unit normals: (V, 3)."""
    colors: NDArray[Any] | None
    """Colours, linear RGBA: (V, 4) of the dtype of `Cut.fine_colors`, or None."""
    uvs: list[NDArray[np.float32]]
    """UV sets: (V, 2) each, v up."""
    vertex_ids: NDArray[np.uint32]
    """Identities as of `Cut.vertex_ids`: (V,). Vertices of several clusters with one identity are the same."""
    vertex_offsets: NDArray[np.int64]
    """The first vertex of each cluster: (C + 1,)."""
    triangles: NDArray[np.uint8]
    """Corners, counted from the first vertex of the cluster, counter-clockwise: (T, 3)."""
    triangle_offsets: NDArray[np.int64]
    """The first triangle of each cluster: (C + 1,)."""
    lower: NDArray[np.float64]
    """Lower corners of the boxes around clusters: (C, 3)."""
    upper: NDArray[np.float64]
    """Upper corners: (C, 3)."""
    errors: NDArray[np.float64]
    """Own errors, of shape and attributes: (C,); 0 for the source."""
    spheres: NDArray[np.float64]
    """Where own errors are projected, x, y, z and radius: (C, 4)."""
    levels: NDArray[np.uint8]
    """Times their surface was simplified: (C,)."""
    materials: NDArray[np.int32] | None
    """Face materials: (C,); None where the mesh has none."""
    ids: NDArray[np.uint32]
    """Addresses as of `Cut.cluster_ids` and of the frame's ``cluster_id``: (C,), ascending."""
    groups: NDArray[np.int64]
    """The group that each is a member of: (C,)."""
    origins: NDArray[np.int64]
    """The group that each was made from: (C,); -1 for the source."""
    group_errors: NDArray[np.float64]
    """Errors of what was made from each of G groups: (G,); infinite at the top."""
    group_spheres: NDArray[np.float64]
    """Where they are projected: (G, 4)."""

    def __len__(self) -> int:
        """Number of clusters."""
        return len(self.ids)

    def __repr__(self) -> str:
        return (
            f"Clusters({len(self):,} clusters, {len(self.triangles):,} triangles, {len(self.vertices):,} vertices, "
            f"{len(self.group_errors):,} groups)"
        )


def of_mesh(mesh: NaniteMesh) -> Clusters:
    """Read all clusters."""
    core = mesh._core
    arrays, table, groups = _core.cluster_arrays(core), _core.cluster_table(core), _core.group_table(core)
    vertices = arrays["vertices"]
    narrow = vertices.astype(np.float32)

    def offsets(counts: NDArray[Any]) -> NDArray[np.int64]:
        return np.concatenate([[0], np.cumsum(counts, dtype=np.int64)])

    return Clusters(
        vertices=narrow if (narrow == vertices).all() else vertices,
        normals=arrays["normals"],
        colors=arrays["colors"],
        uvs=arrays["uvs"],
        vertex_ids=arrays["vertex_ids"],
        vertex_offsets=offsets(table["vertices"]),
        triangles=arrays["triangles"],
        triangle_offsets=offsets(table["triangles"]),
        lower=arrays["lower"],
        upper=arrays["upper"],
        errors=np.maximum(table["error"], 0.0),
        spheres=table["sphere"],
        levels=table["level"],
        materials=table["material"] if core.has_materials else None,
        ids=table["id"],
        groups=table["group"],
        origins=table["origin"],
        group_errors=groups["error"],
        group_spheres=groups["sphere"],
    )
