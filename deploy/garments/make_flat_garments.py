#!/usr/bin/env python3
"""Writes sheet-289.obj, sheet.obj, sheet-25.obj and disk.obj, the flat garments of the sets SHEET and DISK, and
irregular-square.obj (441 vertices), on which bundles for any garment are measured.

sheet: 1 m square, 17 x 17, 9 x 9 and 5 x 5 vertices. disk: 148 vertices, radius 0.6 m, 60 vertices on the rim and 88 on
rings inside. irregular-square: 0.8 m, 21 x 21 vertices that are moved by chance, quads cut along the
shorter diagonal. All lie flat in x and z, faces upwards, material coordinates (x, -z) in metres. Needs numpy.
Usage: make_flat_garments.py FOLDER
"""
import pathlib
import sys

import numpy as np


def write(path, points, faces):
    """points: (V, 2), x and z in metres; faces: (F, 3)."""
    with open(path, "w", encoding="ascii") as out:
        for x, z in points:
            out.write(f"v {x:.6g} 0 {z:.6g}\n")
        for x, z in points:
            out.write(f"vt {x:.6g} {-z + 0.0:.6g}\n")
        for a, b, c in faces + 1:
            out.write(f"f {a}/{a} {b}/{b} {c}/{c}\n")


def upwards(points, faces):
    """The faces with their normals along +y."""
    a, b, c = (points[faces[:, k]] for k in range(3))
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    return np.where((area < 0)[:, None], faces, faces[:, ::-1])


def sheet(side, length=1.0):
    axis = np.linspace(0, length, side)
    points = np.stack(np.meshgrid(axis, axis, indexing="ij"), -1).reshape(-1, 2)
    corner = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
    faces = np.concatenate([np.stack([corner, corner + 1, corner + side], 1),
                            np.stack([corner + side, corner + 1, corner + side + 1], 1)])
    return points, upwards(points, faces)


def disk(counts=(60, 36, 26, 16, 9, 1), radii=(0.6, 0.505, 0.395, 0.275, 0.145, 0.0)):
    angles = [2 * np.pi * (np.arange(n) + 0.5 * (ring % 2)) / n for ring, n in enumerate(counts)]
    points = np.concatenate([r * np.stack([np.cos(t), np.sin(t)], 1) for r, t in zip(radii, angles)])
    first = np.concatenate([[0], np.cumsum(counts)])
    faces = []
    for ring in range(len(counts) - 1):
        outer, inner = counts[ring], counts[ring + 1]
        i = j = 0
        while i < outer or j < inner:
            at = first[ring] + i % outer, first[ring + 1] + j % inner
            ahead = first[ring] + (i + 1) % outer, first[ring + 1] + (j + 1) % inner
            cross = [np.linalg.norm(points[ahead[0]] - points[at[1]]), np.linalg.norm(points[ahead[1]] - points[at[0]])]
            if inner == 1 or j == inner or (i < outer and cross[0] <= cross[1]):
                faces.append((at[0], at[1], ahead[0]))
                i += 1
            else:
                faces.append((at[0], at[1], ahead[1]))
                j += 1
            if inner == 1 and i == outer:
                break
    return points, upwards(points, np.array(faces))


def irregular_square(side=21, length=0.8, jitter=0.3, seed=1):
    points, _ = sheet(side, length)
    step = length / (side - 1)
    inside = np.all((points > 1e-9) & (points < length - 1e-9), axis=1)
    points[inside] += np.random.default_rng(seed).uniform(-jitter, jitter, (inside.sum(), 2)) * step
    faces = []
    for i in range(side - 1):
        for j in range(side - 1):
            a = i * side + j
            b, c, d = a + side, a + side + 1, a + 1
            if np.linalg.norm(points[a] - points[c]) < np.linalg.norm(points[b] - points[d]):
                faces += [(a, b, c), (a, c, d)]
            else:
                faces += [(a, b, d), (b, c, d)]
    return points, upwards(points, np.array(faces))


def main():
    folder = pathlib.Path(sys.argv[1] if len(sys.argv) > 1 else pathlib.Path(__file__).parent)
    for name, side in (("sheet-289", 17), ("sheet", 9), ("sheet-25", 5)):
        write(folder / f"{name}.obj", *sheet(side))
    write(folder / "disk.obj", *disk())
    write(folder / "irregular-square.obj", *irregular_square())


if __name__ == "__main__":
    main()
