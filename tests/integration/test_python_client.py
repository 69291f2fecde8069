#!/usr/bin/env python3
"""Runs enhance_client.py against `pleat up`: SOURCE PLEAT. Exit code 77: packages are missing."""

import pathlib
import shutil
import signal
import subprocess
import sys
import tempfile
import threading

try:
    import grpc  # noqa: F401
except ImportError as missing:
    print(f"skipped: {missing} (Debian: python3-grpcio)")
    sys.exit(77)
if not shutil.which("protoc") or not shutil.which("grpc_python_plugin"):
    print("skipped: no protoc or grpc_python_plugin (Debian: protobuf-compiler protobuf-compiler-grpc)")
    sys.exit(77)

FRAMES = 6


def wait_for_address(up):
    """The coordinator's address, which `pleat up` prints when everything is healthy."""
    for line in up.stdout:
        print("up:", line.rstrip())
        if line.startswith("ready "):
            return line.split()[1]
    sys.exit(f"`pleat up` ended before it was ready, exit code {up.wait()}")


def main():
    source, pleat = (pathlib.Path(argument) for argument in sys.argv[1:3])
    client = source / "tests/integration/enhance_client.py"
    garment = source / "deploy/garments/tablecloth.obj"
    with tempfile.TemporaryDirectory() as folder:
        fine = pathlib.Path(folder) / "fine.obj"
        up = subprocess.Popen([pleat, "up", "--data", folder], stdout=subprocess.PIPE, text=True)
        watchdog = threading.Timer(200, up.kill)
        watchdog.start()
        try:
            address = wait_for_address(up)
            run = subprocess.run([sys.executable, client, address, garment, "--frames", str(FRAMES), "--out", fine],
                                 stdout=subprocess.PIPE, text=True)
            print(run.stdout)
            assert run.returncode == 0, f"exit code {run.returncode}"
            assert "749 -> 11393 vertices" in run.stdout
            assert run.stdout.count("refinement") == FRAMES
            assert sum(line.startswith("v ") for line in fine.read_text().splitlines()) == 11393
            bad = subprocess.run([sys.executable, client, address, garment, "--model", "nobody"],
                                 stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
            print(bad.stderr)
            assert bad.returncode == 1 and "NOT_FOUND" in bad.stderr and "nobody" in bad.stderr
            up.send_signal(signal.SIGINT)
            assert up.wait() == 0, "`pleat up` must end well on Ctrl-C"
        finally:
            watchdog.cancel()
            up.kill()
            up.wait()


main()
