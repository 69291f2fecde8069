#!/usr/bin/python3
"""Makes the garments of this folder that a body wears, around a body of deploy/bodies in T pose.

  make-garments.py BODY.glb [FOLDER]

Each has the vertices, boundary edges and Euler characteristic that its paper's table implies, is free of
self-intersections, does not touch the body, and lies flat in metres: rings as a sector of a cone with one seam.
"""
import sys
from pathlib import Path

import numpy as np

from garment_mesh import Body, intersections, length_of, offset_hull, resampled, strip, topology, write_obj
from panels import sew

# name: rings from the waist to the hem, heights of both (m), circumference of the hem (m), and what must come out:
# vertices, Euler characteristic, boundary edges.
SKIRTS = {
    "long-skirt": ([60, 64, 67, 71, 75, 79, 83, 87, 90, 94, 98, 102, 107, 111, 115], 1.03, 0.19, 2.6, (1303, 0, 175)),
    "skirt-219": ([24, 28, 31, 32, 33, 35, 36], 1.03, 0.53, 1.75, (219, 0, 60)),
    "skirt-127": ([20, 26, 27, 27, 27], 1.03, 0.63, 1.45, (127, 0, 47)),
}
# Outlines of a panel seen from the front, from one end of an opening on, counter-clockwise: (points, edges, is an
# opening). name: right half mirrored to the left, height z of the seams, inner points of front and back, what comes out.
T_SHIRT = [
    ([(-0.24, 0.80), (0.24, 0.80)], 10, True),  # hem
    ([(0.24, 0.80), (0.21, 1.00), (0.215, 1.17), (0.235, 1.205), (0.42, 1.215)], 12, False),
    ([(0.42, 1.215), (0.42, 1.395)], 6, True),  # cuff
    ([(0.42, 1.395), (0.20, 1.40), (0.085, 1.41)], 7, False),
    ([(0.085, 1.41), (0.05, 1.375), (-0.05, 1.375), (-0.085, 1.41)], 8, True),  # neck
    ([(-0.085, 1.41), (-0.20, 1.40), (-0.42, 1.395)], 7, False),
    ([(-0.42, 1.395), (-0.42, 1.215)], 6, True),
    ([(-0.42, 1.215), (-0.235, 1.205), (-0.215, 1.17), (-0.21, 1.00), (-0.24, 0.80)], 12, False),
]
TROUSERS = [
    ([(0.10, 0.14), (0.275, 0.14)], 4, True),  # left cuff
    ([(0.275, 0.14), (0.27, 0.5), (0.245, 0.80), (0.165, 1.02)], 15, False),
    ([(0.165, 1.02), (-0.165, 1.02)], 8, True),  # waist
    ([(-0.165, 1.02), (-0.245, 0.80), (-0.27, 0.5), (-0.275, 0.14)], 15, False),
    ([(-0.275, 0.14), (-0.10, 0.14)], 4, True),
    ([(-0.10, 0.14), (-0.05, 0.40), (-0.012, 0.64), (0.0, 0.685), (0.012, 0.64), (0.05, 0.40), (0.10, 0.14)], 22, False),
]
SEWN = {
    "t-shirt": (T_SHIRT, lambda p: 0.03, (76, 76), (246, -2, 60)),
    "trousers": (TROUSERS, lambda p: 0.035, (59, 60), (200, -1, 32)),
}
CLEARANCE = 0.012  # of sewn garments from the body, metres
# Skirts hang on their waist: so near the body at its narrowest that it can't slip over the hips.
WAIST_CLEARANCE = 0.005


def ring_at(body, height, circumference):
    """A loop around the body at that height with that circumference, evenly outside the hull of the section."""
    points = body.section(height)
    distance = WAIST_CLEARANCE
    for _ in range(50):  # the length of an offset hull grows by 2 pi a metre
        distance += (circumference - length_of(offset_hull(points, distance))) / (2 * np.pi)
    return offset_hull(points, distance), distance


def make_skirt(body, counts, top, bottom, hem):
    waist = length_of(offset_hull(body.section(top), WAIST_CLEARANCE))
    heights = np.linspace(top, bottom, len(counts))
    vertices, flat = [], []
    # A sector of a cone: circumference and distance from the waist grow together.
    slant = np.hypot(top - bottom, (hem - waist) / (2 * np.pi))
    angle, inner = (hem - waist) / slant, waist * slant / (hem - waist)
    for count, height, part in zip(counts, heights, np.linspace(0, 1, len(counts))):
        loop, distance = ring_at(body, height, waist + part * (hem - waist))
        assert distance > 0.004, f"the ring at {height:.2f} m is too tight ({distance * 1000:.0f} mm)"
        ring = resampled(loop, count)
        vertices += [[x, height, z] for x, z in ring]
        radius = inner + part * slant
        turns = angle * np.arange(count + 1) / count
        # The other way round it would show the inside.
        flat += [[radius * np.cos(turn), -radius * np.sin(turn)] for turn in turns]
    vertices, flat = np.array(vertices), np.array(flat)
    starts, flat_starts = np.cumsum([0, *counts]), np.cumsum([0] + [count + 1 for count in counts])
    faces, flat_faces = [], []
    for k in range(len(counts) - 1):
        for corners in strip(counts[k], counts[k + 1], k, k + 1):
            # Rings run from x to z: this order looks outwards.
            faces.append([starts[ring] + index % counts[ring] for ring, index in corners[::-1]])
            flat_faces.append([flat_starts[ring] + index for ring, index in corners[::-1]])
    return vertices, np.array(faces), flat, np.array(flat_faces)


def check(name, body, vertices, faces, flat, flat_faces, expected):
    euler, boundary = topology(faces, len(vertices))
    found = (len(vertices), euler, boundary)
    assert found == expected, f"{name} has {found}, not {expected}"
    touching = intersections(vertices, faces, body.vertices, body.faces)
    assert not touching, f"{name} cuts the body in {len(touching)} places, face {touching[0][0]} first"
    assert not intersections(vertices, faces, vertices, faces, same=True), f"{name} cuts itself"
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    outward = np.cross(b - a, c - a) * ((a + b + c) / 3 - vertices.mean(axis=0)) * [1, 0, 1]
    assert outward.sum() > 0, f"{name} is inside out"
    a, b, c = (flat[flat_faces[:, k]] for k in range(3))
    area = np.cross(b - a, c - a)
    assert (area > 0).all(), f"{name} is folded or mirrored in its flat layout"
    edges, flat_edges = (np.vstack([f[:, [0, 1]], f[:, [1, 2]], f[:, [2, 0]]]) for f in (faces, flat_faces))
    worn = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    lying = np.linalg.norm(flat[flat_edges[:, 0]] - flat[flat_edges[:, 1]], axis=1)
    low, middle, high = np.percentile(worn / lying, [2, 50, 98])
    print(f"{name}: {found[0]} vertices, {len(faces)} faces, edges of {lying.mean() * 1000:.0f} mm, "
          f"worn over flat {low:.3f} {middle:.3f} {high:.3f}")


def main():
    body = Body(Path(sys.argv[1]))
    folder = Path(sys.argv[2]) if len(sys.argv) > 2 else Path(__file__).parent
    made = {}
    for name, (outline, heights, interiors, expected) in SEWN.items():
        made[name] = (*sew(body, outline, heights, interiors, CLEARANCE, seed=7), expected)
    for name, (counts, top, bottom, hem, expected) in SKIRTS.items():
        made[name] = (*make_skirt(body, counts, top, bottom, hem), expected)
    for name, (vertices, faces, flat, flat_faces, expected) in made.items():
        check(name, body, vertices, faces, flat, flat_faces, expected)
        comment = f"{name}: {expected[0]} vertices, {len(faces)} faces, {expected[2]} boundary edges, for young-female.glb"
        write_obj(folder / f"{name}.obj", comment, vertices, faces, flat, flat_faces)


if __name__ == "__main__":
    main()
