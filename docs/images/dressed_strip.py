#!/usr/bin/python3
"""A film strip of a result with a body: the enhanced cloth on it, seen from where it goes along, as a PNG.

    docs/images/dressed_strip.py out/dancer/result.h5 OUT.png FRAME... [--which coarse|fine] [--size 520] [--top 0.2]

The first obstacle that is a mesh is the body. Every piece of the cloth has its own colour. Needs Debian's python3-numpy and python3-h5py.
"""
import argparse

import h5py
import numpy as np

import film_strip


COLOURS = [film_strip.CLOTH, np.array([205, 205, 200]), np.array([120, 150, 110]), np.array([170, 110, 130])]


def pieces(faces):
    """Faces of every connected piece, in the order of their first ones."""
    label = np.arange(faces.max() + 1)
    while True:
        before = label.copy()
        lowest = label[faces].min(axis=1)
        for k in range(3):
            np.minimum.at(label, faces[:, k], lowest)
        label = label[label]
        if (label == before).all():
            break
    of_face = label[faces[:, 0]]
    return [faces[of_face == piece] for piece in dict.fromkeys(of_face)]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("result")
    parser.add_argument("out")
    parser.add_argument("frames", type=int, nargs="+")
    parser.add_argument("--which", default="enhanced", choices=["enhanced", "coarse", "fine"])
    parser.add_argument("--size", type=int, default=520, help="pixels of one picture before its margins are cut")
    parser.add_argument("--top", type=float, default=0.2, help="share that is cut above; 0.43: to the waist")
    options = parser.parse_args()
    film_strip.SIZE = options.size
    rows, columns = ((int(a * options.size), int(b * options.size)) for a, b in ((options.top, 0.84), (0.3, 0.68)))
    pictures = []
    with h5py.File(options.result) as result:
        faces = result[f"topology/{'coarse' if options.which == 'coarse' else 'fine'}/faces"][:].astype(int)
        body = next(obstacle for obstacle in result["obstacles"].values() if "faces" in obstacle)
        body_faces = body["faces"][:].astype(int)
        for frame in options.frames:
            points = body["positions"][frame].astype(float)
            x, _, z = points.mean(0)
            picture = film_strip.Picture(np.array([x - 0.75, -0.05, z - 0.75]), np.array([x + 0.75, 1.7, z + 0.75]))
            picture.draw(points, body_faces, film_strip.OBSTACLE)
            cloth = result[f"{options.which}/positions"][frame].astype(float)
            for k, piece in enumerate(pieces(faces)):
                picture.draw(cloth, piece, COLOURS[k % len(COLOURS)])
            pictures.append(picture.image[slice(*rows), slice(*columns)])
    film_strip.write_png(options.out, np.ascontiguousarray(np.hstack(pictures)))


if __name__ == "__main__":
    main()
