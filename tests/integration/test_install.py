#!/usr/bin/env python3
"""test_install.py BUILD: what is installed into an empty prefix works from another folder, without the source tree."""
import os
import pathlib
import subprocess
import sys
import tempfile

GARMENT = """v 0 0 0
v 0.2 0 0
v 0 0 0.2
v 0.2 0 0.2
vt 0 0.2
vt 0.2 0.2
vt 0 0
vt 0.2 0
f 1/1 3/3 2/2
f 2/2 3/3 4/4
"""


def main():
    build = pathlib.Path(sys.argv[1]).resolve()
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        prefix = folder / "usr"
        subprocess.run(["cmake", "--install", build, "--prefix", prefix], check=True, stdout=subprocess.DEVNULL)
        home = folder / "home"
        home.mkdir()
        (home / "cloth.obj").write_text(GARMENT)
        environment = {"PATH": f"{prefix}/bin:/usr/bin:/bin", "HOME": str(home), "LANG": "C"}
        if "XDG_RUNTIME_DIR" in os.environ:
            environment["XDG_RUNTIME_DIR"] = os.environ["XDG_RUNTIME_DIR"]

        def pleat(*words):
            done = subprocess.run(["pleat", *map(str, words)], cwd=home, env=environment, capture_output=True, text=True,
                                  timeout=200)
            assert done.returncode == 0, f"pleat {' '.join(map(str, words))}: {done.returncode}\n{done.stderr}"
            return done.stdout

        share = prefix / "share" / "pleat"
        assert pleat("check", share / "garments" / "skirt.obj", "cloth.obj").count("islands") == 2
        # The shipped fabric, cloth and bundle, none of them named.
        pleat("dataset", "generate", "set", "--garment", "cloth.obj", "--set", "hitting", "--train", 1, "--test", 0,
              "--frames", 3, "--workers", 1)
        assert "3 frames" in pleat("dataset", "info", "set")
        pleat("run", share / "scenes" / "draping.json", "--frames", 3, "--out", "result")
        assert (home / "result" / "report.html").stat().st_size > 100_000
        pleat("export", "result/result.h5", "--format", "glb")
        assert (home / "result" / "glb" / "enhanced.glb").read_bytes()[:4] == b"glTF"
        outside = [path for path in folder.rglob("*") if path.suffix in (".h5", ".partial") and home not in path.parents]
        assert not outside, outside
    print("installed programs work")


main()
