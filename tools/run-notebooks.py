"""Execute notebooks: `run-notebooks.py FOLDER [NOTEBOOK...]`, by default all of `notebooks/`.

Writes each with its outputs into FOLDER, and its pictures into FOLDER/<name>/, and prints how long it took. They
run in FOLDER, where they leave their own files; the file that MESH names in the environment is found from here.
The first cell that fails ends it, with what the cell said.
"""

import argparse
import base64
import os
import sys
import time
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError

NOTEBOOKS = Path(__file__).resolve().parents[1] / "notebooks"
PICTURES = {"image/png": ".png", "image/gif": ".gif", "video/mp4": ".mp4"}


def save_pictures(notebook: nbformat.NotebookNode, folder: Path) -> None:
    """Write the pictures of all outputs, named after their cells."""
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.iterdir():
        old.unlink()
    for cell in notebook.cells:
        for number, output in enumerate(cell.get("outputs", [])):
            for kind, ending in PICTURES.items():
                data = output.get("data", {}).get(kind)
                if data:
                    (folder / f"{cell.id}-{number}{ending}").write_bytes(base64.b64decode(data))


def execute(path: Path, folder: Path, timeout: int) -> None:
    """Run one notebook in ``folder`` and write it there with its outputs."""
    notebook = nbformat.read(path, as_version=4)
    client = NotebookClient(
        notebook,
        timeout=timeout,
        kernel_name="python3",
        resources={"metadata": {"path": str(folder)}},
        extra_arguments=["--IPKernelApp.log_level=40"],  # errors alone
    )
    client.execute()
    nbformat.write(notebook, folder / path.name)
    save_pictures(notebook, folder / path.stem)


def main() -> int:
    """Execute them one after the other; the exit code is 1 if one failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("notebooks", type=Path, nargs="*")
    parser.add_argument("--timeout", type=int, default=600, metavar="SECONDS", help="most for a cell (600)")
    arguments = parser.parse_args()
    os.environ.pop("MPLBACKEND", None)  # plots go into the notebooks
    if mesh := os.environ.get("MESH"):
        os.environ["MESH"] = str(Path(mesh).absolute())
    arguments.folder.mkdir(parents=True, exist_ok=True)
    for path in arguments.notebooks or sorted(NOTEBOOKS.glob("*.ipynb")):
        start = time.perf_counter()
        try:
            execute(path, arguments.folder, arguments.timeout)
        except CellExecutionError as error:
            print(f"{path.name}: {error}", file=sys.stderr)
            return 1
        print(f"{path.name}: {time.perf_counter() - start:.1f} s", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
