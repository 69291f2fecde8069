"""Meshes of garments around a body: sections of the body, rings, panels, and what must be true of the result."""
import json
import struct

import numpy as np

ARMS = ("Arm", "ForeArm", "Hand", "FingerBase", "HandFinger1", "Thumb", "Shoulder")


class Body:
    """A skinned GLB of deploy/bodies at rest."""

    def __init__(self, path):
        data = path.read_bytes()
        length = struct.unpack("<I", data[12:16])[0]
        description, blob = json.loads(data[20 : 20 + length]), data[28 + length :]

        def array(accessor):
            info = description["accessors"][accessor]
            view = description["bufferViews"][info["bufferView"]]
            kind = {5121: "<u1", 5123: "<u2", 5126: "<f4"}[info["componentType"]]
            width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}[info["type"]]
            return np.frombuffer(blob, kind, info["count"] * width, view["byteOffset"]).reshape(-1, width)

        primitive = description["meshes"][0]["primitives"][0]
        self.vertices = array(primitive["attributes"]["POSITION"]).astype(float)
        self.faces = array(primitive["indices"]).reshape(-1, 3).astype(int)
        joints, weights = array(primitive["attributes"]["JOINTS_0"]), array(primitive["attributes"]["WEIGHTS_0"])
        names = [node["name"] for node in description["nodes"]]
        self.part = np.array([names[j] for j in joints[np.arange(len(joints)), weights.argmax(axis=1)]])
        self.places = {}
        self._place(description["nodes"], 0, np.zeros(3))

    def _place(self, nodes, index, above):
        here = above + nodes[index].get("translation", [0, 0, 0])
        self.places[nodes[index]["name"]] = here
        for child in nodes[index].get("children", []):
            self._place(nodes, child, here)

    def section(self, height, limbs=False):
        """Points (x, z) where edges cross the plane y = height, without the arms unless asked for."""
        edges = np.vstack([self.faces[:, [0, 1]], self.faces[:, [1, 2]], self.faces[:, [2, 0]]])
        if not limbs:
            arm = np.array([any(name.endswith(word) for word in ARMS) for name in self.part])
            edges = edges[~arm[edges].any(axis=1)]
        a, b = self.vertices[edges[:, 0]], self.vertices[edges[:, 1]]
        crossing = (a[:, 1] - height) * (b[:, 1] - height) < 0
        a, b = a[crossing], b[crossing]
        fraction = ((height - a[:, 1]) / (b[:, 1] - a[:, 1]))[:, None]
        return (a + fraction * (b - a))[:, [0, 2]]


def convex_hull(points):
    """Counter-clockwise corners (monotone chain)."""
    points = sorted(map(tuple, points))

    def half(ordered):
        chain = []
        for point in ordered:
            while len(chain) > 1 and np.cross(np.subtract(chain[-1], chain[-2]), np.subtract(point, chain[-2])) <= 0:
                chain.pop()
            chain.append(point)
        return chain[:-1]

    return np.array(half(points) + half(points[::-1]))


def offset_hull(points, distance, count=720):
    """The loop at `distance` outside the hull of `points`, in `count` directions; it starts at the back, where x is 0."""
    angles = -np.pi / 2 + 2 * np.pi * np.arange(count) / count
    directions = np.column_stack([np.cos(angles), np.sin(angles)])
    hull = convex_hull(points)
    loop = hull[(hull @ directions.T).argmax(axis=0)] + distance * directions
    after = next(k for k in range(count) if loop[k - 1, 0] < 0 <= loop[k, 0] and loop[k, 1] < hull[:, 1].mean())
    before, here = loop[after - 1], loop[after]
    back = before + (here - before) * before[0] / (before[0] - here[0])
    return np.vstack([back, loop[after:], loop[:after]])


def length_of(loop):
    return np.linalg.norm(np.roll(loop, -1, axis=0) - loop, axis=1).sum()


def resampled(loop, count):
    """`count` points evenly spread along a closed loop, the first one kept."""
    steps = np.linalg.norm(np.roll(loop, -1, axis=0) - loop, axis=1)
    along = np.concatenate([[0], np.cumsum(steps)])
    closed = np.vstack([loop, loop[:1]])
    wanted = along[-1] * np.arange(count) / count
    return np.column_stack([np.interp(wanted, along, closed[:, k]) for k in range(loop.shape[1])])


def strip(first, second, first_start, second_start):
    """Triangles between two rings of any counts whose vertices 0 are opposite, as (ring, index) pairs; index count = 0."""
    i = j = 0
    triangles = []
    while i < first or j < second:
        if j == second or (i < first and (i + 0.5) / first <= (j + 0.5) / second):
            triangles.append([(0, i), (1, j), (0, i + 1)])
            i += 1
        else:
            triangles.append([(0, i), (1, j), (1, j + 1)])
            j += 1
    starts = (first_start, second_start)
    return [[(starts[ring], index) for ring, index in triangle] for triangle in triangles]


def write_obj(path, comment, vertices, faces, uv, uv_faces):
    with open(path, "w") as file:
        file.write(f"# {comment}\n# Metres. vt: material coordinates, metres. Made by make-garments.py, Apache-2.0.\n")
        for x in vertices:
            file.write("v %.6f %.6f %.6f\n" % tuple(x))
        for x in uv:
            file.write("vt %.6f %.6f\n" % tuple(x))
        for corner, flat in zip(faces, uv_faces):
            file.write("f " + " ".join(f"{a + 1}/{b + 1}" for a, b in zip(corner, flat)) + "\n")


def topology(faces, count):
    """Euler characteristic and number of boundary edges; every edge in one or two faces."""
    edges = np.sort(np.vstack([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    unique, times = np.unique(edges, axis=0, return_counts=True)
    assert times.max() <= 2, "an edge in more than two faces"
    return count - len(unique) + len(faces), int((times == 1).sum())


def _meets(p, q, a, b, c):
    """Whether segments meet triangles, row by row (Moeller and Trumbore)."""
    direction, e1, e2, s = q - p, b - a, c - a, p - a
    cross = np.cross(direction, e2)
    determinant = (e1 * cross).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = (s * cross).sum(axis=1) / determinant
        other = np.cross(s, e1)
        v = (direction * other).sum(axis=1) / determinant
        t = (e2 * other).sum(axis=1) / determinant
    return (np.abs(determinant) > 1e-15) & (u >= 0) & (v >= 0) & (u + v <= 1) & (t >= 0) & (t <= 1)


def intersections(vertices, faces, other_vertices, other_faces, same=False):
    """Pairs (face, other face) that cut each other; faces with a common vertex are left out for `same` meshes."""
    a, b = vertices[faces], other_vertices[other_faces]
    low, high = b.min(axis=1), b.max(axis=1)
    pairs = []
    for f in range(len(faces)):
        near = ((low <= a[f].max(axis=0)) & (high >= a[f].min(axis=0))).all(axis=1)
        if same:
            near[: f + 1] = False
            near &= ~np.isin(other_faces, faces[f]).any(axis=1)
        others = np.flatnonzero(near)
        if len(others) == 0:
            continue
        mine = np.broadcast_to(a[f], (len(others), 3, 3))
        cut = np.zeros(len(others), bool)
        for k in range(3):
            n = (k + 1) % 3
            theirs = b[others]
            cut |= _meets(mine[:, k], mine[:, n], theirs[:, 0], theirs[:, 1], theirs[:, 2])
            cut |= _meets(theirs[:, k], theirs[:, n], mine[:, 0], mine[:, 1], mine[:, 2])
        pairs += [(f, other) for other in others[cut]]
    return pairs
