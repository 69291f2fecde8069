#!/usr/bin/env python3
"""The rules of the rooms that no compiler checks, over the files that git knows. Prints what breaks them; exit code 1.

Includes against cmake/rooms.txt; namespaces after their room; tests after their source; mains of at most 60 lines; a contract at the head of every header; documents that name
files which are not there; words that a finished program does not have.
"""

import fnmatch
import os
import pathlib
import re
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parent.parent
TABLE = "cmake/rooms.txt"
OWN = "cmake/check_rooms.py"
MAIN_LINES = 60
LIBRARIES = {"Eigen", "OpenMesh", "assimp", "cholmod", "hdf5", "nlohmann", "CLI", "grpc", "spdlog", "openssl", "prometheus", "torch"}
# Folders that documents name and that only a build, a run or a user's machine makes.
MADE = ("build/", "out/", "mine", "garment", "frames/", "/")
# Rooms whose headers are in another namespace than pleat::NAME of their folder: what everybody has is in pleat itself.
NAMESPACES = {
    "common/base": ["pleat"],
    "common/mesh": ["pleat"],
    "common/features": ["pleat"],
    "common/frame": ["pleat"],
    "common/scene": ["pleat"],
    "common/store": ["pleat", "pleat::store", "pleat::hdf5"],
    "common/client/cpp": ["pleat::client"],
    "common/client/adapter": ["pleat::client"],
}
UNFINISHED = re.compile(r"\b(TODO|FIXME|XXX|HACK)\b")


def tracked(*patterns):
    listing = subprocess.run(["git", "ls-files", *patterns], cwd=ROOT, capture_output=True, text=True, check=True)
    return [name for name in listing.stdout.splitlines() if (ROOT / name).exists()]


def read_table():
    table = {}
    for number, line in enumerate((ROOT / TABLE).read_text().splitlines(), 1):
        line = line.split("#")[0].strip()
        if not line:
            continue
        room, colon, seen = line.partition(":")
        if not colon:
            sys.exit(f"{TABLE}:{number}: no colon")
        table[room.strip()] = set(seen.split())
    return table


def room_of(path, table):
    """The longest room (not a file's pattern) that the path begins with."""
    rooms = [room for room in table if path.startswith(room + "/")]
    return max(rooms, key=len, default=None)


def target_of(include, table):
    """What an include belongs to: a room, proto, <library>; None for the standard library and a file's own folder."""
    if include.startswith("pleat/v1/"):
        return "proto"
    if include.startswith(("common/", "services/", "tests/")):
        return room_of(include, table) or include.rsplit("/", 1)[0]
    head = re.split(r"[/.]", include)[0]
    if head in ("ATen", "c10"):
        return "<torch>"
    if head in ("grpc", "grpcpp"):
        return "<grpc>"
    if include.startswith("google/protobuf"):
        return "<protobuf>"
    return f"<{head}>" if head in LIBRARIES else None


def check_includes(table):
    for path in tracked("common/*.cpp", "common/*.hpp", "common/*.ipp", "services/*.cpp", "services/*.hpp"):
        room = room_of(path, table)
        if room is None:
            yield f"{path}: its folder is not in {TABLE}"
            continue
        allowed = {room} | table[room]
        for pattern, seen in table.items():
            if fnmatch.fnmatch(path, pattern):
                allowed |= seen
        for number, line in enumerate((ROOT / path).read_text().splitlines(), 1):
            found = re.match(r'\s*#\s*include\s*[<"]([^>"]+)[>"]', line)
            target = found and target_of(found[1], table)
            if target and target not in allowed:
                yield f"{path}:{number}: {room} may not see {target}"


def namespaces_of(room):
    """services/presentation/check: pleat::check of its own folder, or pleat::presentation of the one above."""
    return NAMESPACES.get(room) or ["pleat::" + part for part in room.split("/")[1:]]


def check_namespaces(table):
    """A header declares in its room's namespace, or in one inside it; a block of forward declarations is free."""
    forward = re.compile(r"(?:(?:class|struct) \w+;\s*)+}")
    for path in tracked("common/*.hpp", "services/*.hpp"):
        wanted = namespaces_of(room_of(path, table) or os.path.dirname(path))
        text = (ROOT / path).read_text()
        for block in re.finditer(r"^namespace ([\w:]+) {\s*", text, re.MULTILINE):
            if "::" not in block[1] and block[1] != "pleat" or forward.match(text, block.end()):
                continue
            if block[1] not in wanted and not block[1].startswith(tuple(name + "::" for name in wanted if name != "pleat")):
                number = text.count("\n", 0, block.start()) + 1
                yield f"{path}:{number}: namespace {block[1]}, not {' or '.join(wanted)} of its room"


def check_tests():
    """tests/unit/ROOM/test_NAME.cpp is for ROOM/NAME.{hpp,cpp}; test_NAME_ASPECT.cpp where one file would be too much
    or needs a program of its own."""
    for path in tracked("tests/unit/*.cpp"):
        name = pathlib.PurePath(path)
        if not name.name.startswith("test_"):
            continue
        words = name.stem.split("_")[1:]
        folder = ROOT / name.parent.relative_to("tests/unit")
        stems = ["_".join(words[:count]) for count in range(len(words), 0, -1)]
        if not any((folder / (stem + end)).exists() for stem in stems for end in (".hpp", ".cpp", ".ipp")):
            yield f"{path}: no source of that name in {folder.relative_to(ROOT)}"


def check_mains():
    for path in tracked("services/*.cpp"):
        lines = (ROOT / path).read_text().splitlines()
        if any(line.startswith("int main(") for line in lines) and len(lines) > MAIN_LINES:
            yield f"{path}: {len(lines)} lines in a file with main(), {MAIN_LINES} at most (wiring only)"


def check_contracts():
    for path in tracked("*.hpp"):
        if not (ROOT / path).read_text().startswith("// "):
            yield f"{path}: no comment at its head that says what it is for"


def check_documents():
    """Links and `paths` with a slash in Markdown, and files that comments of sources cite."""
    files = set(tracked())
    folders = {parent for name in files for parent in map(str, pathlib.PurePath(name).parents)}

    def exists(name, folder):
        name = name.split("#")[0].split("?")[0].rstrip("/")
        for base in (folder, ""):
            place = os.path.normpath(os.path.join(base, name))
            if place in files or place in folders:
                return True
            if any(fnmatch.fnmatch(known, place) for known in files) or any(
                    known.startswith(place + ".") for known in files):
                return True
        return False

    tops = {name.split("/")[0] for name in files if "/" in name}
    for path in tracked("*.md"):
        folder = os.path.dirname(path)
        fenced = False
        for number, line in enumerate((ROOT / path).read_text().splitlines(), 1):
            if line.lstrip().startswith("```"):
                fenced = not fenced
                continue
            if fenced:
                continue
            for link in re.findall(r"\]\(([^)\s]+)\)", line):
                if not re.match(r"[a-z]+:|#", link) and not exists(link, folder):
                    yield f"{path}:{number}: names {link}, which is not there"
            for code in re.findall(r"`([\w.\-*/{},]+)`", line):
                if code.split("/")[0] not in tops or "/" not in code or code.startswith(MADE):
                    continue
                names = [code]
                braces = re.fullmatch(r"(.*)\{([^}]*)\}(.*)", code)
                if braces:
                    names = [braces[1] + middle + braces[3] for middle in braces[2].split(",")]
                for name in names:
                    if not exists(name, folder):
                        yield f"{path}:{number}: names {name}, which is not there"
    for path in tracked("*.cpp", "*.hpp", "*.ipp", "*.py", "*.cmake", "*.proto"):
        for number, line in enumerate((ROOT / path).read_text().splitlines(), 1):
            comment = re.search(r"(?://|#|\*) (.*)", line)
            for name in re.findall(r"\b(?:docs|deploy|services|common)/[\w/\-]+\.(?:md|hpp|cpp|py)\b",
                                   comment[1] if comment else ""):
                if not exists(name, ""):
                    yield f"{path}:{number}: names {name}, which is not there"
            if path != OWN and re.search(r"\bDESIGN\b", line):
                yield f"{path}:{number}: cites a DESIGN that is not in the repository"


def check_unfinished():
    for path in tracked("*.cpp", "*.hpp", "*.proto", "*.py", "*.sh", "*.ts"):
        if path == OWN:
            continue
        for number, line in enumerate((ROOT / path).read_text().splitlines(), 1):
            if UNFINISHED.search(line):
                yield f"{path}:{number}: unfinished work"


def main():
    table = read_table()
    failed = False
    for title, rows in (("includes against " + TABLE, check_includes(table)), ("namespaces", check_namespaces(table)),
                        ("tests without a source", check_tests()), ("mains", check_mains()),
                        ("headers without a contract", check_contracts()), ("names of files", check_documents()),
                        ("unfinished work", check_unfinished())):
        rows = list(rows)
        if rows:
            failed = True
            print(f"lint: {title}:")
            print("\n".join("    " + row for row in rows))
    sys.exit(1 if failed else 0)


main()
