#!/usr/bin/python3
"""A contact sheet of scenes: coarse cloth, fold step, tracked and free simulation side by side, as a PNG.

    docs/images/contact_sheet.py FOLDER OUT.png [--scenes draping,hitting] [--frames 20,40,60] [--kinds coarse,fold,tracked,free] [--size 200]
        [--across] [--down]

FOLDER has SCENE-fold.h5 (bench_fold_step), SCENE-tracked.h5 and SCENE-free.h5 (bench_record_fine) of 61 frames for every
scene; for the kinds network and both results of `pleat run --detail` named so. Needs Debian's python3-numpy and python3-h5py.
"""
import argparse

import h5py
import numpy as np

import film_strip

KINDS = {"coarse": ("fold", "coarse"), "fold": ("fold", "enhanced"), "tracked": ("tracked", "fine"), "free": ("free", "fine"),
         "network": ("network", "enhanced"), "both": ("both", "enhanced")}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder")
    parser.add_argument("out")
    parser.add_argument("--scenes", default="draping,hitting,figure,flag,curtain,ball")
    parser.add_argument("--frames", default="20,40,60")
    parser.add_argument("--kinds", default="coarse,fold,tracked,free")
    parser.add_argument("--size", type=int, default=200, help="pixels of one picture")
    parser.add_argument("--across", action="store_true", help="scenes side by side, not one below the other")
    parser.add_argument("--down", action="store_true", help="frames of a scene one below the other")
    options = parser.parse_args()
    film_strip.SIZE = options.size
    rows = []
    for scene in options.scenes.split(","):
        pictures = []
        for frame in map(int, options.frames.split(",")):
            for kind in options.kinds.split(","):
                file, level = KINDS[kind]
                with h5py.File(f"{options.folder}/{scene}-{file}.h5") as result:
                    coarse = result["coarse/positions"][frame].astype(float)
                    mesh = "coarse" if level == "coarse" else "fine"
                    faces = result[f"topology/{mesh}/faces"][:].astype(int)
                    picture = film_strip.Picture(coarse.min(0) - 0.03, coarse.max(0) + 0.03)
                    picture.draw(result[f"{level}/positions"][frame].astype(float), faces, film_strip.CLOTH)
                    pictures.append(picture.image)
        kinds = options.kinds.count(",") + 1
        if options.down:
            pictures = [np.hstack(pictures[i : i + kinds]) for i in range(0, len(pictures), kinds)]
        rows.append(np.vstack(pictures) if options.across or options.down else np.hstack(pictures))
    sheet = np.hstack(rows) if options.across else np.vstack(rows)
    film_strip.write_png(options.out, np.ascontiguousarray(sheet))


if __name__ == "__main__":
    main()
