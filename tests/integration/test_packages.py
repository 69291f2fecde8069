#!/usr/bin/env python3
"""test_packages.py BUILD: the Debian packages of a build. Each has its part and no other's, dpkg takes them all into one
root, and the command runs out of it. Exit code 77: `file` or dpkg-dev is missing."""
import pathlib
import shutil
import subprocess
import sys
import tempfile

SERVICES = {f"pleat-{name}" for name in ("simulation", "conversion", "superres", "fold", "refinement", "coordinator")}
# What each package is for; more may be in it, and nothing of this may be in another.
PARTS = {service: [f"usr/bin/{service}", f"usr/share/man/man1/{service}.1.gz"] for service in SERVICES} | {
    "pleat": ["usr/bin/pleat", "usr/bin/pleat-generate", "usr/share/bash-completion/completions/pleat"],
    "pleat-data": ["usr/share/pleat/scenes/draping.json", "usr/share/pleat/blender/pleat/__init__.py"],
    "python3-pleat": ["usr/lib/python3/dist-packages/pleat/__init__.py"],
}
PARTS["pleat-superres"].append("usr/bin/pleat-train")


def run(*words, **more):
    done = subprocess.run([str(word) for word in words], capture_output=True, text=True, timeout=500, **more)
    assert done.returncode == 0, f"{words}: exit code {done.returncode}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def field(package, name):
    return run("dpkg-deb", "-f", package, name).strip()


def check_contents(packages):
    owners = {}
    for name, package in packages.items():
        for line in run("dpkg-deb", "-c", package).splitlines():
            words = line.split()
            path = words[5].removeprefix("./")
            assert words[1] == "root/root", line
            if not path.endswith("/"):
                assert path not in owners, f"{path} is in {owners.get(path)} and in {name}"
                owners[path] = name
    for name, paths in PARTS.items():
        for path in paths:
            assert owners.get(path) == name, f"{path} is in {owners.get(path)}, not in {name}"
    library = next(name for name in packages if name.startswith("libpleat-client0") or name == "libpleat-client0.2")
    assert any(path.endswith("/pleat.pc") and owner == "libpleat-client-dev" for path, owner in owners.items())
    assert any("libpleat-client.so." in path and owner == library for path, owner in owners.items())
    for service in SERVICES & packages.keys():
        assert f"usr/share/doc/{service}/copyright" in owners
        depends = field(packages[service], "Depends")
        assert "libgrpc++" in depends and "libc6" in depends, f"{service}: {depends}"


def check_root(packages, root):
    state = root / "var/lib/dpkg"
    for folder in ("updates", "info", "triggers"):
        (state / folder).mkdir(parents=True)
    (state / "status").touch()
    (state / "available").touch()
    # What other packages bring is not in this root: dependencies are looked at above.
    run("dpkg", f"--root={root}", "--force-depends", "--force-not-root", "--force-script-chrootless", "--log=/dev/null",
        "-i", *packages.values())
    for program in sorted((root / "usr/bin").iterdir()):
        found = run("readelf", "-d", program)
        assert "RUNPATH" not in found and "RPATH" not in found, f"{program.name} has an rpath: {found}"
    out = root / "result"
    run(root / "usr/bin/pleat", "run", "draping", "--frames", 2, "--out", out,
        env={"PATH": "/usr/bin:/bin", "HOME": str(root), "LANG": "C.UTF-8"})
    assert (out / "result.h5").is_file()


def main():
    build = pathlib.Path(sys.argv[1]).resolve()
    if not all(shutil.which(program) for program in ("cpack", "dpkg-shlibdeps", "file", "dpkg")):
        print("skipped: cpack, dpkg-dev or file is missing")
        sys.exit(77)
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        run("cpack", "--config", build / "CPackConfig.cmake", "-B", folder / "packages",
            "-D", f"CPACK_OUTPUT_FILE_PREFIX={folder}/packages", "-D", "CPACK_DEBIAN_COMPRESSION_TYPE=gzip", cwd=folder)
        packages = {field(path, "Package"): path for path in sorted((folder / "packages").glob("*.deb"))}
        assert {"pleat", "pleat-data", "libpleat-client-dev"} | SERVICES <= packages.keys(), sorted(packages)
        version = {field(path, "Version") for path in packages.values()}
        assert len(version) == 1, version
        check_contents(packages)
        check_root(packages, folder / "root")
    print(f"{len(packages)} packages of version {version.pop()}: {' '.join(sorted(packages))}")


main()
