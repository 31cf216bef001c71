"""The cluster DAG as tables, and what its promise means on them, stated without the rule of the cut."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Dag:
    """Clusters and groups of a built mesh, as `_core.cluster_table` and `_core.group_table` give them."""

    ids: np.ndarray  # (C,) identities, as in cut.cluster_ids
    level: np.ndarray  # (C,)
    error: np.ndarray  # (C,) own error, object units; negative at level 0
    group: np.ndarray  # (C,) the group a cluster is a member of
    origin: np.ndarray  # (C,) the group it was made from, −1 at level 0
    triangles: np.ndarray  # (C,)
    sphere: np.ndarray  # (C, 4)
    group_error: np.ndarray  # (G,) the parent error of the members, infinite where nothing was made
    group_shape_error: np.ndarray  # (G,) what cuts state for what was made of the members
    group_sphere: np.ndarray  # (G, 4)

    @classmethod
    def of(cls, mesh) -> Dag:
        """Reads the tables."""
        from nanite_rs import _core

        c, g = _core.cluster_table(mesh._core), _core.group_table(mesh._core)
        return cls(
            ids=np.asarray(c["id"]),
            level=np.asarray(c["level"]),
            error=np.asarray(c["error"]),
            group=np.asarray(c["group"], np.int64),
            origin=np.asarray(c["origin"], np.int64),
            triangles=np.asarray(c["triangles"]),
            sphere=np.asarray(c["sphere"]),
            group_error=np.asarray(g["error"]),
            group_shape_error=np.asarray(g["shape_error"]),
            group_sphere=np.asarray(g["sphere"]),
        )

    def clusters_per_path(self, drawn: np.ndarray) -> tuple[int, int]:
        """Least and greatest number of drawn clusters on any path from the source to a root.

        A path goes from a cluster to any of the clusters made from its group. One and one means: exactly one
        cluster over every piece of the surface.
        """
        count = len(self.group_error)
        made = self.origin >= 0
        low, high = drawn.astype(np.int64), drawn.astype(np.int64)
        # Least and greatest number from each group's successors on; groups are settled coarsest first.
        above_low, above_high = np.zeros(count, np.int64), np.zeros(count, np.int64)
        for depth in self._rounds:
            low[depth] = drawn[depth] + above_low[self.group[depth]]
            high[depth] = drawn[depth] + above_high[self.group[depth]]
            origins = self.origin[depth][made[depth]]
            source = depth[made[depth]]
            least = np.full(count, np.iinfo(np.int64).max)
            np.minimum.at(least, origins, low[source])
            touched = np.unique(origins)
            above_low[touched] = least[touched]
            np.maximum.at(above_high, origins, high[source])
        leaves = self.origin < 0
        return int(low[leaves].min()), int(high[leaves].max())

    def largest_above(self, drawn: np.ndarray, values: np.ndarray) -> np.ndarray:
        """For each cluster the largest value of the drawn ones on any path from it to a root."""
        largest = np.where(drawn, values, 0.0)
        above = np.zeros(len(self.group_error))
        for depth in self._rounds:
            largest[depth] = np.maximum(largest[depth], above[self.group[depth]])
            made = depth[self.origin[depth] >= 0]
            np.maximum.at(above, self.origin[made], largest[made])
        return largest

    @property
    def _rounds(self) -> list[np.ndarray]:
        """Clusters in an order in which those made from a group come before its members."""
        if not hasattr(self, "_order"):
            height = np.zeros(len(self.group_error), np.int64)  # steps from a group up to a root
            made = np.flatnonzero(self.origin >= 0)
            for _ in range(len(self.group_error) + 1):
                new = height.copy()
                np.maximum.at(new, self.origin[made], height[self.group[made]] + 1)
                if (new == height).all():
                    break
                height = new
            else:
                raise AssertionError("the DAG has a cycle")
            of_cluster = height[self.group]
            rounds = [np.flatnonzero(of_cluster == h) for h in range(int(of_cluster.max()) + 1)]
            object.__setattr__(self, "_order", rounds)
        return self._order  # type: ignore[attr-defined]
