#!/usr/bin/env python3
"""Writes a small model bundle the way a researcher does (docs/superres.md): make_python_bundle.py FILE.pt

python_bundle.pt beside this file was made by it, with Debian's python3-torch 1.13.
"""
import json
import math
import sys

import torch


class Small(torch.nn.Module):
    def __init__(self):
        super().__init__()
        self.convolution = torch.nn.Conv2d(9, 144, 3, padding=1)
        with torch.no_grad():
            for parameter in self.convolution.parameters():
                values = [0.05 * math.sin(0.37 * i) for i in range(parameter.numel())]
                parameter.copy_(torch.tensor(values).view_as(parameter))

    def forward(self, x):
        detail = torch.nn.functional.pixel_shuffle(torch.tanh(self.convolution(x)), 4)
        return detail + torch.nn.functional.interpolate(x, scale_factor=4.0, mode="bilinear", align_corners=False)


RANGES = {"offset": [-1.0] * 9, "scale": [2.0] * 9}
METADATA = {
    "format": "pleat.bundle",
    "version": 2,
    "name": "python_bundle",
    "architecture": {"kind": "small-from-python"},
    "representation": {
        "geometry_image": {"layout": "LAYOUT_PUBLISHED", "width": 6, "height": 5, "scale": 4},
        "input": RANGES,
        "output": RANGES,
    },
    "topology_hash": "",
    "velocity": "backward",
}

if __name__ == "__main__":
    module = torch.jit.script(Small().eval())
    torch.jit.save(module, sys.argv[1], _extra_files={"pleat.json": json.dumps(METADATA)})
