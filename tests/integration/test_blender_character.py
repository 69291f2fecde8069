#!/usr/bin/python3
"""A character that Debian's Blender writes moves in `pleat body` as it does in Blender.

  test_blender_character.py PLEAT    exit code 77: Blender or h5py is missing
"""
import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

TOLERANCE_M = 2e-4

try:
    import h5py
    import numpy as np
except ImportError:
    sys.exit(77)
if shutil.which("blender") is None:
    print("blender is not installed")
    sys.exit(77)


def worst_distance(ours, truth):
    """The largest distance of a point of Blender's to the nearest of ours in any frame (vertex orders differ)."""
    return max(
        float(np.sqrt(((a[:, None] - b[None]) ** 2).sum(axis=2)).min(axis=1).max()) for a, b in zip(truth, ours))


def main():
    pleat = sys.argv[1]
    script = Path(__file__).parent / "blender/make_character.py"
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        subprocess.run(["blender", "--background", "--factory-startup", "--python-exit-code", "1", "--python", script,
                        "--", folder], check=True, timeout=200, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        truth = np.array(json.loads((folder / "truth.json").read_text()))
        for kind in ("glb", "fbx"):
            out = folder / f"{kind}.h5"
            said = subprocess.run([pleat, "body", folder / f"character.{kind}", "--out", out, "--frame-time", str(1 / 24),
                                   "--ease", "0", "--smooth", "0", "--keep-place"], check=True, timeout=60,
                                  capture_output=True, text=True).stdout
            with h5py.File(out) as file:
                ours = file["positions"][:]
            worst = worst_distance(ours, truth)
            print(f"{kind}: {len(ours)} frames of {ours.shape[1]} vertices, {worst * 1000:.3f} mm\n{said}")
            assert len(ours) == len(truth), f"{kind}: {len(ours)} frames, Blender has {len(truth)}"
            assert ours.shape[1] == truth.shape[1], f"{kind}: {ours.shape[1]} vertices, Blender has {truth.shape[1]}"
            assert worst < TOLERANCE_M, f"{kind}: {worst} m from Blender's"


if __name__ == "__main__":
    main()
