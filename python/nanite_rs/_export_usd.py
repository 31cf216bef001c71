"""Surfaces and scenes as USD, by usd-core: layers in text or bytes, and packages with their images."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from nanite_rs import _advice, _colors
from nanite_rs._export_parts import COLORS, image_file, image_key, near, pieces, textures

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from nanite_rs._asset import Notes
    from nanite_rs._export_packing import Packing
    from nanite_rs._export_parts import Piece, Surface
    from nanite_rs.light import Light
    from nanite_rs.material import Material
    from nanite_rs.texture import Image, Texture

ENDINGS: Final = ("usd", "usda", "usdc", "usdz")

# Outputs of a texture, and the inputs of a preview surface that they go to.
_SLOTS: Final = {
    "base_color_texture": (("rgb", "diffuseColor"),),
    "metallic_roughness_texture": (("g", "roughness"), ("b", "metallic")),
    "normal_texture": (("rgb", "normal"),),
    "occlusion_texture": (("r", "occlusion"),),
    "emissive_texture": (("rgb", "emissiveColor"),),
}


class Document:
    """A stage with a class for each mesh, and instances of them."""

    def __init__(self, notes: Notes, path: str, packing: Packing | None = None) -> None:  # noqa: ARG002
        try:
            from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, Vt
        except ImportError as error:
            raise _advice.missing(path, "usd-core") from error
        self._gf, self._sdf, self._usd, self._geom, self._shade, self._vt = (
            Gf,
            Sdf,
            Usd,
            UsdGeom,
            UsdShade,
            Vt,
        )
        self._notes, self._path = notes, Path(path)
        self._stage = Usd.Stage.CreateInMemory()
        UsdGeom.SetStageUpAxis(self._stage, UsdGeom.Tokens.y)
        UsdGeom.SetStageMetersPerUnit(self._stage, 1.0)
        self._stage.SetDefaultPrim(UsdGeom.Xform.Define(self._stage, "/scene").GetPrim())
        # Images by their names beside the file.
        self._images: dict[str, bytes] = {}
        self._names: dict[tuple[int, bool], str] = {}
        # What takes positions of meshes, as they are stored, to where they are.
        self._frames: list[NDArray[np.float64]] = []

    # ----------------------------------------------------------------------------------- meshes and nodes

    def mesh(self, surface: Surface) -> int:
        """Add a surface; return its number."""
        vertices, frame = near(surface.vertices)
        number, root = self._class(frame)
        for k, piece in enumerate(pieces(surface)):
            self._piece(f"{root}/piece_{k}", f"{root}/material_{k}", vertices, surface, piece)
        return number

    def strokes(
        self,
        positions: NDArray[np.floating[Any]],
        segments: NDArray[np.uint32] | None,
        colors: NDArray[Any] | None,
        look: Material,
    ) -> int:
        """Add points, or lines; return their number."""
        rows, frame = near(positions)
        number, root = self._class(frame)
        path, geom = f"{root}/strokes", self._geom
        if segments is None:
            shape = geom.Points.Define(self._stage, path)
        else:
            shape = geom.BasisCurves.Define(self._stage, path)
            shape.CreateTypeAttr(geom.Tokens.linear)
            shape.CreateCurveVertexCountsAttr(
                self._vt.IntArray.FromNumpy(np.full(len(segments), 2, np.int32))
            )
            rows = rows[segments.reshape(-1)]
            colors = None if colors is None else colors[segments.reshape(-1)]
        shape.CreatePointsAttr(self._vectors(rows))
        shape.CreateExtentAttr(self._vectors(np.stack([rows.min(axis=0), rows.max(axis=0)])))
        tint = np.array(look.base_color[:3], np.float32)
        painted = np.broadcast_to(tint, (1, 3)) if colors is None else _colors.unit(colors[:, :3]) * tint
        shown = shape.CreateDisplayColorPrimvar(
            geom.Tokens.constant if colors is None else geom.Tokens.vertex
        )
        shown.Set(self._vectors(painted))
        return number

    def _class(self, frame: NDArray[np.float64]) -> tuple[int, str]:
        """Begin what has instances; return its number and its path."""
        number = len(self._frames)
        self._frames.append(frame)
        path = f"/mesh_{number}"
        self._stage.CreateClassPrim(path)
        return number, path

    def place(self, number: int, pose: NDArray[np.float64], name: str = "") -> None:
        """Add an instance of what has this number."""
        node = self._geom.Xform.Define(self._stage, f"/scene/{name or 'surface'}")
        node.GetPrim().GetReferences().AddInternalReference(f"/mesh_{number}")
        node.GetPrim().SetInstanceable(True)
        pose = pose @ self._frames[number]
        if not np.array_equal(pose, np.eye(4)):
            # Rows are images of axes: vectors stand on the left.
            node.AddTransformOp().Set(self._gf.Matrix4d(*pose.T.reshape(-1).tolist()))

    def shine(self, light: Light, pose: NDArray[np.float64]) -> None:  # noqa: ARG002
        """Note the light: renderers do not agree on the units of those of USD."""
        self._notes.add("lights")

    def _piece(
        self, path: str, look: str, vertices: NDArray[np.float32], surface: Surface, piece: Piece
    ) -> None:
        vt, geom = self._vt, self._geom
        mesh, own = geom.Mesh.Define(self._stage, path), vertices[piece.used]
        mesh.CreatePointsAttr(self._vectors(own))
        mesh.CreateExtentAttr(self._vectors(np.stack([own.min(axis=0), own.max(axis=0)])))
        mesh.CreateFaceVertexCountsAttr(vt.IntArray.FromNumpy(np.full(len(piece.faces), 3, np.int32)))
        mesh.CreateFaceVertexIndicesAttr(vt.IntArray.FromNumpy(piece.faces.reshape(-1).astype(np.int32)))
        mesh.CreateSubdivisionSchemeAttr(geom.Tokens.none)
        mesh.CreateDoubleSidedAttr(piece.material.double_sided)
        if piece.material.smooth:  # without normals faces are flat
            mesh.CreateNormalsAttr(self._vectors(surface.normals[piece.used]))
            mesh.SetNormalsInterpolation(geom.Tokens.vertex)
        values = geom.PrimvarsAPI(mesh)
        types, vertex = self._sdf.ValueTypeNames, geom.Tokens.vertex
        for number, uv in enumerate(surface.uvs):
            rows = vt.Vec2fArray.FromNumpy(np.ascontiguousarray(uv[piece.used], np.float32))
            values.CreatePrimvar(_uv_set(number), types.TexCoord2fArray, vertex).Set(rows)
        painted = surface.fine_colors is not None
        if surface.fine_colors is not None:
            colors = _colors.unit(surface.fine_colors[piece.used]).astype(np.float32)
            factor = np.array([*piece.material.base_color, 1.0][:4], np.float32)
            mesh.CreateDisplayColorPrimvar(vertex).Set(self._vectors(colors[:, :3] * factor[:3]))
            opacity = vt.FloatArray.FromNumpy(np.ascontiguousarray(colors[:, 3] * factor[3]))
            mesh.CreateDisplayOpacityPrimvar(vertex).Set(opacity)
        for name in surface.channels:
            self._channel(values, name, surface.channels[name][piece.used])
        material = self._material(look, piece.material, piece.label, painted=painted)
        self._shade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)

    def _channel(self, values: Any, name: str, rows: NDArray[Any]) -> None:
        """Add values of vertices: floats, or whole numbers."""
        whole = rows.dtype.kind in "iub"
        if whole and rows.size and np.abs(rows.astype(np.int64)).max() >= 1 << 31:
            self._notes.add("labels beyond 2^31", name)
            return
        types = self._sdf.ValueTypeNames
        flat = np.ascontiguousarray(rows.reshape(-1), np.int32 if whole else np.float32)
        kind, of = (types.IntArray, self._vt.IntArray) if whole else (types.FloatArray, self._vt.FloatArray)
        width = 1 if rows.ndim == 1 else rows.shape[1]
        label = "".join(c if c.isascii() and c.isalnum() else "_" for c in name) or "_"
        label = f"_{label}" if label[0].isdigit() else label
        values.CreatePrimvar(label, kind, self._geom.Tokens.vertex, width).Set(of.FromNumpy(flat))

    def _vectors(self, rows: NDArray[Any]) -> Any:
        return self._vt.Vec3fArray.FromNumpy(np.ascontiguousarray(rows, np.float32))

    # --------------------------------------------------------------------------------------------- looks

    def _material(self, path: str, look: Material, label: str, *, painted: bool) -> Any:
        """A preview surface."""
        material = self._shade.Material.Define(self._stage, path)
        material.GetPrim().SetDisplayName(label)
        shader = self._shader(f"{path}/surface", "UsdPreviewSurface")
        types, vector = self._sdf.ValueTypeNames, self._gf.Vec3f
        found = dict(textures(look))
        base, alpha = look.base_color[:3], (*look.base_color, 1.0)[3]
        values: dict[str, tuple[Any, Any]] = {
            "diffuseColor": (types.Color3f, vector(*base)),
            "emissiveColor": (types.Color3f, vector(*look.emissive)),
            "metallic": (types.Float, look.metallic),
            "roughness": (types.Float, look.roughness),
        }
        if look.alpha_mode != "opaque":
            values["opacity"] = (types.Float, alpha)
        if look.alpha_mode == "mask":
            values["opacityThreshold"] = (types.Float, look.alpha_cutoff)
        if look.unlit:
            values["emissiveColor"], values["diffuseColor"] = (
                values["diffuseColor"],
                (types.Color3f, vector(0.0)),
            )
            self._notes.add("unlit materials, which shine there", label)
        for name, (kind, value) in values.items():
            shader.CreateInput(name, kind).Set(value)
        if painted:
            self._paint(path, shader, look)
        scales = {
            "base_color_texture": ((*base, alpha), (0.0, 0.0, 0.0, 0.0)),
            "metallic_roughness_texture": ((1.0, look.roughness, look.metallic, 1.0), (0.0,) * 4),
            "normal_texture": ((2.0, 2.0, 2.0, 1.0), (-1.0, -1.0, -1.0, 0.0)),
            "occlusion_texture": (
                (look.occlusion_strength,) * 3 + (1.0,),
                (1.0 - look.occlusion_strength,) * 3 + (0.0,),
            ),
            "emissive_texture": ((*look.emissive, 1.0), (0.0,) * 4),
        }
        for slot, texture in found.items():
            if slot == "base_color_texture" and painted:
                self._notes.add("colours of vertices beneath textures", label)
            if slot == "normal_texture" and look.normal_scale != 1.0:
                self._notes.add("scales of normal textures", label)
            node = self._texture(f"{path}/{slot}", texture, slot, *scales[slot])
            for output, name in _SLOTS[slot]:
                unlit = slot == "base_color_texture" and look.unlit
                self._connect(shader, "emissiveColor" if unlit else name, node, output)
            if slot == "base_color_texture" and look.alpha_mode != "opaque":
                self._connect(shader, "opacity", node, "a")
        material.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")
        return material

    def _paint(self, path: str, shader: Any, look: Material) -> None:
        """Let colours of vertices, times the base colour, be the colour of a surface."""
        types = self._sdf.ValueTypeNames
        for kind, primvar, name in (
            ("float3", "displayColor", "emissiveColor" if look.unlit else "diffuseColor"),
            ("float", "displayOpacity", "opacity"),
        ):
            if name == "opacity" and look.alpha_mode == "opaque":
                continue
            reader = self._shader(f"{path}/{primvar}", f"UsdPrimvarReader_{kind}")
            reader.CreateInput("varname", types.String).Set(primvar)
            reader.CreateOutput("result", types.Float3 if kind == "float3" else types.Float)
            self._connect(shader, name, reader, "result")

    def _texture(
        self, path: str, texture: Texture, slot: str, scale: tuple[float, ...], bias: tuple[float, ...]
    ) -> Any:
        types = self._sdf.ValueTypeNames
        node = self._shader(path, "UsdUVTexture")
        node.CreateInput("file", types.Asset).Set(
            self._sdf.AssetPath(f"./{self._image(texture.image, slot)}")
        )
        node.CreateInput("sourceColorSpace", types.Token).Set("sRGB" if slot in COLORS else "raw")
        node.CreateInput("wrapS", types.Token).Set(texture.wrap[0])
        node.CreateInput("wrapT", types.Token).Set(texture.wrap[1])
        node.CreateInput("scale", types.Float4).Set(self._gf.Vec4f(*scale))
        node.CreateInput("bias", types.Float4).Set(self._gf.Vec4f(*bias))
        if texture.filter != "linear" or texture.mipmaps != "linear":
            self._notes.add("filters of textures")
        reader = self._shader(f"{path}_uv", "UsdPrimvarReader_float2")
        reader.CreateInput("varname", types.String).Set(_uv_set(int(texture.uv_set)))
        reader.CreateOutput("result", types.Float2)
        if (texture.offset, texture.rotation, texture.scale) != ((0.0, 0.0), 0.0, (1.0, 1.0)):
            transform = self._shader(f"{path}_moved", "UsdTransform2d")
            transform.CreateInput("scale", types.Float2).Set(self._gf.Vec2f(*texture.scale))
            transform.CreateInput("rotation", types.Float).Set(math.degrees(texture.rotation))
            # Both count v upwards here: what (0, 0) is mapped to, once more upwards.
            (_, _, u), (_, _, v) = texture._rows()
            transform.CreateInput("translation", types.Float2).Set(self._gf.Vec2f(u, 1.0 - v))
            transform.CreateOutput("result", types.Float2)
            transform.CreateInput("in", types.Float2).ConnectToSource(reader.ConnectableAPI(), "result")
            reader = transform
        node.CreateInput("st", types.Float2).ConnectToSource(reader.ConnectableAPI(), "result")
        return node

    def _image(self, image: Image, slot: str) -> str:
        """Return the name of the file of an image."""
        key = image_key(image, slot)
        if key not in self._names:
            data, ending = image_file(image, slot in COLORS, self._notes)
            known = next((name for name, content in self._images.items() if content == data), None)
            name = known or f"{self._path.stem}_{len(self._images)}.{ending}"
            self._names[key] = name
            self._images[name] = data
        return self._names[key]

    def _shader(self, path: str, kind: str) -> Any:
        shader = self._shade.Shader.Define(self._stage, path)
        shader.CreateIdAttr(kind)
        return shader

    def _connect(self, shader: Any, name: str, node: Any, output: str) -> None:
        types = self._sdf.ValueTypeNames
        kind = {"diffuseColor": types.Color3f, "emissiveColor": types.Color3f, "normal": types.Normal3f}
        of = {"rgb": types.Float3, "result": types.Float3}
        if not node.GetOutput(output):
            node.CreateOutput(output, of.get(output, types.Float))
        given = shader.CreateInput(name, kind.get(name, types.Float))
        given.ConnectToSource(node.ConnectableAPI(), output)

    # --------------------------------------------------------------------------------------------- files

    def files(self) -> dict[str, bytes]:
        """Return the files: a layer and its images, or a package of both."""
        path = self._path
        packed = path.suffix.lower() == ".usdz"
        with tempfile.TemporaryDirectory() as folder:
            for name, data in self._images.items():
                Path(folder, name).write_bytes(data)
            # The ending says whether it is text; that of a package are bytes.
            layer = Path(folder, f"{path.stem}.usdc" if packed else path.name)
            self._stage.GetRootLayer().Export(str(layer))
            if not packed:
                beside = {str(path.with_name(name)): data for name, data in self._images.items()}
                return beside | {str(path): layer.read_bytes()}
            from pxr import UsdUtils

            whole = Path(folder, "package.usdz")
            UsdUtils.CreateNewUsdzPackage(self._sdf.AssetPath(str(layer)), str(whole))
            return {str(path): whole.read_bytes()}


def _uv_set(number: int) -> str:
    return f"st{number}" if number else "st"
