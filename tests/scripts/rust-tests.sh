#!/bin/bash
# Runs a share of the workspace's Rust tests, built by `make build-tests`. The shares together are all tests.
#
#   rust-tests.sh kernels     the kernels against their twins: these wait for one device, and use little more than one processor
#   rust-tests.sh end-to-end  the server's binary from outside
#   rust-tests.sh others      unit tests, and all other tests
#
# A share selects targets, not packages: with fewer packages, dependencies would be built again, with fewer features.
case ${1:-} in -h | --help) sed -n '2,/^[^#]/{/^#/s/^# \{0,1\}//p}' "$0" && exit ;; esac
set -euo pipefail
cd "$(dirname "$0")/../.."

# names SHARE: the integration tests of a share
names() {
    cargo metadata --locked --no-deps --format-version 1 | python3 -c '
import json, sys
shares = {"device": "kernels", "twins": "kernels", "e2e": "end-to-end"}
for package in json.load(sys.stdin)["packages"]:
    for target in package["targets"]:
        if "test" in target["kind"] and shares.get(target["name"], "others") == sys.argv[1]:
            print("--test", target["name"])
' "$1"
}

share=${1:?usage: rust-tests.sh kernels|end-to-end|others}
targets=$(names "$share")
[ -n "$targets" ] || { echo "no tests are in the share '$share', expected kernels, end-to-end or others" >&2; exit 1; }
[ "$share" != others ] || targets="$targets --lib --bins"
# Random cases are the same in each run, so that only a change makes it fail; `make fuzz` draws new ones.
# More threads than processors: many tests wait most of their time, for a dead line or a driver that hangs.
# shellcheck disable=SC2086
PROPTEST_RNG_SEED=2013 RUST_TEST_THREADS=${RUST_TEST_THREADS:-$(($(nproc) + 2))} \
    exec cargo test --locked --workspace --no-fail-fast $targets
