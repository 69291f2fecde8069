#!/usr/bin/env python3
"""Lets a garment swing, enhances it, and plots what the fine mesh adds: enhance_and_plot.py GARMENT.obj [PLOT.png]"""

import sys

import numpy as np

import pleat

FRAMES = 25

# %% Coarse frames. Here a wave runs through the garment; yours come from your simulator.
garment = pleat.read_obj(sys.argv[1])
rest = garment.positions


def coarse_frames():
    for k in range(FRAMES):
        frame = rest.copy()
        frame[:, 1] += 0.02 * np.sin(6 * rest[:, 0] + 0.16 * k)
        yield frame


# %% Enhance them.
with pleat.connect() as client, client.session(garment) as session:
    print(f"{session.model} on {session.device}: {len(rest)} -> {len(session.fine.positions)} vertices")
    frames = list(session.enhance(coarse_frames()))
    features = session.feature_vertices

# %% How far the coarse vertices are from where they were sent, and what a frame costs.
moved = [np.linalg.norm(fine.positions[features] - coarse, axis=1).mean()
         for fine, coarse in zip(frames, coarse_frames())]
cost = [sum(ms for stage, ms in fine.stage_ms.items() if "." not in stage) for fine in frames]
print(f"feature vertices move {1e3 * np.mean(moved):.2f} mm, a frame costs {np.median(cost):.1f} ms")

# %% Plot.
if len(sys.argv) > 2:
    import matplotlib
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3), tight_layout=True)
    left.plot(1e3 * np.array(moved))
    left.set(xlabel="frame", ylabel="mean move of feature vertices, mm")
    right.plot(cost)
    right.set(xlabel="frame", ylabel="ms in the stages")
    figure.savefig(sys.argv[2], dpi=120)
