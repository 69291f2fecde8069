#!/usr/bin/python3
"""Cloth that Debian's Blender writes with its frames comes into `pleat enhance` as it was there: test_blender_files.py PLEAT.
Exit code 77: Blender or h5py is missing."""
import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

try:
    import h5py
    import numpy as np
except ImportError:
    sys.exit(77)
if shutil.which("blender") is None:
    print("skipped: blender is not installed")
    sys.exit(77)


def run(*words):
    done = subprocess.run([str(word) for word in words], capture_output=True, text=True, timeout=200)
    assert done.returncode == 0, f"{words}: exit code {done.returncode}\n{done.stdout[-3000:]}\n{done.stderr[-3000:]}"


def main():
    pleat = Path(sys.argv[1]).resolve()
    script = Path(__file__).resolve().parent / "blender/make_cloth_files.py"
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        run("blender", "--background", "--factory-startup", "--python-exit-code", "1", "--python", script, "--", folder)
        for file, frames in json.loads((folder / "truth.json").read_text()).items():
            out = folder / f"out-{file}"
            run(pleat, "enhance", folder / file, "--detail", "none", "--out", out)
            with h5py.File(out / "result.h5") as result:
                ours, step = result["coarse/positions"][:], result.attrs["frame_time_s"]
            truth = np.array(frames)
            assert ours.shape == truth.shape, f"{file}: {ours.shape}, in Blender {truth.shape}"
            assert abs(step - 1 / 24) < 1e-5, f"{file}: {step} s a frame"
            # Exporters may number vertices anew, once for all frames.
            matched = np.linalg.norm(truth[0][:, None] - ours[0][None], axis=2).argmin(axis=1)
            assert len(set(matched)) == len(matched), f"{file}: other vertices"
            worst = np.abs(ours[:, matched] - truth).max()
            print(f"{file}: {len(ours)} frames of {ours.shape[1]} vertices, {1000 * worst:.4f} mm from Blender's")
            assert worst < 2e-5, f"{file}: {worst} m from Blender's"


main()
