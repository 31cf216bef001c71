"""Check the wheel and the source archive that `make wheel` leaves in a folder, as somebody who installs them would.

The wheel: its size, its name, what it holds, and which libraries of the system its module wants. It is installed by
itself into a new virtual environment, is imported there (the time beyond NumPy's is printed, a median), and draws a
picture on the CPU from Python and from the shell. The source archive holds what a build needs and nothing else;
`--build` builds a wheel of it, too, which takes minutes.
"""

import argparse
import os
import statistics
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LARGEST = 8_000_000
# What every Linux of the wheel's manylinux name has (PEP 600); anything else somebody would have to install.
SYSTEM = {
    *(
        "libc.so.6",
        "libm.so.6",
        "libdl.so.2",
        "librt.so.1",
        "libpthread.so.0",
        "libgcc_s.so.1",
        "libstdc++.so.6",
    ),
    *("ld-linux-x86-64.so.2", "ld-linux-aarch64.so.1"),
}
# What a build takes: folders and files of the repository. Cargo's manifest names the tests and benchmarks in Rust.
BUILD = ("src/", "shaders/", "python/", "tests/rust/", "benchmarks/rust/")
BUILD_FILES = {
    *("Cargo.toml", "Cargo.lock", ".cargo/config.toml", "pyproject.toml"),
    *("README.md", "CHANGELOG.md", "LICENSE-MIT", "LICENSE-APACHE"),
    "tests/python/oracles/adapters.json",
}

IMPORT = """
import time
import numpy
before = time.perf_counter()
import nanite_rs
print(time.perf_counter() - before)
"""

RENDER = """
import numpy as np
import nanite_rs as nrs

mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.displaced_icosphere(faces=50_000))
mesh.save("ball.nanite")
pose = np.eye(4)
pose[2, 3] = 4.0
scene = nrs.Scene(ambient_light=(0.2, 0.2, 0.2), bg_color=(0.0, 0.0, 0.0))
scene.add(nrs.NaniteMesh.open("ball.nanite"))
scene.add(nrs.DirectionalLight(intensity=3.0), pose=pose)
with nrs.Renderer(320, 180, backend="cpu") as renderer:
    renderer.render(scene, nrs.PerspectiveCamera(yfov=0.8), pose).save("ball.png")
"""

LOOK = """
import sys
import numpy as np
from PIL import Image

for name in sys.argv[1:]:
    picture = np.asarray(Image.open(name).convert("RGB"))
    lit = (picture != picture[0, 0]).any(axis=-1)
    if not 0.05 < lit.mean() < 0.95:
        sys.exit(f"{name}: {lit.mean():.1%} of the pixels differ from the corner")
"""


def fail(what: str) -> None:
    """End with the reason."""
    sys.exit(f"error: {what}")


def only(folder: Path, pattern: str) -> Path:
    """The one file of that pattern."""
    found = sorted(folder.glob(pattern))
    if len(found) != 1:
        fail(f"expected one {pattern} in {folder}, found {len(found)}; remove old ones, and run `make wheel`")
    return found[0]


def run(*command: str | Path, cwd: Path, quiet: bool = False) -> str:
    """Output of a command that sees nothing of this environment but where programs are."""
    kept = ("PATH", "HOME", "TMPDIR", "LANG", "CARGO_HOME", "RUSTUP_HOME")
    pip = {k: v for k, v in os.environ.items() if k.startswith("PIP_") or k.lower().endswith("_proxy")}
    result = subprocess.run(  # noqa: S603  commands of this file
        [str(part) for part in command],
        cwd=cwd,
        env={k: os.environ[k] for k in kept if k in os.environ} | pip,
        capture_output=True,
        text=True,
        check=False,
    )
    if result.returncode:
        fail(f"{' '.join(str(part) for part in command)[:200]}\n{result.stdout}{result.stderr}")
    if not quiet:
        print(result.stdout, end="")
    return result.stdout


def check_wheel(wheel: Path, *, audited: bool = True) -> None:
    """Size, name, content and libraries. pip's own wheels are not audited, and not named after manylinux."""
    size = wheel.stat().st_size
    print(f"{wheel.name}: {size / 1e6:.2f} MB")
    if size > LARGEST:
        fail(f"the wheel has {size:,} bytes; at most {LARGEST:,} are allowed")
    _, _, python, abi, platform = wheel.stem.split("-")
    if (python, abi) != ("cp310", "abi3"):
        fail(f"expected a wheel for cp310-abi3, found {python}-{abi}")
    if audited and sys.platform == "linux" and not platform.startswith(("manylinux", "musllinux")):
        fail(f"{platform}: maturin found that the module wants more of the system than manylinux allows")
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        sources = {
            path.name for path in (ROOT / "python" / "nanite_rs").glob("*.py*") if path.suffix != ".pyd"
        }
        missing = {f"nanite_rs/{name}" for name in sources} - set(names)
        if missing:
            fail(f"the wheel lacks {sorted(missing)}")
        foreign = [n for n in names if not n.startswith(("nanite_rs/", "nanite_rs-")) or "__pycache__" in n]
        if foreign:
            fail(f"the wheel has more than the package: {foreign}")
        if not any(name.endswith("LICENSE-MIT") for name in names):
            fail("the wheel has no licence")
        module = [name for name in names if name.startswith("nanite_rs/_core.") and not name.endswith(".pyi")]
        if len(module) != 1:
            fail(f"expected one compiled module, found {module}")
        if sys.platform == "linux":
            check_libraries(archive.read(module[0]))


def check_libraries(module: bytes) -> None:
    """The libraries that the dynamic linker will look for, by binutils."""
    with tempfile.NamedTemporaryFile() as file:
        file.write(module)
        file.flush()
        lines = run("readelf", "--dynamic", file.name, cwd=ROOT, quiet=True).splitlines()
    wanted = {line.split("[")[1].rstrip("]") for line in lines if "(NEEDED)" in line}
    print(f"needs {', '.join(sorted(wanted))}")
    if not wanted:
        fail("readelf found no needed library, so this check would find nothing")
    if wanted - SYSTEM:
        fail(f"the module needs {sorted(wanted - SYSTEM)} of the system")
    searched = [line.strip() for line in lines if "(RPATH)" in line or "(RUNPATH)" in line]
    if searched:
        fail(f"the module looks for libraries where they were on the machine that built it: {searched}")


def check_sources(archive: Path) -> None:
    """The source archive against what git lists."""
    print(f"{archive.name}: {archive.stat().st_size / 1e6:.2f} MB")
    with tarfile.open(archive) as tar:
        top = archive.name.removesuffix(".tar.gz")
        names = {member.name.removeprefix(f"{top}/") for member in tar.getmembers() if member.isfile()}
    listed = run("git", "ls-files", cwd=ROOT, quiet=True).splitlines()
    wanted = {name for name in listed if name.startswith(BUILD) or name in BUILD_FILES}
    if wanted - names:
        fail(f"the source archive lacks {sorted(wanted - names)}")
    more = names - wanted - {"PKG-INFO"}
    if more:
        fail(f"the source archive has more than a build takes: {sorted(more)}")


def check_installed(wheel: Path, folder: Path) -> None:
    """A new environment with the wheel and what it asks for, and nothing else."""
    run(sys.executable, "-m", "venv", folder / "venv", cwd=folder)
    python = folder / "venv" / "bin" / "python"
    pip = (python, "-m", "pip", "--disable-pip-version-check")
    run(*pip, "install", "--quiet", "--only-binary", ":all:", wheel, cwd=folder)
    run(*pip, "check", cwd=folder)
    run(*pip, "list", "--format", "freeze", cwd=folder)
    times = sorted(float(run(python, "-c", IMPORT, cwd=folder, quiet=True)) for _ in range(9))
    # The first reads from the disk.
    print(f"import takes {statistics.median(times):.3f} s over NumPy ({times[0]:.3f} to {times[-1]:.3f})")
    run(python, "-c", RENDER, cwd=folder)
    command = folder / "venv" / "bin" / "nanite-rs"
    run(command, "--version", cwd=folder)
    run(
        command,
        "render",
        "ball.nanite",
        "-o",
        "shell.png",
        "--size",
        "320x180",
        "--backend",
        "cpu",
        cwd=folder,
    )
    run(python, "-c", LOOK, "ball.png", "shell.png", cwd=folder)
    print("it draws")


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="where the wheel and the source archive are")
    parser.add_argument("--build", action="store_true", help="build a wheel from the source archive")
    options = parser.parse_args()
    folder = options.folder.resolve()
    wheel, sources = only(folder, "nanite_rs-*.whl"), only(folder, "nanite_rs-*.tar.gz")
    check_wheel(wheel)
    check_sources(sources)
    with tempfile.TemporaryDirectory() as temporary:
        check_installed(wheel, Path(temporary))
    if options.build:
        with tempfile.TemporaryDirectory() as temporary:
            # All anew: where the module was compiled before, cargo would find that nothing changed.
            run(sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", sources, cwd=Path(temporary))
            built = only(Path(temporary), "nanite_rs-*.whl")
            check_wheel(built, audited=False)
            check_installed(built, Path(temporary))


if __name__ == "__main__":
    main()
