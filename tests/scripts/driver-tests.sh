#!/bin/bash
# Runs the kernels' tests on this machine's OpenCL driver, without a compiler or the source tree: `run.sh` in the folder and
# in the archive that pack-driver-tests.sh makes.
#
#   run.sh [--driver LIBRARY] [STEP...]
#
#   --driver LIBRARY    the driver's library, as /usr/lib/x86_64-linux-gnu/libnvidia-opencl.so.1
#   STEP                check (isopeel devices --check), small (a surface of 64³ samples), demo (one of the demo volume), edit (an
#                       edit over the socket of a server), tests (of the kernels); without any, all of these. And surfaces:
#                       25 % and all of the surfaces of two volumes in the folder ISOPEEL_DATA, written to the folder SURFACES
#                       for compare_surfaces.py
#
# Without --driver it uses the drivers that the system names in /etc/OpenCL/vendors or OCL_ICD_VENDORS, or else NVIDIA's
# library, which many machines have without naming it. ISOPEEL_DEVICE selects one of several devices. A test that takes longer
# than TEST_SECONDS (600) fails; tests of one binary together may take ten times that. The last line but one is a summary for
# programs, separated by tabs: `summary`, driver, tests that passed and failed, seconds. The exit status is 1 when one failed.
case ${1:-} in -h | --help) sed -n '2,/^[^#]/{/^#/s/^# \{0,1\}//p}' "$0" && exit ;; esac
set -euo pipefail

folder=$(dirname "$(realpath "$0")")
test_seconds=${TEST_SECONDS:-600}
library= steps=() passed=0 failed=0

fail() {
    printf 'isopeel: %s\n' "$@" >&2
    exit 2
}

while [ $# -gt 0 ]; do
    case $1 in
    --driver) library=${2:?--driver needs a library} && shift ;;
    check | small | demo | edit | tests | surfaces) steps+=("$1") ;;
    *) fail "'$1' is no step, expected --driver LIBRARY, check, small, demo, edit, tests or surfaces" ;;
    esac
    shift
done
[ ${#steps[@]} -gt 0 ] || steps=(check small demo edit tests)
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

# Intel's runtime runs kernels on the thread that waits for them, and has 3 MB of private variables on its stack.
export RUST_MIN_STACK=$((16 << 20))

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

# run_tests BINARY [FILTER...]: runs all of its tests in one process. If that process ends early, each test that has no verdict
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

# extract WANTED VOLUME OPTION...: an extraction whose statistics match a pattern.
extract() {
    local wanted=$1 statistics
    shift
    statistics=$("$folder/bin/isopeel" extract ${ISOPEEL_DEVICE:+--device "$ISOPEEL_DEVICE"} "$@" --stats -o "$scratch/surface.ply" | tr -d ' \n')
    printf '%s\n' "$statistics"
    grep --quiet --extended-regexp "$wanted" <<<"$statistics"
}
export -f extract
export folder scratch

# write_surfaces VOLUME ISOVALUE
write_surfaces() {
    local share file
    : "${ISOPEEL_DATA:?names the folder of $1}" "${SURFACES:?names a folder for surfaces}"
    mkdir -p "$SURFACES"
    for share in 25 100; do
        file=$SURFACES/${1%%.*}-$share.ply
        rm -f "$file"
        count "$share % of $1" "$folder/bin/isopeel" extract ${ISOPEEL_DEVICE:+--device "$ISOPEEL_DEVICE"} "$ISOPEEL_DATA/$1" --iso "$2" --triangles "$share%" -o "$file"
    done
}

# run_step STEP
run_step() {
    local binary demo repository=$folder/repository
    case $1 in
    check) count 'devices --check' "$folder/bin/isopeel" devices --check ;;
    small)
        # A closed surface of genus 0 (vertices - triangles / 2 = 2), the same on every driver.
        count 'extract 64³' bash -euo pipefail -c 'extract "$@"' extract '"triangles":21936,"vertices":10970,' \
            "$repository/sphere-64.nrrd" --iso 100 --beta -1
        ;;
    demo)
        demo=$(sed -n 's/.*"full_triangles": \([0-9]*\).*/\1/p; q' "$repository/tests/fixtures/expected-cuts-demo.jsonl")
        count 'extract the demo' bash -euo pipefail -c 'extract "$@"' extract "\"fullTriangles\":$demo," \
            "$repository/server/demo/t1.nii.gz" --iso 100 --triangles 25%
        ;;
    edit) count 'edit over the socket' "$folder/bin/e2e" --exact edits::a_beta_edit_sends_only_the_regions_that_it_changes ;;
    tests)
        # Those of generated files are about the source tree.
        for binary in isopeel_kernels twins expected_cuts device; do
            run_tests "$binary" --skip generated::
        done
        ;;
    surfaces)
        write_surfaces mni152-t1.nii.gz 100
        write_surfaces ct-head.nrrd 517
        ;;
    esac
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

for step in "${steps[@]}"; do
    run_step "$step"
done
printf 'summary\t%s\t%d\t%d\t%d\n' "$driver" "$passed" "$failed" $((SECONDS - started))
printf '%s: %d passed, %d failed, %d s\n' "$driver" "$passed" "$failed" $((SECONDS - started))
[ "$failed" -eq 0 ]
