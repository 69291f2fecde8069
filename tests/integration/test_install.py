#!/usr/bin/env python3
"""test_install.py SOURCE BUILD: what is installed into an empty prefix works outside of the source tree: the programs, a
C++ program by find_package and by pkg-config, a Python program, the manual, completions, and where Blender is installed
its add-on."""
import gzip
import json
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


class Place:
    """A home folder and an environment that know nothing of the source tree."""

    def __init__(self, folder, prefix):
        self.home, self.prefix = folder / "home", prefix
        self.home.mkdir()
        self.environment = {"PATH": f"{prefix}/bin:/usr/bin:/bin", "HOME": str(self.home), "LANG": "C.UTF-8"}
        if "XDG_RUNTIME_DIR" in os.environ:
            self.environment["XDG_RUNTIME_DIR"] = os.environ["XDG_RUNTIME_DIR"]

    def run(self, *words, code=0, **more):
        done = subprocess.run([str(word) for word in words], cwd=self.home, env=self.environment | more,
                              capture_output=True, text=True, timeout=200)
        assert done.returncode == code, f"{words}: exit code {done.returncode}\n{done.stdout}\n{done.stderr}"
        return done


def check_programs(place, source, share):
    (place.home / "cloth.obj").write_text(GARMENT)
    version = re.search(r"^project\(pleat VERSION (\S+)", (source / "CMakeLists.txt").read_text(), re.M)[1]
    programs = sorted(path.name for path in (place.prefix / "bin").iterdir())
    assert {"pleat", "pleat-fold", "pleat-coordinator", "pleat-train", "pleat-generate"} <= set(programs), programs
    for program in programs:
        assert place.run(program, "--version").stdout.startswith(f"{program} {version}"), program
        page = gzip.decompress((share / f"man/man1/{program}.1.gz").read_bytes()).decode()
        assert page.startswith(f".TH {program.upper()} 1"), page[:80]
    assert place.run("pleat", "check", share / "pleat/garments/skirt.obj", "cloth.obj").stdout.count("islands") == 2
    # The shipped fabric, cloth and bundle, none of them named.
    place.run("pleat", "dataset", "generate", "set", "--garment", "cloth.obj", "--set", "hitting", "--train", 1, "--test", 0,
              "--frames", 3, "--workers", 1)
    info = json.loads(place.run("pleat", "dataset", "info", "set", "--json").stdout)
    assert info["splits"] == {"train": {"sequences": 1, "frames": 3}}, info
    # A shipped scene by its name. Quiet, and figures for programs.
    done = place.run("pleat", "run", "draping", "--frames", 3, "--out", "result", "--json", "-q")
    assert done.stderr == "", done.stderr
    report = json.loads(done.stdout)
    assert (report["frames"], report["self_intersections"], report["penetrations"]) == (3, 0, 0), report
    assert (place.home / "result/report.html").stat().st_size > 100_000
    place.run("pleat", "export", "result/result.h5", "--format", "glb")
    assert (place.home / "result/glb/enhanced.glb").read_bytes()[:4] == b"glTF"
    assert "did you mean export?" in place.run("pleat", "exprot", code=2).stderr
    assert place.run("pleat", "help", "dataset", "info").stdout == place.run("pleat", "dataset", "info", "--help").stdout


def check_completions(place, share):
    line = (f"source '{share}/bash-completion/completions/pleat'; COMP_WORDS=(pleat run --det); COMP_CWORD=2; _pleat; "
            'echo "${COMPREPLY[*]}"; COMP_WORDS=(pleat export x --format ""); COMP_CWORD=4; _pleat; '
            'echo "${COMPREPLY[*]}"')
    words = place.run("bash", "-c", line).stdout.splitlines()
    assert words[0] == "--detail" and "pc2" in words[1].split(), words
    for shell, script in (("zsh", "zsh/site-functions/_pleat"), ("fish", "fish/vendor_completions.d/pleat.fish")):
        assert (share / script).is_file()
        if shutil.which(shell):
            place.run(shell, "-n", share / script)


def check_clients(place, source, prefix):
    """Both against one `pleat up`."""
    program = place.home / "consumer"
    program.mkdir()
    shutil.copy(source / "tests/integration/consumer/CMakeLists.txt", program)
    shutil.copy(source / "common/client/cpp/example/enhance.cpp", program)
    shutil.copy(source / "common/client/python/example/enhance_and_plot.py", program)
    place.run("cmake", "-S", program, "-B", program / "build", f"-DCMAKE_PREFIX_PATH={prefix}", CXXFLAGS="")
    place.run("cmake", "--build", program / "build")
    config = next(prefix.rglob("pleat.pc"))
    flags = place.run("pkg-config", "--cflags", "--libs", "pleat", PKG_CONFIG_PATH=config.parent).stdout
    assert f"-I{config.parent}" in flags and "-lpleat-client" in flags, flags
    headers = [path for path in (prefix / "include").rglob("*.h*")]
    assert headers and not any(re.search(r"#\s*include\s*<Eigen", path.read_text()) for path in headers)
    garment = prefix / "share/pleat/garments/tablecloth.obj"
    packages = next(prefix.rglob("dist-packages"))
    up = subprocess.Popen(["pleat", "up"], cwd=place.home, env=place.environment, stdout=subprocess.PIPE, text=True)
    try:
        address = next((line.split()[1] for line in up.stdout if line.startswith("ready ")), None)
        assert address, f"`pleat up` ended before it was ready, exit code {up.wait()}"
        said = place.run(program / "build/enhance", address, garment, 4, "fine.obj").stdout
        assert "749 -> 11393 vertices" in said and said.count(" 0 self-intersections") == 4, said
        said = place.run("/usr/bin/python3", program / "enhance_and_plot.py", garment, PYTHONPATH=str(packages),
                         PLEAT_COORDINATOR=address).stdout
        assert "749 -> 11393 vertices" in said, said
    finally:
        up.terminate()
        up.wait()
    # Not told where, it kept its files where a user's programs keep theirs.
    assert (place.home / ".local/state/pleat/services/logs/coordinator.log").is_file()


def check_addon(place, source, prefix):
    script = source / "tests/integration/test_blender_addon.py"
    done = subprocess.run(["/usr/bin/python3", script, prefix / "share/pleat/blender", prefix / "bin/pleat"],
                          cwd=place.home, capture_output=True, text=True, timeout=900)
    assert done.returncode in (0, 77), done.stdout + done.stderr
    print("add-on for Blender: " + done.stdout.strip())


def main():
    source, build = (pathlib.Path(argument).resolve() for argument in sys.argv[1:3])
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        prefix = folder / "usr"
        subprocess.run(["cmake", "--install", build, "--prefix", prefix], check=True, stdout=subprocess.DEVNULL)
        place = Place(folder, prefix)
        check_programs(place, source, prefix / "share")
        check_completions(place, prefix / "share")
        check_clients(place, source, prefix)
        check_addon(place, source, prefix)
        made = [path for path in prefix.rglob("*") if path.suffix in (".partial", ".log") or path.name == "result.h5"]
        assert not made, made
    print("installed programs, clients and manuals work")


main()
