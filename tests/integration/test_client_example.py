#!/usr/bin/env python3
"""Runs the program of docs/client.md against `pleat up`: SOURCE PLEAT EXAMPLE."""

import pathlib
import re
import signal
import subprocess
import sys
import tempfile
import threading

FRAMES = 6


def main():
    source, pleat, example = (pathlib.Path(argument) for argument in sys.argv[1:4])
    page = (source / "docs/client.md").read_text()
    program = (source / "common/client/cpp/example/enhance.cpp").read_text()
    assert re.search(r"```cpp\n(.*?)```", page, re.DOTALL)[1] == program, "docs/client.md shows another program"
    garment = source / "deploy/garments/tablecloth.obj"
    with tempfile.TemporaryDirectory() as folder:
        up = subprocess.Popen([pleat, "up", "--data", folder], stdout=subprocess.PIPE, text=True)
        watchdog = threading.Timer(200, up.kill)
        watchdog.start()
        try:
            address = next((line.split()[1] for line in up.stdout if line.startswith("ready ")), None)
            assert address, f"`pleat up` ended before it was ready, exit code {up.wait()}"
            fine = pathlib.Path(folder) / "fine.obj"
            run = subprocess.run([example, address, garment, str(FRAMES), fine], stdout=subprocess.PIPE, text=True)
            print(run.stdout)
            assert run.returncode == 0, f"exit code {run.returncode}"
            assert "749 -> 11393 vertices" in run.stdout
            assert re.findall(r"^frame (\d+):.* 0 self-intersections$", run.stdout, re.MULTILINE) == [
                str(k) for k in range(FRAMES)
            ]
            assert sum(line.startswith("v ") for line in fine.read_text().splitlines()) == 11393
            nobody = subprocess.run([example, f"unix:{folder}/nobody", garment, "1", fine], stderr=subprocess.PIPE,
                                    stdout=subprocess.DEVNULL, text=True, timeout=100)
            assert nobody.returncode == 1 and f"{folder}/nobody" in nobody.stderr, nobody.stderr
            up.send_signal(signal.SIGINT)
            assert up.wait() == 0, "`pleat up` must end well on Ctrl-C"
        finally:
            watchdog.cancel()
            up.kill()
            up.wait()


main()
