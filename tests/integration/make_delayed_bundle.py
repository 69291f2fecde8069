#!/usr/bin/env python3
"""Writes a bundle that reads a window of three frames and answers the oldest: make_delayed_bundle.py FILE.pt

models/delayed.pt beside this file was made by it, with Debian's python3-torch 1.13.
"""
import json
import sys

import torch


class Delayed(torch.nn.Module):
    def forward(self, x):  # (N, 3 * 9, h, w), the oldest frame first
        return torch.nn.functional.interpolate(x[:, 0:9], scale_factor=4.0, mode="bilinear", align_corners=False)


RANGES = {"offset": [0.0] * 9, "scale": [1.0] * 9}
METADATA = {
    "format": "pleat.bundle",
    "version": 2,
    "name": "delayed",
    "architecture": {"kind": "delayed-by-two-frames"},
    "representation": {
        "geometry_image": {"layout": "LAYOUT_PUBLISHED", "scale": 4},
        "window": 3,
        "input": RANGES,
        "output": RANGES,
    },
    "topology_hash": "",
    "velocity": "backward",
}

if __name__ == "__main__":
    module = torch.jit.script(Delayed().eval())
    torch.jit.save(module, sys.argv[1], _extra_files={"pleat.json": json.dumps(METADATA)})
