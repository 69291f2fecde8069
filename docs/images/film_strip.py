#!/usr/bin/python3
"""A film strip of a data set's sequence: coarse frames above, fine ones below, as a PNG.

    docs/images/film_strip.py DATASET SEQUENCE OUT.png [FRAME...]

Needs Debian's python3-numpy and python3-h5py.
"""
import struct
import sys
import zlib

import h5py
import numpy as np

SIZE = 300  # pixels of one picture
LIGHT = np.array([0.4, 0.7, 0.6]) / np.linalg.norm([0.4, 0.7, 0.6])
CLOTH, OBSTACLE, BACKGROUND = np.array([90, 130, 200]), np.array([215, 160, 110]), 245


def write_png(path, image):
    rows = b"".join(b"\0" + row.tobytes() for row in image)

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", image.shape[1], image.shape[0], 8, 2, 0, 0, 0)
    with open(path, "wb") as file:
        file.write(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows, 9)) + chunk(b"IEND", b""))


def vertex_normals(points, faces):
    a, b, c = (points[faces[:, k]] for k in range(3))
    face_normals = np.cross(b - a, c - a)
    normals = np.zeros_like(points)
    for k in range(3):
        np.add.at(normals, faces[:, k], face_normals)
    return normals / (np.linalg.norm(normals, axis=1, keepdims=True) + 1e-12)


class Picture:
    """An orthographic view of a box of space, with a depth buffer."""

    def __init__(self, low, high, azimuth=0.6, elevation=0.35):
        ca, sa, ce, se = np.cos(azimuth), np.sin(azimuth), np.cos(elevation), np.sin(elevation)
        self.rotation = np.array([[ca, 0, sa], [se * sa, ce, -se * ca], [-ce * sa, se, ce * ca]])
        self.center = (low + high) / 2
        self.scale = 0.95 * SIZE / np.linalg.norm(high - low)
        self.image = np.full((SIZE, SIZE, 3), BACKGROUND, np.uint8)
        self.depth = np.full((SIZE, SIZE), -np.inf)

    def draw(self, points, faces, colour):
        view = (points - self.center) @ self.rotation.T
        x, y, z = SIZE / 2 + view[:, 0] * self.scale, SIZE / 2 - view[:, 1] * self.scale, view[:, 2]
        shade = 0.2 + 0.8 * np.abs(vertex_normals(points, faces) @ LIGHT)
        for i, j, k in faces:
            x0, x1 = max(0, int(np.floor(min(x[i], x[j], x[k])))), min(SIZE - 1, int(np.ceil(max(x[i], x[j], x[k]))))
            y0, y1 = max(0, int(np.floor(min(y[i], y[j], y[k])))), min(SIZE - 1, int(np.ceil(max(y[i], y[j], y[k]))))
            double_area = (x[j] - x[i]) * (y[k] - y[i]) - (x[k] - x[i]) * (y[j] - y[i])
            if x1 < x0 or y1 < y0 or abs(double_area) < 1e-9:
                continue
            px, py = np.meshgrid(np.arange(x0, x1 + 1), np.arange(y0, y1 + 1))
            b = ((px - x[i]) * (y[k] - y[i]) - (x[k] - x[i]) * (py - y[i])) / double_area
            c = ((x[j] - x[i]) * (py - y[i]) - (px - x[i]) * (y[j] - y[i])) / double_area
            a = 1 - b - c
            depth = a * z[i] + b * z[j] + c * z[k]
            here = self.depth[y0 : y1 + 1, x0 : x1 + 1]
            seen = (np.minimum(np.minimum(a, b), c) >= -0.01) & (depth > here)
            here[seen] = depth[seen]
            light = (a * shade[i] + b * shade[j] + c * shade[k])[seen, None]
            self.image[y0 : y1 + 1, x0 : x1 + 1][seen] = np.clip(light * colour, 0, 255).astype(np.uint8)


def sphere(center, radius, rings=16, sectors=24):
    u, v = np.meshgrid(np.linspace(0, np.pi, rings + 1), np.arange(sectors) * 2 * np.pi / sectors, indexing="ij")
    points = center + radius * np.stack([np.sin(u) * np.cos(v), np.cos(u), np.sin(u) * np.sin(v)], -1).reshape(-1, 3)
    faces = []
    for r in range(rings):
        for s in range(sectors):
            a, b = r * sectors + s, r * sectors + (s + 1) % sectors
            faces += [[a, b, a + sectors], [b, b + sectors, a + sectors]]
    return points, np.array(faces)


def main():
    if len(sys.argv) < 4:
        sys.exit(__doc__.strip())
    folder, name, out = sys.argv[1:4]
    with h5py.File(f"{folder}/dataset.h5") as master, h5py.File(f"{folder}/sequences/{name}.h5") as sequence:
        count = sequence["coarse/positions"].shape[0]
        frames = [int(a) for a in sys.argv[4:]] or [round(f * (count - 1)) for f in (0.1, 0.3, 0.5, 0.7, 0.95)]
        strip = {level: [] for level in ("coarse", "fine")}
        everything = sequence["coarse/positions"][frames].reshape(-1, 3)
        low, high = everything.min(0), everything.max(0)
        for level, pictures in strip.items():
            meshes = sequence if "topology" in sequence else master
            faces = meshes[f"topology/{level}/faces"][:].astype(int)
            for frame in frames:
                picture = Picture(low.astype(float), high.astype(float))
                for obstacle in sequence.get("obstacles", {}).values():
                    if "center" in obstacle:
                        picture.draw(*sphere(obstacle["center"][frame], float(obstacle["radius"][frame])), OBSTACLE)
                    elif "positions" in obstacle:
                        picture.draw(obstacle["positions"][frame].astype(float), obstacle["faces"][:].astype(int), OBSTACLE)
                picture.draw(sequence[f"{level}/positions"][frame].astype(float), faces, CLOTH)
                pictures.append(picture.image)
        write_png(out, np.ascontiguousarray(np.vstack([np.hstack(row) for row in strip.values()])))


if __name__ == "__main__":
    main()
