"""Pleat from Python: coarse cloth frames in, detailed and collision-free fine frames out, as numpy arrays.

    import pleat

    garment = pleat.read_obj("garment.obj")
    with pleat.connect() as client, client.session(garment) as session:
        for fine in session.enhance(coarse_frames):        # (V, 3) arrays, metres, Y up
            print(fine.index, fine.positions.shape, fine.report.self_intersections_after)

Results and data sets are read as arrays, too: `Result("out/demo/result.h5").enhanced[0]`.
"""

from pleat.client import Client, EnhancedFrame, FrameFailed, Job, PleatError, Session, connect
from pleat.files import Dataset, Result, Sequence
from pleat.mesh import Mesh, Obstacle, capsules, moving_mesh, read_obj, sphere
from pleat.version import __version__

__all__ = [
    "Client", "Dataset", "EnhancedFrame", "FrameFailed", "Job", "Mesh", "Obstacle", "PleatError", "Result", "Sequence",
    "Session", "__version__", "capsules", "connect", "moving_mesh", "read_obj", "sphere"
]
