#!/usr/bin/env python3
"""test_install.py SOURCE BUILD: what is installed into an empty prefix works from another folder, without the source tree:
the programs, a C++ program by find_package and by pkg-config, and a Python program."""
import os
import pathlib
import re
import shutil
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


def check_clients(source, prefix, home, environment):
    """A program in C++ and one in Python, both against one `pleat up`."""

    def run(*words, **more):
        done = subprocess.run([str(word) for word in words], cwd=home, env=environment | more, capture_output=True,
                              text=True, timeout=200)
        assert done.returncode == 0, f"{words}: exit code {done.returncode}\n{done.stdout}\n{done.stderr}"
        return done.stdout

    program = home / "consumer"
    program.mkdir()
    for name in ("tests/integration/consumer/CMakeLists.txt", "common/client/cpp/example/enhance.cpp",
                 "common/client/python/example/enhance_and_plot.py"):
        shutil.copy(source / name, program)
    # No flag of ours: the library keeps its own apart.
    run("cmake", "-S", program, "-B", program / "build", f"-DCMAKE_PREFIX_PATH={prefix}")
    run("cmake", "--build", program / "build")
    config = next(prefix.rglob("pleat.pc"))
    flags = run("pkg-config", "--cflags", "--libs", "pleat", PKG_CONFIG_PATH=str(config.parent)).split()
    include = next(flag[2:] for flag in flags if flag.startswith("-I") and str(prefix) in flag)
    assert (pathlib.Path(include) / "pleat/client.hpp").is_file() and "-lpleat-client" in flags, flags
    headers = list((prefix / "include").rglob("*.h*"))
    assert headers and not any(re.search(r"#\s*include\s*<Eigen", path.read_text()) for path in headers)

    garment = prefix / "share/pleat/garments/tablecloth.obj"
    up = subprocess.Popen(["pleat", "up", "--data", home / "services"], cwd=home, env=environment, stdout=subprocess.PIPE,
                          text=True)
    try:
        address = next((line.split()[1] for line in up.stdout if line.startswith("ready ")), None)
        assert address, f"`pleat up` ended before it was ready, exit code {up.wait()}"
        said = run(program / "build/enhance", address, garment, 4, "fine.obj")
        assert "749 -> 11393 vertices" in said and said.count(" 0 self-intersections") == 4, said
        packages = next(prefix.rglob("dist-packages"))
        said = run("/usr/bin/python3", program / "enhance_and_plot.py", garment, PYTHONPATH=str(packages),
                   PLEAT_COORDINATOR=address)
        assert "749 -> 11393 vertices" in said, said
    finally:
        up.terminate()
        up.wait()


def main():
    source, build = (pathlib.Path(argument).resolve() for argument in sys.argv[1:3])
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
        check_clients(source, prefix, home, environment)
        outside = [path for path in folder.rglob("*") if path.suffix in (".h5", ".partial") and home not in path.parents]
        assert not outside, outside
    print("installed programs and clients work")


main()
