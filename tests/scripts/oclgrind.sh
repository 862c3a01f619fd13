#!/bin/bash
# The kernels under Oclgrind: fails when it finds an access outside a buffer, a race, or anything else it has words for.
#
#   oclgrind.sh   builds and runs kernels/reference/tests/oclgrind_cases.rs
#
# Oclgrind exits with 0 whatever it finds, so its log decides: it must be empty. Writes of one value by several work-items
# are no findings (OCLGRIND_UNIFORM_WRITES stays off).
set -euo pipefail
cd "$(dirname "$0")/../.."

library=$(find /usr/lib /usr/local/lib -name liboclgrind-rt-icd.so 2>/dev/null | head -n 1)
[ -n "$library" ] || {
    echo 'isopeel: no oclgrind found: install it, on Debian with apt-get install oclgrind' >&2
    exit 1
}
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
echo "$library" >"$scratch/oclgrind.icd"

# Found through cargo's own messages: the binary's name has a hash in it. `cat >&2` and not /dev/stderr, which would be opened
# anew and, where it is a file, cut to nothing what others wrote there. The whole workspace, or dependencies would be built again
# with other features.
binary=$(cargo test --locked --workspace --test oclgrind_cases --no-run 2>&1 |
    tee >(cat >&2) | sed -n 's/.*oclgrind_cases.rs (\(.*\))$/\1/p')
export OCL_ICD_VENDORS="$scratch" OCLGRIND_DATA_RACES=1 ISOPEEL_DEVICE=oclgrind

# Oclgrind uses one core: a process for each test.
started=$SECONDS failed=
"./${binary#"$PWD/"}" --list --format terse | sed -n 's/: test$//p' >"$scratch/tests"
[ -s "$scratch/tests" ] || {
    echo "isopeel: no tests in $binary" >&2
    exit 1
}
xargs -P "$(nproc)" -I '{}' env OCLGRIND_LOG="$scratch/{}.log" "./${binary#"$PWD/"}" --exact '{}' <"$scratch/tests" || failed=1

findings=$(find "$scratch" -name '*.log' -exec cat {} +)
if [ -n "$findings" ]; then
    echo "isopeel: oclgrind found:" >&2
    head -n 200 <<<"$findings" >&2
    exit 1
fi
[ -z "$failed" ] || exit 1
echo "oclgrind: nothing found in $((SECONDS - started)) s"
