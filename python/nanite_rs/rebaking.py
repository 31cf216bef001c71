"""`rebake`: levels of detail beyond the seams of a texture."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from nanite_rs import _face_data
from nanite_rs.exceptions import ArgumentError, DtypeError
from nanite_rs.mesh import NaniteMesh
from nanite_rs.options import BuildOptions, no_options

if TYPE_CHECKING:
    from nanite_rs._progress import Progress

__all__ = ["rebake"]
