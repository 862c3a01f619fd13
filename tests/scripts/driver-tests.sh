#!/bin/bash
# Runs the kernels' tests on this machine's OpenCL driver, without a compiler or the source tree: `run.sh` in the folder and
# in the archive that pack-driver-tests.sh makes.
#
#   run.sh [--subset] [--driver LIBRARY]
#
#   --subset            few tests and a small surface, for drivers whose compiler takes minutes
#   --driver LIBRARY    the driver's library, as /usr/lib/x86_64-linux-gnu/libnvidia-opencl.so.1
#
# Without --driver it uses the drivers that the system names in /etc/OpenCL/vendors or OCL_ICD_VENDORS, or else NVIDIA's
# library, which many machines have without naming it. ISOPEEL_DEVICE selects one of several devices. A test that takes longer
# than TEST_SECONDS (600) fails; tests of one binary together may take ten times that. The last line but one is a summary for
# programs, separated by tabs: `summary`, driver, tests that passed and failed, seconds. The exit status is 1 when one failed.
set -euo pipefail

folder=$(dirname "$(realpath "$0")")
test_seconds=${TEST_SECONDS:-600}
subset= library= passed=0 failed=0

fail() {
    printf 'isopeel: %s\n' "$@" >&2
    exit 2
}

while [ $# -gt 0 ]; do
    case $1 in
    --subset) subset=1 ;;
    --driver) library=${2:?--driver needs a library} && shift ;;
    *) fail "'$1' is no option, expected --subset or --driver LIBRARY" ;;
    esac
    shift
done
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT

## Loader and driver

# find_library NAME: its path, as the dynamic linker finds it, or in places where drivers are mounted.
find_library() {
    local cached place
    cached=$(PATH=$PATH:/sbin:/usr/sbin ldconfig -p 2>/dev/null | sed -n "s|^\s*$1 .*x86-64.* => ||p" | head -n 1)
    for place in ${LD_LIBRARY_PATH:+${LD_LIBRARY_PATH//:/ }} /usr/lib/x86_64-linux-gnu /usr/lib64 /usr/local/nvidia/lib64 /usr/lib/wsl/lib; do
        [ -n "$cached" ] || [ ! -e "$place/$1" ] || cached=$place/$1
    done
    [ -n "$cached" ] && printf '%s\n' "$cached"
}

find_library libOpenCL.so.1 >"$scratch/loader" || {
    echo "no OpenCL loader on this machine: the one in $folder/lib is used"
    export LD_LIBRARY_PATH=$folder/lib${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}
}
if [ -z "$library" ] && [ -z "${OCL_ICD_VENDORS:-}" ] && ! compgen -G '/etc/OpenCL/vendors/*.icd' >/dev/null; then
    library=$(find_library libnvidia-opencl.so.1) ||
        fail 'no OpenCL driver: /etc/OpenCL/vendors names none, and there is no libnvidia-opencl.so.1; --driver LIBRARY names one'
fi
if [ -n "$library" ]; then
    mkdir "$scratch/vendors"
    echo "$library" >"$scratch/vendors/driver.icd"
    export OCL_ICD_VENDORS=$scratch/vendors
fi

## Steps

# count NAME COMMAND...: a step that passes or fails as a whole.
count() {
    local name=$1 status=0 started=$SECONDS
    shift
    timeout --kill-after=10 "$((10 * test_seconds))" "$@" >"$scratch/step" 2>&1 || status=$?
    if [ "$status" -eq 0 ]; then
        passed=$((passed + 1))
        printf '%s: passed, %d s\n' "$name" $((SECONDS - started))
    else
        failed=$((failed + 1))
        tail -n 30 "$scratch/step"
        printf '%s: FAILED with status %d after %d s\n' "$name" "$status" $((SECONDS - started))
    fi
}

# verdicts FILE VERDICT: the tests that ended so. A driver's own output may stand between a test's name and its verdict.
verdicts() {
    sed -n "s/^test \(.*\) \.\.\. .*\b$2\$/\1/p" "$1"
}

# run_tests BINARY [FILTER...]: all of its tests in one process. Where that ends early, each test that has no verdict
# gets a process of its own.
run_tests() {
    local binary=$folder/bin/$1 name=$1 status=0 started=$SECONDS test good=0 bad=0
    shift
    "$binary" --list --format terse "$@" | sed -n 's/: test$//p' | sort >"$scratch/all"
    "$binary" --list --format terse --ignored "$@" | sed -n 's/: test$//p' | sort >"$scratch/ignored"
    comm -23 "$scratch/all" "$scratch/ignored" >"$scratch/wanted"
    [ -s "$scratch/wanted" ] || fail "no tests in $binary"
    timeout --kill-after=10 $((10 * test_seconds)) "$binary" "$@" >"$scratch/log" 2>&1 || status=$?
    [ "$status" -eq 0 ] || tail -n 60 "$scratch/log"
    verdicts "$scratch/log" ok | sort >"$scratch/good"
    verdicts "$scratch/log" FAILED | sort >"$scratch/bad"
    while read -r test; do
        if timeout --kill-after=10 "$test_seconds" "$binary" --exact "$test" >"$scratch/log" 2>&1; then
            echo "$test" >>"$scratch/good"
        else
            printf '%s %s: FAILED with status %d in a process of its own\n' "$name" "$test" $?
            echo "$test" >>"$scratch/bad"
        fi
    done < <(sort "$scratch/good" "$scratch/bad" | comm -23 "$scratch/wanted" -)
    good=$(wc -l <"$scratch/good") bad=$(wc -l <"$scratch/bad")
    passed=$((passed + good)) failed=$((failed + bad))
    printf '%s: %d passed, %d failed, %d s\n' "$name" "$good" "$bad" $((SECONDS - started))
}

# extract VOLUME ISOVALUE OPTION... -- FILTER: an extraction whose statistics have to match.
extracts() {
    local wanted=$1
    shift
    "$folder/bin/isopeel" extract "$@" --stats -o "$scratch/surface.ply" | tee "$scratch/statistics"
    tr -d ' \n' <"$scratch/statistics" | grep --quiet --extended-regexp "$wanted"
}

## All of them

started=$SECONDS
export ISOPEEL_REPOSITORY=$folder/repository
"$folder/bin/isopeel" devices | tee "$scratch/devices" || failed=1
field() {
    sed -n "s/^ *$1  *//p" "$scratch/devices" | head -n 1
}
driver="$(field platform) $(field driver)"
[ "$driver" != ' ' ] || driver='no device'

small=$folder/repository/sphere-64.nrrd
count 'devices --check' "$folder/bin/isopeel" devices --check
export -f extracts
export folder scratch
count 'extract 64³' bash -euo pipefail -c 'extracts "$@"' extracts '"fullTriangles":[1-9]' "$small" --iso 100 --beta -1
if [ -n "$subset" ]; then
    run_tests device minmax histogram
else
    demo=$(sed -n 's/.*"full_triangles": \([0-9]*\).*/\1/p; q' "$folder/repository/tests/fixtures/expected-cuts-demo.jsonl")
    count 'extract the demo' bash -euo pipefail -c 'extracts "$@"' extracts "\"fullTriangles\":$demo," \
        "$folder/repository/server/demo/t1.nii.gz" --iso 100 --triangles 25%
    count 'edit over the socket' "$folder/bin/e2e" --exact edits::a_beta_edit_sends_only_the_regions_that_it_changes
    for binary in isopeel_kernels twins expected_cuts device; do
        run_tests "$binary"
    done
fi
printf 'summary\t%s\t%d\t%d\t%d\n' "$driver" "$passed" "$failed" $((SECONDS - started))
printf '%s: %d passed, %d failed, %d s\n' "$driver" "$passed" "$failed" $((SECONDS - started))
[ "$failed" -eq 0 ]
