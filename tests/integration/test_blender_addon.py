#!/usr/bin/python3
"""Debian's Blender, without a window, takes a cloth through the add-on and back, live too, and renders a frame.

  test_blender_addon.py ADDONS PLEAT [FRAMES [PICTURE.png]]

ADDONS is the folder that `pleat` (the add-on) lies in. Exit code 77: Blender or numpy is missing."""
import os
import shutil
import struct
import subprocess
import sys
import tempfile
import zlib
from pathlib import Path

if shutil.which("blender") is None:
    print("skipped: blender is not installed (apt-get install blender python3-numpy)")
    sys.exit(77)


def colors(png):
    """How many different bytes the rows of a PNG file have: one for a picture of nothing."""
    data, at, packed = png.read_bytes(), 8, b""
    while at < len(data):
        length, kind = struct.unpack(">I4s", data[at:at + 8])
        if kind == b"IDAT":
            packed += data[at + 8:at + 8 + length]
        at += length + 12
    return len(set(zlib.decompress(packed)))


def main():
    addons, pleat = (Path(argument).resolve() for argument in sys.argv[1:3])
    frames = sys.argv[3] if len(sys.argv) > 3 else "8"
    script = Path(__file__).resolve().parent / "blender/bake_cloth.py"
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        scripts = folder / "scripts/addons"
        scripts.mkdir(parents=True)
        shutil.copytree(addons / "pleat", scripts / "pleat")
        environment = dict(os.environ, BLENDER_USER_SCRIPTS=str(scripts.parent), PLEAT_PROGRAM=str(pleat), HOME=name,
                           PATH="/usr/bin:/bin")  # Blender takes the modules of the python3 that it finds there
        done = subprocess.run(["blender", "--background", "--factory-startup", "--python-exit-code", "1", "--python", script,
                               "--", folder, frames], env=environment, capture_output=True, text=True, timeout=900)
        said = done.stdout + done.stderr
        assert done.returncode == 0, said[-6000:]
        print(next(line for line in said.splitlines() if line.startswith('{"simulated_s"')))
        picture = folder / "frame.png"
        assert colors(picture) > 100, "the rendered frame shows nothing"
        if len(sys.argv) > 4:
            shutil.copy(picture, sys.argv[4])


main()
