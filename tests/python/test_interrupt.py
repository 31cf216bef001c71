"""Ctrl-C during long work: in a process of its own, by a real signal."""

import signal
import subprocess
import sys
import time

import pytest

CODE = """
import signal
import sys
# In the background of a shell SIGINT is ignored, and children inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)
import nanite_rs as nrs
{prepare}
print("ready", flush=True)
try:
    {work}
except KeyboardInterrupt:
    print("interrupted", flush=True)
    sys.exit(0)
print("finished", flush=True)
"""

BUILD = CODE.format(
    prepare="v, f = nrs.shapes.displaced_icosphere(faces=4_000_000)",
    work="nrs.NaniteMesh.from_arrays(v, f, progress=False)",
)
MEASUREMENT = CODE.format(
    prepare="a, b = nrs.shapes.displaced_icosphere(faces=200_000), nrs.shapes.icosphere(faces=20_000)",
    work="nrs.measure.surface_distance(a, b, samples=2_000_000_000)",
)


@pytest.mark.parametrize("code", [BUILD, MEASUREMENT], ids=["build", "measurement"])
def test_control_c_stops_long_work_soon(code: str) -> None:
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout.readline().strip() == "ready"
            time.sleep(1.0)
            process.send_signal(signal.SIGINT)
            start = time.monotonic()
            out, _ = process.communicate(timeout=60)
            assert out.strip() == "interrupted"
            assert process.returncode == 0
            assert time.monotonic() - start < 5
        finally:
            process.kill()
