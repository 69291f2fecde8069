#!/usr/bin/env python3
"""How far two free fine simulations part whose starts differ by at most 0.1 mm: no network can know better.

Simulates HITTING's sequences with deploy/garments/sheet.obj twice, once with every vertex moved by up to 0.1 mm along y,
and prints RMS distances in mm. --bumps: height of the smooth bumps that both starts share, m. Needs numpy and h5py.
Usage: chaos_floor.py FOLDER [--bumps 0.02] [--sequences 2] [--frames 120] [--generator build/bin/pleat-generate]
"""
import argparse
import pathlib
import subprocess

import h5py
import numpy as np

ROOT = pathlib.Path(__file__).resolve().parents[2]


def write_garment(path, bumps, noise):
    """The sheet, raised to bumps and by seeded noise of an amplitude, both in metres; rest shape and material stay."""
    random = np.random.default_rng(1)
    with open(path, "w", encoding="ascii") as out:
        for line in (ROOT / "deploy/garments/sheet.obj").read_text().splitlines():
            if line.startswith("v "):
                x, _, z = map(float, line.split()[1:])
                y = bumps * np.sin(3 * x + 1) * np.sin(2.5 * z + 0.4) + noise * (2 * random.random() - 1)
                line = f"v {x:.9g} {y:.9g} {z:.9g}"
            out.write(line + "\n")


def rms(a, b):
    """Per frame, mm."""
    return 1e3 * np.sqrt(((a - b) ** 2).sum(-1).mean(-1))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--bumps", type=float, default=0.02)
    parser.add_argument("--sequences", type=int, default=2)
    parser.add_argument("--frames", type=int, default=120)
    parser.add_argument("--generator", default=ROOT / "build/bin/pleat-generate")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    for name, noise in (("one", 0.0), ("other", 1e-4)):
        garment = options.folder / f"{name}.obj"
        write_garment(garment, options.bumps, noise)
        subprocess.run([options.generator, options.folder / name, "--set", "hitting", "--fine", "free", "--garment", garment,
                        "--train", str(options.sequences), "--test", "0", "--frames", str(options.frames)],
                       cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
    print("sequence: fine against fine, coarse against coarse, fine against coarse; fine against fine by frames")
    for path in sorted((options.folder / "one/sequences").glob("*.h5")):
        with h5py.File(path) as one, h5py.File(options.folder / "other/sequences" / path.name) as other:
            fine, fine_other = one["fine/positions"][:], other["fine/positions"][:]
            coarse, coarse_other = one["coarse/positions"][:], other["coarse/positions"][:]
        parted = rms(fine, fine_other)
        figures = [parted, rms(coarse, coarse_other), rms(fine[:, : coarse.shape[1]], coarse)]
        print(path.stem + ":", *(f"{np.sqrt((f ** 2).mean()):.2f}" for f in figures), "mm;",
              *(f"{k}: {parted[k]:.2f}" for k in range(0, len(parted), 20)))


if __name__ == "__main__":
    main()
