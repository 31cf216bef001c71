"""`NaniteMesh`: a triangle mesh as a cluster LOD DAG."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, BinaryIO, Literal

import numpy as np

from nanite_rs import (
    _advice,
    _checks,
    _exchange,
    _export_levels,
    _face_data,
    _material_files,
    _neuroglancer,
    _remote,
    _sources,
    _upload,
    clusters,
    io,
    terrain,
)
from nanite_rs._arrays import as_array, core_arrays
from nanite_rs._core import FINE_PART
from nanite_rs._core import Mesh as CoreMesh
from nanite_rs._geometry import Geometry
from nanite_rs._progress import Progress, reporter
from nanite_rs._rebaking import build as rebaking
from nanite_rs.exceptions import ArgumentError, FormatError, UsageWarning
from nanite_rs.material import Material, several
from nanite_rs.options import BuildOptions, creased, no_options
from nanite_rs.report import BuildReport, CheckReport

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    import trimesh
    from numpy.typing import ArrayLike, NDArray

    from nanite_rs._checks import Precision
    from nanite_rs._export_packing import Compression, ImageFormat
    from nanite_rs.clusters import Clusters
    from nanite_rs.material import Look
    from nanite_rs.report import TilesReport
    from nanite_rs.stats import TrafficStats

__all__ = ["NaniteMesh"]

# Extensions of other formats, which nobody means for a .nanite file.
_OTHERS = (".3mf", ".dae", ".glb", ".gltf", ".obj", ".off", ".ply", ".stl")


class NaniteMesh(Geometry):
    """A triangle mesh of any size as a cluster LOD DAG: every level of detail at once.

    Made by `from_arrays`, `from_trimesh`, `from_file` or `open`; immutable. ``len(mesh)`` is the number of source
    triangles, ``==`` compares content, and meshes can be pickled. Notebooks show a small picture.

    Examples
    --------
    >>> import nanite_rs as nrs
    >>> vertices, faces = nrs.shapes.displaced_icosphere(faces=50_000)
    >>> mesh = nrs.NaniteMesh.from_arrays(vertices, faces)
    >>> len(mesh)
    50000
    >>> coarse = mesh.cut(target_reduction=0.9)
    >>> len(coarse) <= 5_000 and coarse.error > 0.0
    True
    >>> len(mesh.cut(error=0.0))
    50000
    """

    __slots__ = ("_reader", "_report")

    _report: BuildReport | None
    _reader: _remote.Reader | None
    """What reads its file, unless that is a path."""

    def __init__(self, *_: object, **__: object) -> None:
        raise TypeError("use NaniteMesh.from_arrays, from_trimesh, from_file or open")

    @classmethod
    def _wrap(cls, core: CoreMesh, name: str = "<bytes>") -> NaniteMesh:
        """A mesh with the materials of its file, whose name errors say."""
        mesh = object.__new__(cls)
        mesh._core = core
        mesh._materials = _material_files.decoded(
            core.material_table, core.image_count, core.image_file, name
        )
        mesh._report = None
        mesh._reader = None
        return mesh

    # ------------------------------------------------------------------------------------------ making

    @classmethod
    @_advice.teaches(
        vertex_colors="give colors=",
        **dict.fromkeys(("quality", "error", "threads"), "give options=BuildOptions(...)"),
        otherwise="give from_arrays(vertices, faces), or from_trimesh(mesh), or from_file(path)",
    )
    def from_arrays(
        cls,
        vertices: ArrayLike,
        faces: ArrayLike,
        *,
        normals: ArrayLike | None = None,
        colors: ArrayLike | None = None,
        uvs: ArrayLike | Sequence[ArrayLike] | None = None,
        channels: Mapping[str, ArrayLike] | None = None,
        face_materials: ArrayLike | None = None,
        face_channels: Mapping[str, ArrayLike] | None = None,
        materials: Look | None = None,
        options: BuildOptions | None = None,
        progress: Progress = None,
    ) -> NaniteMesh:
        """Build from arrays.

        Degenerate and duplicate faces, unreferenced vertices and zero normals are mended and counted in `report`.
        The interpreter lock is released, Ctrl-C works, and the same input gives the same bytes on any number of
        threads. Do not modify the arrays while this runs.

        Parameters
        ----------
        vertices : (N, 3) float32 or float64 array
            Positions. float64 values that are no float32 are kept about a float64 origin.
        faces : (M, 3) array of any integer type
            Triangles, counter-clockwise seen from the front.
        normals : (N, 3) floating-point array, optional
            Vertex normals of any length; computed, weighted by angle, when missing.
        colors : (N, 3) or (N, 4) array, optional
            Linear vertex colours: uint8, uint16, or floating-point from 0 to 1 (kept as float32). They stay as
            precise as they are, in pictures, cuts and files; bytes take a quarter of the memory of floats.
        uvs : (N, 2) floating-point array or a sequence of up to four, optional
            Texture coordinates.
        channels : mapping of names to (N,) or (N, K) arrays, optional
            Anything else that vertices carry. Floating-point channels (kept as float32) are blended, and steer
            the simplification by their range over the mesh, whatever their unit. Integers and bools are labels,
            which are never blended: every vertex of a cut has the labels of one source vertex, and lines between
            labels are protected. Labels are exact; those of 64 bits must fit 32 (int64 in int32, uint64 in uint32).
        face_materials : (M,) array of any integer type, optional
            The number of each face's material, within the range of int32. Clusters have one material each, and
            lines between materials are kept as seams are.
        face_channels : mapping of names to (M,) or (M, K) arrays, optional
            Integers and bools that faces carry, such as segments: every face of a cut has those of the source's
            faces there, and lines between them are kept as those between materials are (`Cut.face_channels`). All
            together may have up to 4,096 different rows. Floating-point ones become channels of vertices, by means
            weighted with areas, which a `UsageWarning` says.
        materials : Material or sequence of Material, optional
            The look of the mesh, or one for each number of ``face_materials``, of which the last stands for all
            from there on. They stay with the mesh (`materials`) and its cuts.
        options : BuildOptions, optional
            How to build.
        progress : bool or callable, optional
            True for a progress bar, False for none, a callable for ``(done, total)``; by default a bar when
            the build takes longer than a second and stderr is a terminal. Raising in the callable stops the
            build.

        Raises
        ------
        MeshError
            Not finite, an index out of range (with its row), nothing left to build from, or too large.
        ArgumentError, DtypeError
            An array or option has the wrong shape, dtype or range.

        Examples
        --------
        >>> vertices, faces = nrs.shapes.icosphere(faces=20_000)
        >>> part = np.sign(vertices[:, 2]).astype(np.int8)
        >>> mesh = nrs.NaniteMesh.from_arrays(vertices, faces, channels={"part": part, "x": vertices[:, 0]})
        >>> cut = mesh.cut(target_reduction=0.9)
        >>> cut.channels["part"].dtype, sorted(set(cut.channels["part"].tolist()))
        (dtype('int8'), [-1, 0, 1])
        >>> bool(np.abs(cut.channels["x"] - cut.vertices[:, 0]).max() < 0.01)
        True
        """
        vertices = as_array(vertices, "vertices")
        faces = as_array(faces, "faces")
        if not isinstance(options, BuildOptions | None):
            raise no_options(options)
        given = {"normals": normals, "colors": colors, "uvs": uvs, "face_materials": face_materials}
        of_faces = {"face_channels": face_channels}
        looks = () if materials is None else several(materials, "materials")
        try:
            mesh = cls._build(vertices, faces, given | of_faces, channels, looks, options, progress)
        except ArgumentError as error:
            more = _advice.for_arrays(str(error), vertices, faces, given)
            raise (_advice.advised(error, more) if more else _advice.near(error)) from None
        return mesh

    @classmethod
    def _build(
        cls,
        vertices: NDArray[Any],
        faces: NDArray[Any],
        given: dict[str, Any],
        channels: Mapping[str, ArrayLike] | None,
        looks: tuple[Material, ...],
        options: BuildOptions | None,
        progress: Progress,
    ) -> NaniteMesh:
        how = options or BuildOptions()
        arrays = core_arrays(vertices, faces, given, channels)
        if how.rebake == "auto" and rebaking.is_asked_for(arrays, given, looks):
            core, looks = rebaking.build(arrays, how._core(), looks, how.texture_size, progress)
        else:
            with reporter(progress, "building") as report:
                core = CoreMesh.build(arrays, options=how._core(), progress=report)
        mesh = cls._wrap(core)
        mesh._materials = looks
        _look_for_lost_faces(vertices, mesh)
        return mesh

    @classmethod
    def from_trimesh(
        cls,
        mesh: trimesh.Trimesh | trimesh.Scene,
        *,
        options: BuildOptions | None = None,
        progress: Progress = None,
    ) -> NaniteMesh:
        """Build from a `trimesh.Trimesh`, or from a `trimesh.Scene` flattened with its transforms.

        Materials with their textures, vertex and face colours, the UV set, ``vertex_attributes``, and normals and
        face materials that came with the mesh are carried along. Where parts of a scene differ in their material,
        faces have the number of theirs in `materials`. Where they do not, and have face materials, those of each
        part follow those of the part before.

        Parameters
        ----------
        mesh : trimesh.Trimesh or trimesh.Scene
            The mesh.
        options, progress
            As in `from_arrays`.

        Examples
        --------
        >>> import trimesh
        >>> len(nrs.NaniteMesh.from_trimesh(trimesh.creation.icosphere(subdivisions=3)))
        1280
        """
        source = io.from_trimesh(mesh)
        return cls.from_arrays(**source.arrays(), options=options, progress=progress)

    @classmethod
    def from_heightfield(
        cls,
        heights: ArrayLike,
        *,
        spacing: float | tuple[float, float] = 1.0,
        tolerance: float,
        nodata: float | None = None,
        materials: Look | None = None,
        options: BuildOptions | None = None,
        progress: Progress = None,
    ) -> NaniteMesh:
        """Build terrain from an array of heights, by `heightfield`.

        The largest vertical distance of a post is part of all errors: no post is farther from a cut than
        `Cut.error`.

        Parameters
        ----------
        heights, spacing, tolerance, nodata
            As in `heightfield`.
        materials, options, progress
            As in `from_arrays`. Textures lie over the array as one with a texel for each post does.

        Raises
        ------
        ArgumentError, DtypeError, MeshError
            As in `heightfield`.

        Examples
        --------
        >>> x, y = np.meshgrid(np.linspace(-3, 3, 200), np.linspace(-3, 3, 200))
        >>> hill = np.exp(-x * x - y * y)
        >>> mesh = nrs.NaniteMesh.from_heightfield(hill, spacing=0.03, tolerance=0.01)
        >>> bool(mesh.cut(error=0).error <= 0.0101)
        True
        """
        made = terrain.heightfield(heights, spacing=spacing, tolerance=tolerance, nodata=nodata)
        mesh = cls.from_arrays(
            made.vertices, made.faces, uvs=made.uvs, materials=materials, options=options, progress=progress
        )
        mesh._core = mesh._core.with_source_error(made.error)
        return mesh

    @classmethod
    def from_pyvista(
        cls, mesh: Any, *, options: BuildOptions | None = None, progress: Progress = None
    ) -> NaniteMesh:
        """Build from a PyVista data set: the triangles of its surface.

        Normals, texture coordinates, colours (``RGB`` or ``RGBA``), the other point data as channels, and the cell
        data ``face_materials`` are carried along, as are other cell data (``face_channels``).

        Parameters
        ----------
        mesh : pyvista.DataSet
            The mesh.
        options, progress
            As in `from_arrays`.

        Raises
        ------
        MeshError
            No triangles in it.
        DtypeError
            It is something else.

        Examples
        --------
        >>> import pyvista
        >>> len(nrs.NaniteMesh.from_pyvista(pyvista.Sphere(theta_resolution=40, phi_resolution=40)))
        3040
        """
        source = _exchange.from_pyvista(mesh)
        return cls.from_arrays(**source.arrays(), options=options, progress=progress)

    @classmethod
    def from_open3d(
        cls,
        mesh: Any,
        *,
        options: BuildOptions | None = None,
        progress: Progress = None,
    ) -> NaniteMesh:
        """Build from an Open3D mesh, of ``open3d.geometry`` or ``open3d.t.geometry``.

        Vertex normals, vertex colours, ``triangle_uvs`` and ``triangle_material_ids`` are carried along.

        Parameters
        ----------
        mesh : open3d.geometry.TriangleMesh
            The mesh.
        options, progress
            As in `from_arrays`.

        Raises
        ------
        MeshError
            No triangles in it.
        DtypeError
            It is something else.

        Examples
        --------
        >>> import open3d  # doctest: +SKIP
        >>> nrs.NaniteMesh.from_open3d(open3d.io.read_triangle_mesh("dragon.ply"))  # doctest: +SKIP
        """
        source = _exchange.from_open3d(mesh)
        return cls.from_arrays(**source.arrays(), options=options, progress=progress)

    @classmethod
    def from_meshio(
        cls, mesh: Any, *, options: BuildOptions | None = None, progress: Progress = None
    ) -> NaniteMesh:
        """Build from the triangles and quadrilaterals of a meshio mesh.

        Points may have two coordinates. Point data become normals (``Normals``), colours (``RGB`` or ``RGBA``) and
        channels; the cell data ``face_materials`` and others (``face_channels``) are carried along.

        Parameters
        ----------
        mesh : meshio.Mesh
            The mesh.
        options, progress
            As in `from_arrays`.

        Raises
        ------
        MeshError
            No triangles in it.
        DtypeError
            It is something else.

        Examples
        --------
        >>> import meshio
        >>> vertices, faces = nrs.shapes.icosphere(faces=5_000)
        >>> len(nrs.NaniteMesh.from_meshio(meshio.Mesh(vertices, [("triangle", faces)])))
        5120
        """
        source = _exchange.from_meshio(mesh)
        return cls.from_arrays(**source.arrays(), options=options, progress=progress)

    @classmethod
    @_advice.teaches(
        **dict.fromkeys(("file_type", "ext", "type"), "format='glb' says what bytes are"),
        otherwise="give from_file(path), or from_file(data, format='glb')",
    )
    def from_file(
        cls,
        path: io.Readable,
        *,
        format: str | None = None,
        bad_textures: Literal["raise", "drop"] = "drop",
        crease_angle: float | None = None,
        options: BuildOptions | None = None,
        progress: Progress = None,
    ) -> NaniteMesh:
        """Build from a file: glTF, GLB, PLY, OBJ, STL, OFF and whatever else trimesh reads, gzipped or not.

        It is what `load_scene` reads, as one mesh: every instance where it stands, with normals, colours, all UV
        sets, channels and `materials`. Colours have as many bits as in the file. Cameras and lights belong to no
        mesh and are `load_scene`'s. What else has no counterpart is left out or changed, and a single warning
        names it. A ``.nanite`` file is opened as it is.

        Parameters
        ----------
        path : str, bytes or os.PathLike, or a binary file, or bytes, bytearray or memoryview
            The file, an open one, or the content of one. ``bytes`` are taken as content where ``format`` is given,
            or where no path can be like that. Files beside an open one are found by its name; those beside content
            are not.
        format : str, optional
            What the content is, such as ``"glb"`` or ``"ply.gz"``, instead of the ending of the name.
        bad_textures : {"raise", "drop"}
            Whether a texture that is missing, damaged or of an unknown format is an error, or left out with the
            warning.
        crease_angle : float, optional
            As in `BuildOptions`, of a file without normals. STL files, which have none of vertices, get edges where
            faces meet at more than 30 degrees unless it is given: 180 smooths over everything.
        options, progress
            As in `from_arrays`.

        Raises
        ------
        MissingFileError, FileError
            The file, or one that it refers to, cannot be read.
        FormatError
            The extension is unknown, or the content is not what the extension says.
        DependencyError
            The file needs an optional package, such as DracoPy.
        MeshError
            There are no triangles.
        ArgumentError, DtypeError
            It is nothing that can be read, or content of which nothing says what it is.

        Examples
        --------
        >>> import trimesh
        >>> data = trimesh.creation.icosphere(subdivisions=3).export(file_type="glb")
        >>> len(nrs.NaniteMesh.from_file(data, format="glb"))
        1280
        """
        file = io.given_file(path, format)
        if "." + file.format == io.NANITE_SUFFIX:
            if file.path is not None and file.given is None:
                return cls.open(file.path)
            return cls._wrap(CoreMesh.from_bytes(file.data()), file.name)
        source = io.from_file(file, bad_textures=bad_textures)
        options = creased(options, crease_angle, file.format)
        return cls.from_arrays(**source.arrays(), options=options, progress=progress)

    @classmethod
    def open(
        cls,
        path: io.PathLike | BinaryIO,
        *,
        cache_dir: io.PathLike | None = None,
        cache_bytes: int = 4 << 30,
        storage_options: Mapping[str, Any] | None = None,
    ) -> NaniteMesh:
        """Open a ``.nanite`` file that `save` wrote, whatever its size, in milliseconds or two requests.

        What describes the mesh is read. Pages are read when they are needed: by a cut those that it is made of, by
        a `Renderer` with ``streaming=True`` those that its pictures need, by everything else all; and but for those
        of a renderer they stay in memory. For a number of faces a cut reads all pages of files of before that do
        not say how many their groups have. A channel is read when it is looked up in a cut, and
        face ids when `source_face_ids` or a frame is asked for them; `check`, ``==`` and pickling read all.
        `save` reads a few pages at a time, which do not stay.
        The file stays open as long as the mesh and its cuts live; writing another one over it with `save` is safe.

        A mesh may lie anywhere: ``https://``, ``http://``, ``s3://``, ``gs://`` and ``az://`` are read by obstore,
        which ``pip install "nanite_rs[cloud]"`` brings, other URLs by fsspec, if it is installed, and binary files
        of Python by their ``seek`` and ``read``. Pages come many at once, those that lie near each other by one
        request. What fails for a passing reason is tried again. The guide, docs/cloud.md, has more.

        Meshes of URLs are pickled as their URLs. All others are as bytes.

        Parameters
        ----------
        path : path, URL or binary file
            The file. Of an open file the position is changed; nobody else may use it while the mesh lives.
        cache_dir : path, optional
            Of a URL: a folder where pages are kept, made if need be. Several processes may share it.
        cache_bytes : int
            Bytes that all files in ``cache_dir`` take at most; what was used least recently goes.
        storage_options : mapping, optional
            Of a URL: what obstore's ``from_url`` or the file system of fsspec takes, such as credentials. Without
            it they find them where they always do.

        Raises
        ------
        MissingFileError, FileError
            The file cannot be read.
        AccessError
            The server asks for credentials, or does not take these: 401 or 403.
        ServerError
            The server cannot be reached, or answers with an error, without ranges, or with wrong lengths.
        ChangedFileError
            When pages are read: another file has taken the place of the one that was opened.
        DependencyError
            An optional package is missing.
        FormatError
            The file is damaged, of another version, or something else. A page or channel that is damaged raises
            this when it is needed; a renderer that streams draws coarser clusters instead.

        Examples
        --------
        >>> import io, tempfile, pathlib
        >>> mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=2_000))
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder) / "sphere.nanite"
        ...     mesh.save(path)
        ...     opened = nrs.NaniteMesh.open(io.BytesIO(path.read_bytes()))
        >>> len(opened.cut(error=0.0)) == len(mesh)
        True
        >>> nrs.NaniteMesh.open("https://example.org/city.nanite", cache_dir="pages")  # doctest: +SKIP
        """
        if not _sources.is_url(path) and not _sources.is_file(path):
            _sources.checked_options(path, storage_options, cache_dir)
            path = _checks.path_of(path)
            try:
                return cls._wrap(CoreMesh.open(path), path)
            except FormatError as error:
                if "at byte 0" not in str(error):
                    raise
                raise _advice.advised(error, _advice.for_file(path)) from None
        return cls._opened(_remote.opened(path, cache_dir, cache_bytes, storage_options))

    @classmethod
    def _opened(cls, reader: _remote.Reader) -> NaniteMesh:
        mesh = cls._wrap(reader.open(CoreMesh.open_input), reader.source.name)
        mesh._reader = reader
        return mesh

    def save(
        self,
        path: io.PathLike,
        *,
        precision: Precision = "auto",
        storage_options: Mapping[str, Any] | None = None,
    ) -> None:
        """Write a ``.nanite`` file; an existing one is replaced in one step or not at all.

        Positions of all levels are rounded to one grid, of which the step is a power of two, normals to 10 bits per
        octahedral coordinate, which is a quarter of a degree, and UVs to multiples of 2^-16, unless some are beyond
        ±256: then they stay, as colours and channels do. Cuts stay closed. The distance that positions moved is in
        `Cut.error` of the mesh that is opened again, and in its `info` with the angle of the normals and the
        difference of UVs. Saving what was opened loses nothing more.

        Bytes go to a temporary file beside the target, are synced to disk, and then take its name: whenever the
        process ends, the target is the old file or the new one, whole. A process that is killed leaves its
        temporary file, ``.nanite-*.tmp``, which nothing reads and anyone may delete.

        A URL of a store, such as ``s3://``, is written in parts by obstore, others by fsspec. Whether a store can
        be written is tried out first. The file is made among temporary files and then sent. It is seen when it is
        whole; until then, and where sending fails or is stopped, the store has what it had. What could not be sent
        is kept, and the error says where. The guide, docs/cloud.md, has more.

        Files hold `materials` and their images as these were encoded, each once; arrays of bytes become PNG.

        Parameters
        ----------
        path : path or URL
            The file.
        precision : "auto", "exact" or float
            "auto": steps of a sixteenth of the median edge of the source or less, and of an eighth of the height
            over the longest edge that 199 of 200 triangles have, or a neighbour of theirs: strips and small parts
            of CAD meshes keep their shape and area, slivers between larger triangles may lose theirs. "exact":
            everything as it is, in files some twice as large. A number: steps of so many units of the mesh or less.
            Where f32 is as coarse as the grid would be, the file is exact.
        storage_options : mapping, optional
            Of a URL: as for `open`.

        Raises
        ------
        ArgumentError, DtypeError
            The precision is none of these.
        FormatError
            The name ends as that of a mesh in another format, such as ``.ply``.
        FileError
            The file cannot be written.
        MissingFileError, AccessError, ServerError, DependencyError
            Of a URL: there is no such bucket, credentials are missing or do not allow writing, the server cannot
            be reached or answers with an error, or an optional package is missing.

        Warns
        -----
        UsageWarning
            More than one of 200 faces has no area on the grid.

        Examples
        --------
        >>> import tempfile, pathlib
        >>> mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=2_000))
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder) / "sphere.nanite"
        ...     mesh.save(path, precision="exact")
        ...     exact = nrs.NaniteMesh.open(path)
        ...     mesh.save(path)
        ...     small = nrs.NaniteMesh.open(path)
        >>> exact == mesh, small == mesh
        (True, False)
        >>> 0.0 < small.cut(error=0.0).error == small.info["rounding"] < small.info["precision"]
        True
        >>> mesh.save("memory://meshes/sphere.nanite", precision="exact")
        >>> nrs.NaniteMesh.open("memory://meshes/sphere.nanite") == mesh
        True
        """
        path = _checks.path_of(path)
        name, ending = _sources.shown(path), _sources.ending(path)
        if ending in _OTHERS:
            raise FormatError(
                f"{name}: save writes .nanite files; mesh.cut(error=0).export(path) writes {ending}"
            )
        how, step = _checks.precision(precision)
        # What was opened has those of its file, which need not be read to be written.
        looks = None if self._core.material_table else _material_files.encoded(self._materials)
        with _upload.written(path, storage_options) as file:
            flattened = self._core.save(file, how, step, looks)
        if flattened > len(self) / FINE_PART:
            _advice.warn(
                f"precision: {flattened:,} of {len(self):,} faces have no area in {name}, whose grid is too coarse "
                'for them; give precision="exact", or a smaller number',
                UsageWarning,
            )

    def export(
        self,
        path: io.PathLike,
        *,
        levels: Iterable[float] | None = None,
        errors: Iterable[float] | None = None,
        separate: bool = False,
        pixel_error: float = 1.0,
        fit_textures: bool | None = None,
        compression: Compression | None = None,
        images: ImageFormat | None = None,
    ) -> list[str]:
        """Write levels of detail for other programs: one glTF file with all of them, or a file for each.

        One file has the extension ``MSFT_lod``: a node with the finest level, which programs show that do not know
        it, names the others, and ``MSFT_screencoverage`` says from which part of the screen on, by area, each is
        shown. It follows from proven errors: on a screen of 1920 × 1080 pixels that shows 60° from its lower to its
        upper edge, no level is off by more than ``pixel_error`` pixels. ``extras`` of nodes have the proven error
        of each, in units of the mesh, and its triangles. Levels share materials and images.

        Parameters
        ----------
        path : path
            The file, ``.glb`` or ``.gltf``. With ``separate`` any that `Cut.export` writes: each level gets
            ``_lod0``, ``_lod1`` and so on behind its name. A file of one level is written as by `Cut.export`.
        levels : iterable of float
            The parts of the faces that each level keeps, the finest first: 1 is all. Without levels and errors the
            file has all faces, as that of ``mesh.cut(error=0)``.
        errors : iterable of float
            Instead: the largest error of each level, in units of the mesh, the finest first.
        separate : bool
            A file for each level.
        pixel_error : float
            Pixels by which what is shown may be off.
        fit_textures : bool, optional
            Whether levels after the first have smaller images, halved as often as leaves a texel for each pixel
            where the level begins; colours are averaged in linear light, and what was JPEG is JPEG again. By
            default levels of one file share the images of the first, and those of separate files are fitted.
        compression : {None, "quantized", "meshopt", "meshopt-khr"}
            How glTF is made smaller, as for `Cut.export`. Errors in ``extras`` have what it moves vertices by.
        images : {None, "jpeg", "png", "webp", "ktx2"}
            What images of glTF are encoded as; by default they stay as they were. "webp"
            (``EXT_texture_webp``) has normals and the like without loss. "ktx2" (``KHR_texture_basisu``) is what
            devices keep in memory as it is, a quarter to an eighth of the pixels: Basis Universal, ETC1S for
            colours and UASTC for everything else, with all smaller versions. Sides become multiples of four.

        Returns
        -------
        list of str
            The paths of the files.

        Raises
        ------
        ArgumentError, DtypeError
            Levels are out of range or order, or a format holds one level.
        FormatError, FileError, DependencyError
            As for `Cut.export`.

        Examples
        --------
        >>> mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.torus_knot(faces=30_000))
        >>> mesh.export("knot.glb", levels=[1.0, 0.2, 0.04])
        ['knot.glb']
        >>> mesh.export("knot.ply", errors=[0.01, 0.05], separate=True)
        ['knot_lod0.ply', 'knot_lod1.ply']
        """
        separate = _checks.truth(separate, "separate")
        pixel_error = _checks.number(pixel_error, "pixel_error")
        fit = separate if fit_textures is None else _checks.truth(fit_textures, "fit_textures")
        path = _checks.path_of(path)
        return _export_levels.export(
            self, path, levels, errors, separate, pixel_error, fit, compression, images
        )

    def to_3dtiles(
        self,
        folder: io.PathLike,
        *,
        triangles: int = 30_000,
        compression: Compression | None = "meshopt",
        images: ImageFormat | None = None,
        skirts: bool = True,
        pixel_error: float = 16.0,
        up: Literal["y", "z"] | None = None,
        crs: Any = None,
        transform: ArrayLike | None = None,
        preview: bool = False,
        workers: int | None = None,
        overwrite: bool = False,
        storage_options: Mapping[str, Any] | None = None,
        progress: Progress = None,
    ) -> TilesReport:
        """Write 3D Tiles 1.1: a tree of GLB files that CesiumJS, three.js and others stream.

        Each level is a cut for one error, which is clipped at the planes of boxes; boxes are halved until a
        tile has about as many triangles as asked for, so that there are more of them where there is more
        detail. Tiles of a level have the same vertices where they meet. ``geometricError`` is a proven bound:
        no point of a tile is farther from the source, in units of the mesh, with what compression moves
        vertices by. Tiles replace each other (``REPLACE``). Between levels, skirts hide what is left: strips
        along the planes, against the normals, as long as the two bounds together; their length is among the
        metadata of each tile, with its bounds and triangles.

        Positions are float64: each tile has an origin of its own in ``transform``, and small numbers about it. An
        opened file is read tile by tile, so that it may be larger than memory; the files do not depend on the
        number of workers. ``tileset.json`` is written last.

        Parameters
        ----------
        folder : path or URL
            Where the files go; it is made if need be. A URL as for `save`.
        triangles : int
            Triangles of a tile, about, at most.
        compression : {"meshopt", "quantized", "meshopt-khr", None}
            As for `Cut.export`. Positions are rounded to one grid for each level.
        images : {None, "jpeg", "png", "webp", "ktx2"}
            As for `export`.
        skirts : bool
            Whether tiles have skirts.
        pixel_error : float
            The screen-space error, in pixels, that a viewer allows: what CesiumJS calls
            ``maximumScreenSpaceError``. Images are as fine as a tile can show until it is replaced.
        up : {"z", "y"}, optional
            Which axis of the mesh points up: z by default.
        crs : optional
            The coordinate reference system of the mesh, projected or geocentric, as pyproj knows it, such as
            ``"EPSG:32632"``, with the extra ``geo``: vertices are taken to the globe one by one, bounding volumes
            are regions, and errors metres, with what the map stretches.
        transform : (4, 4) array, optional
            Instead: where the tiles are, such as the pose of a local frame on the globe.
        preview : bool
            Write a page, too, ``index.html``, which shows the tiles from any static server, such as
            ``python -m http.server``: 3d-tiles-renderer and three.js, which the browser fetches from jsDelivr.
        workers : int, optional
            Threads; by default as many as `get_num_threads` says.
        overwrite : bool
            Replace a tileset that is there.
        storage_options : mapping, optional
            As for `save`.
        progress : bool or callable, optional
            As for `from_arrays`.

        Returns
        -------
        TilesReport
            The path of ``tileset.json``, and how much was written.

        Raises
        ------
        ArgumentError, DtypeError
            An argument is out of range, or ``crs`` is unknown or has angles.
        FileError
            A tileset is there already, or files cannot be written.
        DependencyError
            pyproj is missing.

        Examples
        --------
        >>> mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.torus_knot(faces=30_000))
        >>> report = mesh.to_3dtiles("knot", triangles=4_000)
        >>> report.tiles > 8 and report.levels > 1
        True
        """
        from nanite_rs._tiles import of_mesh

        how = of_mesh.how(triangles, compression, images, skirts, pixel_error, preview, workers)
        return of_mesh.export(self, folder, how, up, crs, transform, storage_options, overwrite, progress)

    def to_neuroglancer(
        self,
        folder: io.PathLike,
        segment: int,
        *,
        triangles: int = 10_000,
        quantization_bits: int = 16,
        unit: float = 1.0,
        workers: int | None = None,
        progress: Progress = None,
    ) -> list[float]:
        """Write a segment of multi-resolution meshes as neuroglancer reads them (``neuroglancer_multilod_draco``).

        Each level is a cut for one error, clipped at the boxes of a grid: fragments of Draco, by DracoPy (extra
        ``io``), whose triangles stay within their octants. ``lod_scales`` are proven errors, so that neuroglancer
        shows the coarsest level that is off by no more than a pixel. Several segments go into one folder, whose
        ``info`` they have in common. Surfaces alone are written.

        Parameters
        ----------
        folder : path
            The folder of the meshes; it is made if need be.
        segment : int
            The number of the segment, which its two files are named by.
        triangles : int
            Triangles of a fragment, about, at most.
        quantization_bits : {16, 10}
            Bits of a coordinate in its fragment.
        unit : float
            Nanometres of a unit of the mesh.
        workers : int, optional
            Threads; by default as many as `get_num_threads` says.
        progress : bool or callable, optional
            As for `from_arrays`.

        Returns
        -------
        list of float
            The proven error of each level in nanometres, the finest first, with the rounding of positions.

        Raises
        ------
        ArgumentError, DtypeError
            An argument is out of range.
        FileError
            The folder holds other meshes, or cannot be written.
        DependencyError
            DracoPy is missing.

        Examples
        --------
        >>> mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.torus_knot(faces=30_000))
        >>> errors = mesh.to_neuroglancer("meshes", 7, triangles=2_000, unit=1_000.0)
        >>> len(errors) > 1 and errors == sorted(errors)
        True
        """
        given = _neuroglancer.checked(segment, triangles, quantization_bits, unit, workers)
        return _neuroglancer.write(self, _checks.path_of(folder, "folder"), progress=progress, **given)

    @staticmethod
    def file_info(
        path: io.PathLike | BinaryIO, *, storage_options: Mapping[str, Any] | None = None
    ) -> dict[str, Any]:
        """Sizes and bounds of a ``.nanite`` file as in `info`, of which only the beginning is read.

        Here ``bytes`` are those of the file, and ``parts`` says what they are about.

        Parameters
        ----------
        path : path, URL or binary file
            The file, as for `open`.
        storage_options : mapping, optional
            As for `open`.

        Raises
        ------
        MissingFileError, FileError, AccessError, ServerError, DependencyError, FormatError
            As for `open`.

        Examples
        --------
        >>> import tempfile, pathlib
        >>> mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=2_000))
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     mesh.save(pathlib.Path(folder) / "sphere.nanite")
        ...     info = nrs.NaniteMesh.file_info(pathlib.Path(folder) / "sphere.nanite")
        >>> info["faces"] == len(mesh), info["bytes"] == sum(info["parts"].values())
        (True, True)
        """
        if _sources.is_url(path) or _sources.is_file(path):
            info = _remote.opened(path, None, 0, storage_options).open(CoreMesh.input_info)
        else:
            info = CoreMesh.file_info(_checks.path_of(path))
        return info | {"channels": [_face_data.plain(name) for name in info["channels"]]}

    # ----------------------------------------------------------------------------------------- cutting

    # ------------------------------------------------------------------------------------------ asking

    @property
    def report(self) -> BuildReport:
        """What building was given, mended and made."""
        if self._report is None:
            self._report = BuildReport._from_json(self._core.report_json())
        return self._report

    def check(self) -> CheckReport:
        """Verify every invariant of the DAG.

        Returns
        -------
        CheckReport
            How much of everything was verified.

        Raises
        ------
        InvariantError
            With the first cluster, group or node at fault: a bug, or a damaged file.
        """
        return CheckReport(**self._core.check())

    def clusters(self) -> Clusters:
        """Return all clusters of all levels as arrays, for a renderer of one's own.

        Of an opened file, all of it is read.

        Returns
        -------
        Clusters

        Raises
        ------
        FileError, AccessError, ServerError, ChangedFileError, FormatError
            The file cannot be read, or is damaged.

        Examples
        --------
        >>> all = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=20_000)).clusters()
        >>> first = slice(all.triangle_offsets[0], all.triangle_offsets[1])
        >>> corners = all.vertices[all.vertex_offsets[0] + all.triangles[first].astype(int)]
        >>> corners.shape[1:]
        (3, 3)
        """
        return clusters.of_mesh(self)

    @property
    def source_face_ids(self) -> NDArray[np.uint32] | None:
        """For each face of the full-detail cut its row of the caller's ``faces``: (M,) uint32.

        None unless built with ``BuildOptions(face_ids=True)``. Of an opened file they are read when they are first
        asked for, which raises `FormatError` where it is damaged.
        """
        return self._core.source_face_ids()

    @property
    def traffic(self) -> TrafficStats | None:
        """What reading the file has cost so far; None unless it was opened by a URL or of a file object.

        `StreamStats` has the same for single frames.

        Examples
        --------
        >>> import tempfile, pathlib
        >>> mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=2_000))
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     mesh.save(pathlib.Path(folder) / "sphere.nanite")
        ...     with open(pathlib.Path(folder) / "sphere.nanite", "rb") as file:
        ...         print(nrs.NaniteMesh.open(file).traffic.requests)
        1
        """
        return None if self._reader is None else self._reader.stats()

    @property
    def nbytes(self) -> int:
        """Bytes in memory: of an opened file the pages, channels and face ids that were read so far."""
        return self._core.nbytes

    def __repr__(self) -> str:
        """Sizes."""
        core = self._core
        return (
            f"NaniteMesh({core.source_faces:,} faces, {core.source_vertices:,} vertices, "
            f"{core.level_count} levels, {core.cluster_count:,} clusters, {core.nbytes / 1e6:,.1f} MB in memory)"
        )

    def __eq__(self, other: object) -> bool:
        """Compare content: all levels of detail with what they carry, but not the looks."""
        if not isinstance(other, NaniteMesh):
            return NotImplemented
        return self._core.equals(other._core)

    __hash__ = None  # type: ignore[assignment]

    def __copy__(self) -> NaniteMesh:
        """Return itself: meshes are immutable."""
        return self

    def __deepcopy__(self, memo: object) -> NaniteMesh:
        """Return itself: meshes are immutable."""
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle as the URL that it was opened by, or as the bytes of a ``.nanite`` file, with the materials."""
        if self._reader is not None and self._reader.recipe is not None:
            return _from_url, (self._reader.recipe, self._reader.identity)
        return _from_bytes, (self._core.to_bytes(), () if self._core.material_table else self._materials)


def _from_url(recipe: tuple[Any, ...], identity: Any) -> NaniteMesh:
    """Open it again, if it is the same file."""
    reader = _remote.opened(*recipe)
    reader.expect(identity)
    return NaniteMesh._opened(reader)


def _from_bytes(data: bytes, materials: tuple[Material, ...] = ()) -> NaniteMesh:
    mesh = NaniteMesh._wrap(CoreMesh.from_bytes(data))
    mesh._materials = mesh._materials or materials
    return mesh


def _look_for_lost_faces(vertices: NDArray[Any], mesh: NaniteMesh) -> None:
    """Warn where float32 so far from the origin leaves no area to many faces."""
    report = mesh.report
    lost = report.degenerate_faces + report.duplicate_faces
    if lost < 0.05 * report.input_faces or (vertices != vertices.astype(np.float32)).any():
        return
    size = float(np.max(mesh.bounds[1] - mesh.bounds[0]))
    away = float(np.abs(mesh.bounds).max())
    if size < 1e4 * float(np.spacing(np.float32(away))):
        _advice.warn(
            f"vertices: {lost:,} of {report.input_faces:,} faces have no area: float32 has too few digits "
            f"{away:.3g} from the origin; give float64, or subtract an offset before",
            UsageWarning,
        )
