#!/bin/bash
# Fuzzes the readers: each target of server/fuzz for some minutes, from small valid files and what earlier runs have found worth
# keeping, which stays in server/fuzz/corpus. Inputs that fail are in server/fuzz/artifacts, and end the run with status 1 after the
# other targets.
#
#   fuzz-targets.sh MINUTES [TARGET...]    without any TARGET: all
#
# With a nightly toolchain readers run under AddressSanitizer. Without one the stable compiler is used, and no sanitizer.
# cargo-fuzz is taken from PATH.
case ${1:-} in -h | --help) sed -n '2,/^[^#]/{/^#/s/^# \{0,1\}//p}' "$0" && exit ;; esac
set -euo pipefail
cd "$(dirname "$0")/../../server/fuzz"

minutes=${1:?MINUTES, as 10}
shift
[[ $minutes =~ ^[0-9]+$ ]] || { echo "fuzz-targets.sh: '$minutes' is no number of minutes" >&2 && exit 2; }
# Neither the compiler nor the flags of the tests.
unset RUSTC_WORKSPACE_WRAPPER CARGO_INCREMENTAL

if rustup toolchain list 2>/dev/null | grep --quiet '^nightly'; then
    toolchain=+nightly sanitizer=address
else
    toolchain=+stable sanitizer=none
    echo 'isopeel: no nightly toolchain: the readers run without a sanitizer'
fi
targets=("$@")
[ ${#targets[@]} -gt 0 ] || mapfile -t targets < <(cargo "$toolchain" fuzz list | grep --invert-match '^seeds$')

cargo "$toolchain" run --quiet --bin seeds
failed=()
for target in "${targets[@]}"; do
    echo "=== $target"
    cargo "$toolchain" fuzz run --sanitizer "$sanitizer" "$target" -- \
        -max_total_time=$((minutes * 60)) -rss_limit_mb=1024 -timeout=10 -max_len=4096 -print_final_stats=1 || failed+=("$target")
done
echo "isopeel: ${#targets[@]} readers fuzzed for $minutes minutes each, sanitizer: $sanitizer; failed: ${failed[*]:-none}"
[ ${#failed[@]} -eq 0 ]
