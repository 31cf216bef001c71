"""Ctrl-C while building: in a process of its own, by a real signal."""

import signal
import subprocess
import sys
import time

CODE = """
import signal
import sys
# In the background of a shell SIGINT is ignored, and children inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)
import nanite_rs as nrs
v, f = nrs.shapes.displaced_icosphere(faces=4_000_000)
print("ready", flush=True)
try:
    nrs.NaniteMesh.from_arrays(v, f, progress=False)
except KeyboardInterrupt:
    print("interrupted", flush=True)
    sys.exit(0)
print("finished", flush=True)
"""


def test_control_c_stops_a_build_soon() -> None:
    with subprocess.Popen([sys.executable, "-c", CODE], stdout=subprocess.PIPE, text=True) as process:
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
