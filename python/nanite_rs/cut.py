"""A cut: one mesh, picked out of all levels of detail by the rule of the cut."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from nanite_rs import _advice, _checks, _colors, _exchange, _export, _face_data, _notebook, _trimesh, io
from nanite_rs._channels import CutChannels

if TYPE_CHECKING:
    from collections.abc import Mapping

    import trimesh
    from numpy.typing import NDArray

    from nanite_rs import _core
    from nanite_rs._export_packing import Compression
    from nanite_rs.material import Material

__all__ = ["Cut"]


class Cut(_advice.Teaching):
    """The clusters of one threshold as a mesh, finished for its budget if it has one. Made by `NaniteMesh.cut`.

    Vertices are welded by stored identity, never by distance, so a cut has no border where its source has none; two
    sheets may meet in an edge, which then has four faces. All arrays are the caller's own: contiguous and writable.
    Notebooks show cuts of up to 250,000 triangles as a small picture, each triangle shaded as it lies. `decimate`
    makes such a mesh too, of no cluster.

    Attributes
    ----------
    vertices : (N, 3) float32 or float64 array
        Positions in the caller's space; float64 when the source needed it.
    faces : (M, 3) int32 array
        Triangles, counter-clockwise seen from the front.
    normals : (N, 3) float32 array
        Unit normals.
    colors : (N, 4) uint8 array or None
        Vertex colours, linear RGBA.
    fine_colors : (N, 4) uint8, uint16 or float32 array or None
        The same as precise as the source has them, white 255, 65,535 or 1; `colors` itself where they are bytes.
    uvs : list of (N, 2) float32 arrays
        UV sets, as many as the source had.
    channels : mapping of names to (N,) or (N, K) arrays
        Named channels, with the dimensions given: float32, or labels of the dtype given. Each is read when it is
        first looked up, which raises `FormatError` if the file that the mesh was opened from is damaged there.
        Labels of faces are there too (`face_channels`).
    error : float
        No point of the cut is farther from the source surface, and no point of the source from the cut, in the
        units of the mesh: proven and rounded up (docs/numerics.md). With ``error="quadric"`` an estimate, and
        often too low. 0 at full detail. Infinite where `decimate` made it and nothing was proven.
    attribute_error : float
        How far normals that were given, colours, UVs, channels and materials are off, as a length in the units of
        the mesh: a deviation of one unit counts as its weight in `BuildOptions` times the mean edge length of the
        triangles that were replaced. Bounds of all points of both surfaces, proven for each step of simplification,
        rounded up and added up (docs/numerics.md); 0 at full detail and for meshes that carry none of these.
    cluster_ids : (C,) uint32 array
        Addresses of the clusters. Triangles that were made for a budget are in none: they come last, with a row of
        2³² − 1 for each of their materials and levels.
    cluster_levels : (C,) uint8 array
        Level of each cluster: times its surface was simplified, 0 for the source; of made triangles one more.
    cluster_materials : (C,) int32 array or None
        Material of each cluster, as given with ``face_materials``.
    materials : tuple of Material
        The looks of the mesh: that of face material n is the n-th, or the last where there are fewer. Empty where
        the mesh has none.
    vertex_ids : (N,) uint32 array
        Stored identities of the vertices: the same vertex has the same identity in every cut of a mesh. Vertices
        that were made for a budget have larger ones, which other cuts give to other vertices.

    Examples
    --------
    >>> mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=20_000))
    >>> cut = mesh.cut(target_faces=1_000)
    >>> 998 <= len(cut) == len(cut.faces) <= 1_000
    True
    >>> cut.to_trimesh().is_watertight
    True
    """

    __slots__ = (
        "_face_names",
        "_first_face",
        "attribute_error",
        "channels",
        "cluster_ids",
        "cluster_levels",
        "cluster_materials",
        "colors",
        "error",
        "faces",
        "fine_colors",
        "materials",
        "normals",
        "uvs",
        "vertex_ids",
        "vertices",
    )

    def __init__(self, core: _core.Cut, materials: tuple[Material, ...] = ()) -> None:
        self.vertices: NDArray[np.float32] | NDArray[np.float64] = core.vertices
        self.faces: NDArray[np.int32] = core.faces
        self.normals: NDArray[np.float32] = core.normals
        self.fine_colors: NDArray[Any] | None = core.colors
        self.colors: NDArray[np.uint8] | None = (
            None if self.fine_colors is None else _colors.as_bytes(self.fine_colors)
        )
        self.uvs: list[NDArray[np.float32]] = core.uvs
        layout, self._face_names = _face_data.layout(rows.name for rows in core.channels)
        self.channels: Mapping[str, NDArray[Any]] = CutChannels(core.channels)
        self.error: float = core.error
        self.attribute_error: float = core.attribute_error
        self.cluster_ids: NDArray[np.uint32] = core.cluster_ids
        self.cluster_levels: NDArray[np.uint8] = core.cluster_levels
        numbers = core.cluster_materials
        self.cluster_materials: NDArray[np.int32] | None = (
            numbers if layout is None else layout.materials_of(numbers)
        )
        self.vertex_ids: NDArray[np.uint32] = core.vertex_ids
        self.materials: tuple[Material, ...] = materials
        self._first_face: NDArray[np.uint32] = core.first_face

    def __len__(self) -> int:
        """Return the number of triangles."""
        return len(self.faces)

    def __repr__(self) -> str:
        """Sizes and error."""
        return (
            f"Cut({len(self.faces):,} faces, {len(self.vertices):,} vertices, "
            f"{len(self.cluster_ids):,} clusters, error {self.error:.4g})"
        )

    def _repr_png_(self) -> bytes | None:
        """Return a picture for notebooks; None, so that they show the text, where there is too much to draw."""
        return _notebook.png(self)

    @property
    def face_clusters(self) -> NDArray[np.uint32]:
        """For each face the row of its cluster in `cluster_ids`: (M,) uint32."""
        counts = np.diff(self._first_face)
        return np.repeat(np.arange(len(counts), dtype=np.uint32), counts)

    @property
    def face_levels(self) -> NDArray[np.uint8]:
        """For each face the level of its cluster: (M,) uint8."""
        return np.repeat(self.cluster_levels, np.diff(self._first_face))

    @property
    def face_materials(self) -> NDArray[np.int32] | None:
        """For each face its material: (M,) int32; None when the mesh was given none.

        Examples
        --------
        >>> vertices, faces = nrs.shapes.icosphere(faces=20_000)
        >>> material = (vertices[faces].mean(axis=1)[:, 2] > 0.0) + 5
        >>> mesh = nrs.NaniteMesh.from_arrays(vertices, faces, face_materials=material)
        >>> np.unique(mesh.cut(target_reduction=0.9).face_materials).tolist()
        [5, 6]
        """
        if self.cluster_materials is None:
            return None
        return np.repeat(self.cluster_materials, np.diff(self._first_face))

    @property
    def face_channels(self) -> Mapping[str, NDArray[Any]]:
        """What faces carry, by name: (M,) or (M, K) labels, exactly those of the source's faces there.

        They are in `channels` too, as labels of vertices: all corners of a face have those of the face.

        Examples
        --------
        >>> vertices, faces = nrs.shapes.icosphere(faces=20_000)
        >>> north = vertices[faces].mean(axis=1)[:, 2] > 0.0
        >>> mesh = nrs.NaniteMesh.from_arrays(vertices, faces, face_channels={"half": north.astype(np.uint8) + 5})
        >>> cut = mesh.cut(target_reduction=0.9)
        >>> half = cut.face_channels["half"]
        >>> half.dtype, len(half) == len(cut)
        (dtype('uint8'), True)
        >>> z = cut.vertices[cut.faces].mean(axis=1)[:, 2]
        >>> bool((z[half == 6] > -0.1).all() and (z[half == 5] < 0.1).all())
        True
        """
        return _face_data.FaceChannels(self.channels, self._face_names, self.faces)

    @property
    def _vertex_channels(self) -> dict[str, NDArray[Any]]:
        """Channels without those of faces."""
        return {name: self.channels[name] for name in self.channels if name not in self._face_names}

    def to_trimesh(self, *, process: bool = False) -> trimesh.Trimesh:
        """Convert to a `trimesh.Trimesh` with normals, colours, the first UV set, materials and channels.

        Materials become a ``PBRMaterial``, or a ``MultiMaterial`` with one for each; colours beside UVs or
        materials lie in ``visual.vertex_attributes["color"]``. Transforms of textures are applied to the UVs.
        Face materials are the face attribute ``face_materials`` too. What trimesh has no place for is named in
        a warning. A GLB that it writes of that has the first of several materials; `export` writes all.

        Parameters
        ----------
        process : bool
            Let trimesh merge vertices by position. Off by default: a cut is clean already.
        """
        return _trimesh.made(self, process=process)

    def export(self, path: io.PathLike, *, compression: Compression | None = None) -> None:
        """Write a file that other programs read, in the format of its ending.

        ``.glb`` and ``.gltf`` (with a ``.bin`` beside it) hold everything: normals, colours, all UV sets,
        materials with their textures, samplers and transforms, and channels as attributes that begin with an
        underscore; images are written as the files that they were read from where these were PNG or JPEG.
        ``.obj`` has a ``.mtl`` and images beside it. ``.ply`` holds colours, UVs, channels and face materials,
        ``.stl`` and ``.off`` the surface alone. ``.usda``, ``.usdc`` and ``.usdz`` hold preview surfaces, and
        channels as primvars, with the extra ``usd``. Other endings are written by trimesh. What a format cannot
        hold is named in a warning.

        Parameters
        ----------
        path : path
            The file. It is replaced in one step or not at all.
        compression : {None, "quantized", "meshopt", "meshopt-khr"}
            How glTF is made smaller. "quantized" has positions as steps of 1/65,532 of the size of the surface,
            normals of 8 bits and UVs between 0 and 1 of 16 bits (``KHR_mesh_quantization``). "meshopt" encodes that
            by meshoptimizer's codecs (``EXT_meshopt_compression``); "meshopt-khr" by their successors, which few
            readers know yet (``KHR_meshopt_compression``). Faces and vertices have another order then.

        Raises
        ------
        ArgumentError
            ``compression`` is unknown, or the format has none.
        FormatError
            The ending is unknown.
        FileError
            The file cannot be written.
        DependencyError
            An optional package is missing.

        Examples
        --------
        >>> clay = nrs.Material(base_color=(0.7, 0.6, 0.5), roughness=0.9)
        >>> mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=2_000), materials=clay)
        >>> mesh.cut(target_faces=200).export("ball.glb")
        >>> nrs.NaniteMesh.from_file("ball.glb").materials == (clay,)
        True
        """
        _export.export(self, _checks.path_of(path), compression)

    def to_pyvista(self, *, textured: bool = False) -> Any:
        """Convert to a `pyvista.PolyData` with normals, colours, the first UV set, channels and face data.

        Parameters
        ----------
        textured : bool
            Instead return a list of ``(PolyData, pyvista.Texture or None)``, one for each material that faces
            have: a PolyData holds no image. Its UVs are those by which the texture of the base colour lies.

        Raises
        ------
        DependencyError
            PyVista is not installed.

        Examples
        --------
        >>> mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=20_000))
        >>> mesh.cut(target_faces=1_000).to_pyvista().is_manifold
        True

        To show all that is textured: ``for part, texture in cut.to_pyvista(textured=True):
        plotter.add_mesh(part, texture=texture)``.
        """
        textured = _checks.truth(textured, "textured")
        return _exchange.to_pyvista_parts(self) if textured else _exchange.to_pyvista(self)

    def to_open3d(self) -> Any:
        """Convert to an Open3D ``TriangleMesh`` with normals, colours, the first UV set and face materials.

        Where materials have textures, ``textures`` holds an image for each of them, which
        ``triangle_material_ids`` count: that of the base colour, or one texel of it. UVs are those by which they
        lie.

        Raises
        ------
        DependencyError
            Open3D is not installed.
        """
        return _exchange.to_open3d(self)

    def to_meshio(self) -> Any:
        """Convert to a `meshio.Mesh` with normals, colours, the first UV set, channels and face data.

        It has no place for materials, which a warning says where there are some.

        Raises
        ------
        DependencyError
            meshio is not installed.

        Examples
        --------
        >>> mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=20_000))
        >>> sorted(mesh.cut(target_faces=1_000).to_meshio().point_data)
        ['Normals']
        """
        return _exchange.to_meshio(self)
