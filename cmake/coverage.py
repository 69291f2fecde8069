#!/usr/bin/env python3
"""Which share of the lines the tests have run, room by room, of a tree that was built with PLEAT_COVERAGE.

    coverage.py BUILD OUT [--least 90]

Counts the libraries of common and services: no programs' main.cpp, no generated code. Pages for reading in OUT/index.html.
Exit code 1 below the least share of all lines. Processes that tests kill with -9 leave no counts."""

import argparse
import collections
import json
import pathlib
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parent.parent


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("build", type=pathlib.Path)
    parser.add_argument("out", type=pathlib.Path)
    parser.add_argument("--least", type=float, default=90, metavar="PERCENT")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    summary = options.out / "summary.json"
    subprocess.run(
        ["gcovr", "--root", ROOT, "--filter", f"{ROOT}/common/", "--filter", f"{ROOT}/services/", "--exclude", r".*/main\.cpp",
         "--json-summary", summary, "--html-details", options.out / "index.html", options.build.resolve()],
        check=True, stdout=subprocess.DEVNULL)
    rooms = collections.defaultdict(lambda: [0, 0])
    for file in json.loads(summary.read_text())["files"]:
        for room in ("/".join(file["filename"].split("/")[:2]), "all"):
            rooms[room][0] += file["line_covered"]
            rooms[room][1] += file["line_total"]
    total = rooms.pop("all", [0, 0])
    if total[1] == 0:
        sys.exit(f"coverage: {options.build} has no counts")
    for room, (run, lines) in [*sorted(rooms.items()), ("all", total)]:
        print(f"{room:28} {lines:7} lines {100 * run / max(1, lines):6.1f} %")
    return 0 if 100 * total[0] >= options.least * total[1] else 1


if __name__ == "__main__":
    sys.exit(main())
