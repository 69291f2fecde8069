"""Meshes and obstacles in numpy arrays. Metres, Y up, right-handed, counter-clockwise faces."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from typing import Any, Callable, List, Optional, Tuple

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float32]
Indices = npt.NDArray[np.uint32]


@dataclass
class Mesh:
    """What stays constant of a garment."""

    positions: Floats  #: (V, 3) at rest
    faces: Indices  #: (F, 3) vertex indices
    uv: Floats = field(default_factory=lambda: np.zeros((0, 2), np.float32))  #: (U, 2) material coordinates in metres
    uv_faces: Indices = field(default_factory=lambda: np.zeros((0, 3), np.uint32))  #: (F, 3) indices into uv

    def __post_init__(self) -> None:
        self.positions = _shaped(self.positions, np.float32, 3, "positions")
        self.faces = _shaped(self.faces, np.uint32, 3, "faces")
        self.uv = _shaped(self.uv, np.float32, 2, "uv")
        self.uv_faces = _shaped(self.uv_faces, np.uint32, 3, "uv_faces")
        for name, indices, count in (("faces", self.faces, len(self.positions)), ("uv_faces", self.uv_faces, len(self.uv))):
            if indices.size and int(indices.max()) >= count:
                raise ValueError(f"{name} names {int(indices.max())} of {count}")


@dataclass
class Obstacle:
    """An obstacle of a session. `frame(k)` gives what is in frame k: see sphere(), capsules(), moving_mesh()."""

    name: str
    faces: Indices
    capsules: int
    frame: Callable[[int], "ObstacleState"]


@dataclass
class ObstacleState:
    """An obstacle in one frame: a sphere (radius above 0), a mesh, or capsules."""

    center: Tuple[float, float, float] = (0.0, 0.0, 0.0)
    radius: float = 0.0
    positions: Optional[Floats] = None  #: (V, 3)
    capsule_ends: Optional[Floats] = None  #: (C, 2, 3)
    capsule_radii: Optional[Floats] = None  #: (C,)


_NO_FACES = np.zeros((0, 3), np.uint32)


def sphere(name: str, centers: npt.ArrayLike, radius: float) -> Obstacle:
    """A sphere with its centre in each frame, (T, 3), or one that rests, (3,). After the last frame it stays."""
    path = np.asarray(centers, np.float64).reshape(-1, 3)
    return Obstacle(name, _NO_FACES, 0,
                    lambda k: ObstacleState(center=_point(path[min(k, len(path) - 1)]), radius=float(radius)))


def capsules(name: str, ends: npt.ArrayLike, radii: npt.ArrayLike) -> Obstacle:
    """Capsules by their ends in each frame, (T, C, 2, 3), or at rest, (C, 2, 3), and radii (C,)."""
    thick = np.asarray(radii, np.float32).reshape(-1)
    path = np.asarray(ends, np.float32).reshape(-1, len(thick), 2, 3)
    return Obstacle(name, _NO_FACES, len(thick),
                    lambda k: ObstacleState(capsule_ends=path[min(k, len(path) - 1)], capsule_radii=thick))


def moving_mesh(name: str, faces: npt.ArrayLike, positions: npt.ArrayLike) -> Obstacle:
    """A closed mesh: faces (F, 3), and positions in each frame, (T, V, 3), or at rest, (V, 3)."""
    points = np.asarray(positions, np.float32)
    path = points if points.ndim == 3 else points[np.newaxis]
    return Obstacle(name, _shaped(faces, np.uint32, 3, "faces"), 0,
                    lambda k: ObstacleState(positions=path[min(k, len(path) - 1)]))


def read_obj(path: "str | os.PathLike[str]") -> Mesh:
    """The mesh of an OBJ file: v, vt and f, polygons cut into fans. `pleat check` says what is wrong with a garment."""
    positions: List[List[float]] = []
    uv: List[List[float]] = []
    faces: List[List[int]] = []
    uv_faces: List[List[int]] = []
    with open(path, encoding="utf-8-sig") as file:
        for line in file:
            words = line.split()
            if not words:
                continue
            if words[0] == "v":
                positions.append([float(word) for word in words[1:4]])
            elif words[0] == "vt":
                uv.append([float(word) for word in words[1:3]])
            elif words[0] == "f":
                corners = [word.split("/") for word in words[1:]]
                vertices = [_index(corner[0], len(positions)) for corner in corners]
                faces += [[vertices[0], b, c] for b, c in zip(vertices[1:], vertices[2:])]
                if all(len(corner) > 1 and corner[1] for corner in corners):
                    places = [_index(corner[1], len(uv)) for corner in corners]
                    uv_faces += [[places[0], b, c] for b, c in zip(places[1:], places[2:])]
    if not faces:
        raise ValueError(f"{os.fspath(path)}: no faces")
    if len(uv_faces) != len(faces):
        uv, uv_faces = [], []
    return Mesh(np.array(positions, np.float32), np.array(faces, np.uint32), np.array(uv, np.float32),
                np.array(uv_faces, np.uint32))


def _point(values: npt.NDArray[np.float64]) -> Tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])


def _index(word: str, count: int) -> int:
    number = int(word)
    return number - 1 if number > 0 else count + number


def _shaped(values: npt.ArrayLike, dtype: npt.DTypeLike, columns: int, name: str) -> npt.NDArray[Any]:
    array = np.ascontiguousarray(values, dtype)
    if array.size == 0:
        return np.zeros((0, columns), dtype)
    if array.ndim != 2 or array.shape[1] != columns:
        raise ValueError(f"{name}: shape {array.shape} instead of (n, {columns})")
    return array
