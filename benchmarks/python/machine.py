"""What a result ran on: processor, memory, system and versions. No names of machines, people or folders."""

from __future__ import annotations

import os
import platform
from importlib import metadata
from pathlib import Path

import nanite_rs as nrs

PACKAGES = ("nanite-rs", "numpy", "trimesh", "pyrender", "PyOpenGL", "fast-simplification", "libigl")


def describe(more: tuple[str, ...] = ()) -> dict[str, object]:
    """A JSON-ready description, with the versions of ``more`` packages."""
    return {
        "processor": _processor(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "memory_gib": _memory(),
        "load": _load(),
        "system": f"{platform.system()} {platform.machine()}, {_distribution()}",
        "device": _device(),
        "python": platform.python_version(),
        "packages": {name: _version(name) for name in (*PACKAGES, *more)},
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    return next(
        (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.machine()
    )


def _device() -> str:
    """The device and the driver that wgpu finds, or why there is none."""
    try:
        with nrs.Renderer(8, 8, backend="gpu") as renderer:
            return renderer.backend_reason.removeprefix("asked for: ")
    except nrs.BackendError as error:
        return f"none: {error}".partition(". ")[0]


def _load() -> float | None:
    """Mean number of running threads in the last minute: well above the cores, others are at work too."""
    return round(os.getloadavg()[0], 1) if hasattr(os, "getloadavg") else None


def _memory() -> float | None:
    try:
        return round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1)
    except (AttributeError, ValueError, OSError):
        return None


def _distribution() -> str:
    try:
        release = platform.freedesktop_os_release()
    except OSError:
        return platform.release()
    return release.get("PRETTY_NAME", "unknown")


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None
