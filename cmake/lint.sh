#!/usr/bin/env bash
# Style and structure: clang-format, clang-tidy on what changed little and fast, and the rules that no compiler checks.
# Usage: cmake/lint.sh BUILD_DIR
set -euo pipefail
cd "$(dirname "$0")/.."
build=${1:-build}
failed=0
complain() { printf 'lint: %s\n' "$1"; shift; printf '    %s\n' "$@"; failed=1; }

mapfile -t sources < <(git ls-files '*.cpp' '*.hpp')
if ! clang-format --dry-run --Werror "${sources[@]}" 2>/tmp/pleat-format.$$; then
  complain "not formatted (make format mends it):" "$(grep -o '^[^:]*' /tmp/pleat-format.$$ | sort -u)"
fi
rm -f /tmp/pleat-format.$$

# Includes, mains, headers' contracts, names in documents, unfinished work.
cmake/check_rooms.py || failed=1

if [[ -f $build/compile_commands.json ]]; then
  # clang-tidy on the plain libraries: where the algorithms are, and quick because no gRPC or LibTorch header is in sight.
  mapfile -t tidy < <(git ls-files 'common/base/*.cpp' 'common/mesh/*.cpp' 'services/simulation/*.cpp' 'services/conversion/*.cpp' \
    'services/refinement/*.cpp' 'services/fold/*.cpp' | grep -vE '(service|main|messages)[^/]*\.cpp$')
  if ! printf '%s\n' "${tidy[@]}" | xargs -P "$(nproc)" -n 4 clang-tidy --quiet -p "$build" >/tmp/pleat-tidy.$$ 2>&1; then
    complain "clang-tidy:" "$(grep -E '(warning|error):' /tmp/pleat-tidy.$$ | sort -u || tail -n 20 /tmp/pleat-tidy.$$)"
  fi
  rm -f /tmp/pleat-tidy.$$
fi
((failed)) && exit 1
echo "lint: clean"
