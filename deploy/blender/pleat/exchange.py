# SPDX-License-Identifier: GPL-3.0-or-later
"""What goes between Blender and Pleat: units, axes, meshes, point caches. Nothing here needs Blender."""

import struct

import numpy as np

_MAGIC = b"POINTCACHE2\0"
_HEADER = struct.Struct("<12siiffi")


def to_pleat(points, scale):
    """(n, 3) in Blender's units, Z up, to metres, Y up."""
    points = np.asarray(points, np.float32).reshape(-1, 3)
    return np.stack([points[:, 0], points[:, 2], -points[:, 1]], axis=1) * np.float32(scale)


class Pc2Writer:
    """A PC2 file that grows. What flush() has counted can be read by others."""

    def __init__(self, path, points):
        self.path, self.points, self.samples = str(path), points, 0
        self._file = open(path, "wb")
        self._file.write(_HEADER.pack(_MAGIC, 1, points, 0.0, 1.0, 0))

    def add(self, positions):
        array = np.ascontiguousarray(positions, "<f4")
        if array.shape != (self.points, 3):
            raise ValueError(f"{self.path}: a sample of shape {array.shape}, not ({self.points}, 3)")
        self._file.write(array.tobytes())
        self.samples += 1

    def flush(self):
        self._file.flush()
        self._file.seek(28)
        self._file.write(struct.pack("<i", self.samples))
        self._file.seek(0, 2)
        self._file.flush()

    def close(self):
        self.flush()
        self._file.close()


def read_pc2(path, sample):
    """One sample, (points, 3)."""
    with open(path, "rb") as file:
        magic, _, points, _, _, samples = _HEADER.unpack(file.read(_HEADER.size))
        if magic != _MAGIC or not 0 <= sample < samples:
            raise ValueError(f"{path}: no sample {sample}")
        file.seek(_HEADER.size + sample * points * 12)
        return np.frombuffer(file.read(points * 12), "<f4").reshape(points, 3)


def write_obj(path, points, faces, uv=None, uv_faces=None):
    """Triangles, with a uv index per corner if there is uv."""
    with open(path, "w", encoding="utf-8") as file:
        file.writelines(f"v {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in points.tolist())
        if uv is None:
            file.writelines(f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in faces.tolist())
        else:
            file.writelines(f"vt {u:.9g} {v:.9g}\n" for u, v in uv.tolist())
            file.writelines("f " + " ".join(f"{v + 1}/{t + 1}" for v, t in zip(face, corner)) + "\n"
                            for face, corner in zip(faces.tolist(), uv_faces.tolist()))


def read_obj(path):
    """Points (n, 3) and triangles (m, 3)."""
    points, faces = [], []
    with open(path, encoding="utf-8") as file:
        for line in file:
            if line.startswith("v "):
                points.append([float(word) for word in line.split()[1:4]])
            elif line.startswith("f "):
                faces.append([int(word.split("/")[0]) - 1 for word in line.split()[1:4]])
    return np.array(points, np.float32), np.array(faces, np.int32)


def to_fine(corners, rounds):
    """Values at the corners of coarse triangles, (F, 3, k), at those of the fine ones, (F 4^rounds, 3, k): the fine
    faces of coarse face f are [f 4^rounds, (f + 1) 4^rounds)."""
    for _ in range(rounds):
        a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        children = [np.stack(child, axis=1) for child in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
        corners = np.stack(children, axis=1).reshape(-1, 3, corners.shape[2])
    return corners


def share_corners(uv_corners):
    """Equal uv of (F, 3, 2) become one: (U, 2) and (F, 3)."""
    flat = np.round(uv_corners.reshape(-1, 2), 6)
    values, index = np.unique(flat, axis=0, return_inverse=True)
    return values.astype(np.float32), index.reshape(-1, 3)


def fit_scale(points, faces, uv_corners):
    """Factors for u and v that give edges their lengths in space best, and how far off edges are then (RMS of the
    logarithm; 0.1 is ten per cent)."""
    space, du, dv = [], [], []
    for i, j in ((0, 1), (1, 2), (2, 0)):
        space.append(np.sum((points[faces[:, i]] - points[faces[:, j]])**2, axis=1))
        edge = (uv_corners[:, i] - uv_corners[:, j])**2
        du.append(edge[:, 0])
        dv.append(edge[:, 1])
    space, du, dv = (np.concatenate(values).astype(np.float64) for values in (space, du, dv))
    known = (space > 0) & (du + dv > 0)
    space, du, dv = space[known], du[known], dv[known]
    if len(space) == 0:
        return np.ones(2), np.inf
    # One factor for both unless two fit far better: an island may be turned.
    one = np.sqrt(np.median(space / (du + dv)))
    candidates = [np.array([one, one])]
    squares = np.linalg.lstsq(np.stack([du, dv], axis=1) / space[:, None], np.ones_like(space), rcond=None)[0]
    if np.all(squares > 0):
        candidates.append(np.sqrt(squares))
    errors = [np.sqrt(np.mean(np.log(np.sqrt((s[0]**2 * du + s[1]**2 * dv) / space))**2)) for s in candidates]
    best = len(candidates) - 1 if errors[-1] < 0.5 * errors[0] else 0
    return candidates[best], float(errors[best])
