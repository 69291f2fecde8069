#!/usr/bin/env python3
"""Exports as others see them, and back: BUILD_FOLDER PLEAT. Exit code 77: no npm, or it gets no packages."""

import json
import pathlib
import shutil
import subprocess
import sys
import tempfile

import h5py
import numpy

HERE = pathlib.Path(__file__).resolve().parent
SOURCE = HERE.parents[2]
FRAMES = 5


def run(*words):
    done = subprocess.run([str(word) for word in words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 0, f"{words}: exit code {done.returncode}: {done.stderr}"
    return done.stdout


def checkers(build):
    """The folder with the packages of package.json, installed once for a build; None without npm or network."""
    folder = build / "format_checkers"
    if shutil.which("npm") is None:
        return None
    folder.mkdir(exist_ok=True)
    for name in ("package.json", "package-lock.json", "check_formats.mjs"):
        shutil.copy(HERE / name, folder)
    lock = (HERE / "package-lock.json").read_text()
    installed = folder / "installed"
    if not installed.exists() or installed.read_text() != lock:
        done = subprocess.run(["npm", "ci", "--silent", "--no-audit", "--no-fund"], cwd=folder, timeout=120)
        if done.returncode != 0:
            return None
        installed.write_text(lock)
    return folder


def main():
    build, pleat = (pathlib.Path(argument).resolve() for argument in sys.argv[1:3])
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        scene = SOURCE / "deploy/scenes/draping.json"
        run(pleat, "run", scene, "--frames", FRAMES, "--detail", "none", "--out", folder)
        result = folder / "result.h5"
        with h5py.File(result) as file:
            fine_vertices, fine_faces = len(file["topology/fine/rest_positions"]), len(file["topology/fine/faces"])
            coarse = file["coarse/positions"][:]

        # Coarse frames go out and come back, whatever file they went through.
        for kind in ("glb", "usda", "abc", "mdd"):
            run(pleat, "export", result, "--format", kind, "--which", "coarse")
            back = folder / f"back-{kind}"
            run(pleat, "enhance", "--rest", SOURCE / "deploy/garments/tablecloth.obj", "--detail", "none", "--frames",
                folder / kind / f"coarse.{kind}", "--out", back)
            with h5py.File(back / "result.h5") as file:
                assert numpy.abs(file["coarse/positions"][:] - coarse).max() < 1e-6, kind
                assert abs(file.attrs["frame_time_s"] - 0.04) < 1e-6, (kind, file.attrs["frame_time_s"])

        run(pleat, "export", result, "--format", "glb")
        run(pleat, "export", result, "--format", "usdz", "--scale", "0.01", "--up", "z")
        packages = checkers(build)
        if packages is None:
            print("npm or its packages are not to be had: glTF and USDZ are not checked")
            return 77
        words = ["node", packages / "check_formats.mjs", folder / "glb/enhanced.glb", folder / "usdz/enhanced.usdz"]
        said = json.loads(run(*words).splitlines()[-1])
        issues = said["gltf"]["issues"]
        assert issues["numErrors"] == 0 and issues["numWarnings"] == 0, json.dumps(issues, indent=1)[:4000]
        assert said["gltf"]["info"]["totalTriangleCount"] == fine_faces, said["gltf"]["info"]
        assert said["gltf"]["info"]["animationCount"] == 1 and said["gltf"]["info"]["hasMorphTargets"]
        assert said["usdz"]["read"] and said["usdz"]["meshes"] == 1, said["usdz"]
        assert said["usdz"]["corners"] == 3 * fine_faces, said["usdz"]
        assert said["usdz"]["points"] >= fine_vertices, said["usdz"]
    return 0


sys.exit(main())
