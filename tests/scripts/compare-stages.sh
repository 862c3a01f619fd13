#!/bin/bash
# Whether two commits compute the same, bit for bit: hashes of every kernel's buffers on this machine's device.
#
#   compare-stages.sh OLD [NEW]    NEW: HEAD
#
# Kernels may be renamed between the two; what is compared is the contents of their buffers, launch by launch. Worktrees and
# hashes are kept below target/compare. No test of CI: processors and drivers round differently.
case ${1:-} in -h | --help) sed -n '2,/^[^#]/{/^#/s/^# \{0,1\}//p}' "$0" && exit ;; esac
set -euo pipefail
cd "$(dirname "$0")/../.."

# record REVISION: prints the file of its hashes.
record() {
    local commit folder
    commit=$(git rev-parse --short "$1^{commit}")
    folder=$PWD/target/compare/$commit
    [ -d "$folder" ] || git worktree add --quiet --detach "$folder" "$commit" >&2
    # The order in which threads link their entries is in the buffers: one thread.
    (cd "$folder" && export CARGO_TARGET_DIR="$OLDPWD/target" POCL_MAX_PTHREAD_COUNT=1 &&
        cargo run --quiet --locked --release --package isopeel-kernels --features testing --example stage_hashes \
            >"$folder.hashes") || exit 1
    git worktree remove --force "$folder"
    echo "$folder.hashes"
}

old=$(record "${1:?usage: compare-stages.sh OLD [NEW]}")
new=$(record "${2:-HEAD}")
# Volume, setting and step, then the buffers: the number of the launch and the kernel's name may change.
if diff <(cut -d ' ' -f 1-3,6- "$old") <(cut -d ' ' -f 1-3,6- "$new") >target/compare/difference; then
    echo "the same: $(wc -l <"$new") launches"
    exit 0
fi
echo "different (target/compare/difference); the first launches that differ, with their kernels:"
diff "$old" "$new" | grep '^[<>]' | cut -d ' ' -f 1-6 | head -20
exit 1
