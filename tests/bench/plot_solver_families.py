#!/usr/bin/env python3
"""Draws error against milliseconds from the JSON of bench_solver_families.

usage: plot_solver_families.py FAMILIES.json [docs/images/solver-families.png]
Needs python3-matplotlib.
"""
import json
import sys

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402

STYLES = {
    "engine": ("implicit Euler (engine): steps a frame", "tab:blue", "o"),
    "XPBD": ("small-step XPBD: sub-steps", "tab:orange", "s"),
    "block descent": ("vertex block descent: steps x sweeps", "tab:green", "^"),
    "block descent, Chebyshev": ("with Chebyshev's acceleration", "tab:red", "v"),
}


def label(row):
    return row["parameters"].replace(" sub-steps", "").replace(" steps", "").replace(" sweeps", "").replace(" x ", "×")


def draw(axes, rows, error, frame):
    for family, (name, colour, marker) in STYLES.items():
        points = [r for r in rows if r["family"] == family and not r["converged"]]
        line = "-" if family in ("engine", "XPBD") else ""
        axes.plot([r["ms"] for r in points], [r[error] for r in points], line + marker, color=colour, label=name, ms=4)
        for r in points:
            axes.annotate(label(r), (r["ms"], r[error]), (3, 3), textcoords="offset points", fontsize=6, color=colour)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel("processor milliseconds a frame, one thread")
    axes.set_title(f"after {frame} frames", fontsize=9)
    axes.grid(True, which="both", alpha=0.25)


def main():
    report = json.load(open(sys.argv[1]))
    image = sys.argv[2] if len(sys.argv) > 2 else "docs/images/solver-families.png"
    rows = [r for r in report["rows"] if r["contact"]]
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4.2))
    draw(left, rows, "rms_engine_middle_mm", report["frames"] // 2)
    draw(right, rows, "rms_engine_mm", report["frames"])
    left.set_ylabel("RMS error, mm")
    left.legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(image, dpi=90)


if __name__ == "__main__":
    main()
