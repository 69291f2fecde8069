#!/usr/bin/env bash
# build.sh OUT [src]: the package with its generated messages in OUT/src, and without `src` a wheel and an sdist of it in
# OUT/dist.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../../.." && pwd)
mkdir -p "$1"
out=$(cd "$1" && pwd)
rm -rf "$out/src" "$out/dist"
mkdir -p "$out/src"
cp -r "$here/pleat" "$here/setup.py" "$here/README.md" "$out/src"
find "$out/src" -name __pycache__ -prune -exec rm -r {} +
version=$(sed -n 's/^project(pleat VERSION \([0-9.]*\).*/\1/p' "$root/CMakeLists.txt")
printf '"""Of the project, as CMakeLists.txt says it."""\n\n__version__ = "%s"\n' "$version" >"$out/src/pleat/version.py"
protoc -I "$root/proto" --python_out="$out/src" --grpc_python_out="$out/src" \
  --plugin=protoc-gen-grpc_python="$(command -v grpc_python_plugin)" "$root"/proto/pleat/v1/*.proto
touch "$out/src/pleat/v1/__init__.py"
if [ "${2:-}" = src ]; then exit; fi
cd "$out/src"
/usr/bin/python3 setup.py -q sdist -d "$out/dist" bdist_wheel -d "$out/dist" 2>"$out/build.log" || { cat "$out/build.log" >&2; exit 1; }
rm -rf build ./*.egg-info
ls "$out"/dist/*
