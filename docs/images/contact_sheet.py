#!/usr/bin/python3
"""A contact sheet of scenes: coarse cloth, fold step, tracked and free simulation at three frames each, as a PNG.

    docs/images/contact_sheet.py FOLDER OUT.png

FOLDER has SCENE-fold.h5 (bench_fold_step), SCENE-tracked.h5 and SCENE-free.h5 (bench_record_fine) of 61 frames for every
scene. Needs Debian's python3-numpy and python3-h5py.
"""
import sys

import h5py
import numpy as np

import film_strip

SCENES = ("draping", "hitting", "figure", "flag", "curtain", "ball")
FRAMES = (20, 40, 60)
KINDS = (("fold", "coarse"), ("fold", "enhanced"), ("tracked", "fine"), ("free", "fine"))


def main():
    if len(sys.argv) != 3:
        sys.exit(__doc__.strip())
    folder, out = sys.argv[1:]
    film_strip.SIZE = 200
    rows = []
    for scene in SCENES:
        pictures = []
        for frame in FRAMES:
            for file, level in KINDS:
                with h5py.File(f"{folder}/{scene}-{file}.h5") as result:
                    coarse = result["coarse/positions"][frame].astype(float)
                    mesh = "coarse" if level == "coarse" else "fine"
                    faces = result[f"topology/{mesh}/faces"][:].astype(int)
                    picture = film_strip.Picture(coarse.min(0) - 0.03, coarse.max(0) + 0.03)
                    picture.draw(result[f"{level}/positions"][frame].astype(float), faces, film_strip.CLOTH)
                    pictures.append(picture.image)
        rows.append(np.hstack(pictures))
    film_strip.write_png(out, np.ascontiguousarray(np.vstack(rows)))


if __name__ == "__main__":
    main()
