#!/bin/bash
# Runs one fuzzer from its corpus and what earlier runs found: fuzz.sh BUILD FUZZER SECONDS. Prints one line, or the end
# of its log if it found something.
set -eu -o pipefail
build=$1 name=$2 seconds=$3
corpus=${name#fuzz_}
found=$build/corpus/$corpus
log=$build/$name.log
mkdir -p "$found"
if "$build/bin/$name" -max_total_time="$seconds" -timeout=10 -rss_limit_mb=2048 -max_len=150000 -print_final_stats=1 \
  -verbosity=0 -close_fd_mask=1 -artifact_prefix="$build/" "$found" "tests/fuzz/corpus/$corpus" >"$log" 2>&1; then
  inputs=$(sed -n 's/^stat::number_of_executed_units: *//p' "$log")
  printf "fuzz: %s: %'d inputs in %d s, nothing found\n" "$name" "$inputs" "$seconds"
else
  grep -v NEW_FUNC "$log" | tail -40
  echo "fuzz: $name: a finding; log: $log"
  exit 255 # xargs starts no more
fi
