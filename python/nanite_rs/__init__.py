"""Virtualized geometry: a mesh of any size as a cluster LOD DAG, true cuts of it, and a renderer."""

from __future__ import annotations

from typing import TYPE_CHECKING as _TYPE_CHECKING

from nanite_rs import _advice, foliage, measure, plot, shapes, viewer
from nanite_rs._core import __version__
from nanite_rs._rig import Animation
from nanite_rs.animation import save_animation
from nanite_rs.assembly import Assembly, AssemblyPart
from nanite_rs.assets import LoadedScene, load_scene
from nanite_rs.building import build_file, build_heightfield
from nanite_rs.camera import (
    Camera,
    IntrinsicsCamera,
    OrthographicCamera,
    PerspectiveCamera,
    look_at,
    orbit,
    pose_from_opencv,
)
from nanite_rs.clusters import Clusters
from nanite_rs.collection import BuildResult, BuildResults, build_many
from nanite_rs.comparison import Comparison, SilhouetteDistance, compare
from nanite_rs.cut import Cut
from nanite_rs.decimation import decimate, simplify
from nanite_rs.displacement import DisplacedMesh, displace
from nanite_rs.exceptions import (
    AccessError,
    ArgumentError,
    BackendError,
    ChangedFileError,
    DependencyError,
    DtypeError,
    FileError,
    ForkError,
    FormatError,
    InternalError,
    InvariantError,
    MeshError,
    MissingFileError,
    NaniteError,
    ServerError,
    StaleHandleError,
    UsageWarning,
    WorkerError,
)
from nanite_rs.frame import Frame
from nanite_rs.imposters import Imposter, ImposterPicture, bake_imposter
from nanite_rs.interop import PyrenderView, from_pyrender
from nanite_rs.light import DirectionalLight, Environment, PointLight, SpotLight
from nanite_rs.material import Material
from nanite_rs.mesh import NaniteMesh
from nanite_rs.options import BuildOptions
from nanite_rs.rebaking import rebake
from nanite_rs.renderer import Calibration, Renderer, StreamWarning, TextureWarning, View
from nanite_rs.report import BuildReport, CheckReport, LevelReport, RebakedPart, StuckGroup, TilesReport
from nanite_rs.scene import LightNode, MeshNode, Scene
from nanite_rs.skinned_mesh import SkinnedMesh
from nanite_rs.stats import (
    AssemblyStats,
    FrameStats,
    ShadowCascade,
    ShadowStats,
    StageStats,
    StreamStats,
    TrafficStats,
)
from nanite_rs.strokes import Lines, Points
from nanite_rs.swaying_mesh import SwayingMesh, Wave
from nanite_rs.terrain import HeightfieldMesh, heightfield
from nanite_rs.texture import Image, Texture
from nanite_rs.threads import get_num_threads, set_num_threads
from nanite_rs.triangle_mesh import TriangleMesh
from nanite_rs.viewer import Orbit, Pick, Viewer, view

__all__ = [
    "AccessError",
    "Animation",
    "ArgumentError",
    "Assembly",
    "AssemblyPart",
    "AssemblyStats",
    "BackendError",
    "BuildOptions",
    "BuildReport",
    "BuildResult",
    "BuildResults",
    "Calibration",
    "Camera",
    "ChangedFileError",
    "CheckReport",
    "Clusters",
    "Comparison",
    "Cut",
    "DependencyError",
    "DirectionalLight",
    "DisplacedMesh",
    "DtypeError",
    "Environment",
    "FileError",
    "ForkError",
    "FormatError",
    "Frame",
    "FrameStats",
    "HeightfieldMesh",
    "Image",
    "Imposter",
    "ImposterPicture",
    "InternalError",
    "IntrinsicsCamera",
    "InvariantError",
    "LevelReport",
    "LightNode",
    "Lines",
    "LoadedScene",
    "Material",
    "MeshError",
    "MeshNode",
    "MissingFileError",
    "NaniteError",
    "NaniteMesh",
    "Orbit",
    "OrthographicCamera",
    "PerspectiveCamera",
    "Pick",
    "PointLight",
    "Points",
    "PyrenderView",
    "RebakedPart",
    "Renderer",
    "Scene",
    "ServerError",
    "ShadowCascade",
    "ShadowStats",
    "SilhouetteDistance",
    "SkinnedMesh",
    "SpotLight",
    "StageStats",
    "StaleHandleError",
    "StreamStats",
    "StreamWarning",
    "StuckGroup",
    "SwayingMesh",
    "Texture",
    "TextureWarning",
    "TilesReport",
    "TrafficStats",
    "TriangleMesh",
    "UsageWarning",
    "View",
    "Viewer",
    "Wave",
    "WorkerError",
    "__version__",
    "bake_imposter",
    "build_file",
    "build_heightfield",
    "build_many",
    "compare",
    "decimate",
    "displace",
    "foliage",
    "from_pyrender",
    "get_num_threads",
    "heightfield",
    "load_scene",
    "look_at",
    "measure",
    "orbit",
    "plot",
    "pose_from_opencv",
    "rebake",
    "save_animation",
    "set_num_threads",
    "shapes",
    "simplify",
    "view",
    "viewer",
]

if not _TYPE_CHECKING:

    def __getattr__(name: str) -> object:
        raise _advice.absent("nanite_rs", name)
