"""Results and data sets as arrays (docs/file-formats.md of Pleat). Nothing is read before it is indexed."""

from __future__ import annotations

import os
import pathlib
from typing import Any, List

import h5py
import numpy as np
import numpy.typing as npt

from pleat.mesh import Mesh


class _Frames:
    """A file with one array of shape (T, V, 3) per mesh, of which the first `frames` are complete."""

    def __init__(self, path: "str | os.PathLike[str]") -> None:
        self.path = pathlib.Path(path)
        self._file = h5py.File(self.path, "r")
        self.frames = int(self._file.attrs["frames_complete"])

    def close(self) -> None:
        self._file.close()

    def __enter__(self) -> Any:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __len__(self) -> int:
        return self.frames

    @property
    def coarse(self) -> h5py.Dataset:
        """(T, V_coarse, 3) metres."""
        return self._file["coarse/positions"]

    @property
    def fine(self) -> h5py.Dataset:
        """(T, V_fine, 3) metres, as simulated; KeyError if the file has none."""
        return self._file["fine/positions"]

    @property
    def times(self) -> npt.NDArray[np.float64]:
        """(T,) seconds."""
        return np.asarray(self._file["time_s"][:self.frames])


class Result(_Frames):
    """result.h5 of `pleat run` and `pleat enhance`, finished or .partial."""

    @property
    def enhanced(self) -> h5py.Dataset:
        """(T, V_fine, 3) metres."""
        return self._file["enhanced/positions"]

    @property
    def model(self) -> str:
        return str(self._file.attrs["model"])

    def mesh(self, which: str = "fine") -> Mesh:
        """The coarse or the fine mesh at rest."""
        return _mesh(self._file["topology"][which])

    def stage_ms(self, stage: str) -> npt.NDArray[np.floating[Any]]:
        """(T,) milliseconds of a stage, for example "superres"."""
        return np.asarray(self._file[f"stages/{stage}/ms"][:self.frames])

    def count(self, name: str) -> npt.NDArray[np.unsignedinteger[Any]]:
        """(T,) numbers per frame, for example "self_intersections"."""
        return np.asarray(self._file[f"counts/{name}"][:self.frames])


class Sequence(_Frames):
    """A sequence of a data set."""

    @property
    def split(self) -> str:
        """"train" or "test"."""
        return str(self._file.attrs["split"])


class Dataset:
    """A folder with paired coarse and fine sequences."""

    def __init__(self, folder: "str | os.PathLike[str]") -> None:
        self.folder = pathlib.Path(folder)
        with h5py.File(self.folder / "dataset.h5", "r") as master:
            self.frame_time_s = float(master.attrs["frame_time_s"])
            self.coarse = _mesh(master["topology/coarse"])
            self.fine = _mesh(master["topology/fine"])
            self.feature_vertices: npt.NDArray[np.uint32] = master["topology/feature_vertices"][:]
            names = sorted(master["sequences"])
        #: Those that are finished.
        self.names: List[str] = [name for name in names if self._file(name).exists()]

    def _file(self, name: str) -> pathlib.Path:
        return self.folder / "sequences" / f"{name}.h5"

    def __getitem__(self, name: str) -> Sequence:
        return Sequence(self._file(name))


def _mesh(group: h5py.Group) -> Mesh:
    return Mesh(group["rest_positions"][:], group["faces"][:], group["uv"][:], group["uv_faces"][:])
