#!/bin/bash
# The kernels' tests on OpenCL drivers, and a table of what they found.
#
#   drivers.sh [DRIVER...]    DRIVER is SUITE/pocl or SUITE/rusticl, a package of a Debian release, as trixie/pocl; or intel,
#                             oclgrind, or machine: whatever this machine has. Without any, those of the list below
#
# STEPS is what is done on each, of the steps that driver-tests.sh has. Without it Rusticl, whose compiler takes minutes, has
# few, and the others have all. Oclgrind has tests of its own. With STEPS=surfaces, surfaces of volumes in the folder that ISOPEEL_DATA
# names are written to target/drivers/surfaces, and compared with those of the first driver.
#
# PoCL and Mesa's Rusticl run in roots of Debian that fresh-debian.sh makes in target/roots, as root; Intel's runtime is downloaded
# from PyPI into target/drivers (1 GB; its licence is Intel's). No part of the machine's own OpenCL setup is changed. A test
# fails because of what a driver computes, never because of its version: the table has the versions that were found.
# Logs are in target/drivers/logs.
case ${1:-} in -h | --help) sed -n '2,/^[^#]/{/^#/s/^# \{0,1\}//p}' "$0" && exit ;; esac
set -euo pipefail
cd "$(dirname "$0")/../.."

drivers=("$@")
[ ${#drivers[@]} -gt 0 ] || drivers=(bookworm/pocl trixie/pocl forky/pocl trixie/rusticl intel oclgrind)
logs=$PWD/target/drivers/logs
tests=$PWD/target/driver-tests
surfaces=$PWD/target/drivers/surfaces
mkdir -p "$logs" "$surfaces"

fail() {
    printf 'isopeel: %s\n' "$@" >&2
    exit 1
}

# in_root SUITE PACKAGE ICD [STEP...]: the tests on one driver of a release.
in_root() {
    local suite=$1 package=$2 icd=$3
    shift 3
    # The root's home is what it can write to.
    local written=target/roots/$suite-home-$(id -un)/surfaces status=0
    rm -rf "$written"
    SURFACES=/root/surfaces tests/scripts/fresh-debian.sh run "$suite" "ocl-icd-libopencl1,$package" \
        sh -c 'dpkg-query --show "$1" "libllvm*" | grep "[0-9]$"; shift; exec "$@"' in_root "$package" \
        env OCL_ICD_VENDORS="/etc/OpenCL/vendors/$icd" "$tests/run.sh" "$@" || status=$?
    if [ -d "$written" ]; then
        rm -rf "$SURFACES"
        mv "$written" "$SURFACES"
    fi
    return "$status"
}

# Intel's runtime. The machine's own loader stays the one that is used; a loader that is given a folder knows no other driver.
on_intel() {
    local requirements=tests/scripts/drivers-requirements.txt folder=$PWD/target/drivers/intel
    if ! cmp --silent "$requirements" "$folder/installed.txt"; then
        echo "isopeel: installing Intel's OpenCL runtime into $folder"
        rm -rf "$folder"
        python3 -m venv "$folder" || fail 'python3 makes no virtual environment: on Debian, apt-get install python3-venv'
        # `set -e` does not reach here.
        "$folder/bin/pip" install --quiet --disable-pip-version-check --requirement "$requirements" ||
            fail "pip could not install Intel's OpenCL runtime into $folder"
        rm -f "$folder"/lib/libOpenCL.so*
        mkdir "$folder/vendors"
        echo "$folder/lib/libintelocl.so" >"$folder/vendors/intel.icd"
        cp "$requirements" "$folder/installed.txt"
    fi
    OCL_ICD_VENDORS=$folder/vendors LD_LIBRARY_PATH=$folder/lib${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH} "$tests/run.sh" "$@"
}

# run_driver NAME
run_driver() {
    local suite=${1%/*} steps
    export SURFACES=$surfaces/${1//\//-}
    read -ra steps <<<"${STEPS:-}"
    case $1 in
    */pocl) in_root "$suite" pocl-opencl-icd pocl.icd "${steps[@]}" ;;
    */rusticl)
        [ ${#steps[@]} -gt 0 ] || steps=(check small)
        RUSTICL_ENABLE=llvmpipe in_root "$suite" mesa-opencl-icd rusticl.icd "${steps[@]}"
        ;;
    intel) on_intel "${steps[@]}" ;;
    oclgrind) tests/scripts/oclgrind.sh ;;
    machine) "$tests/run.sh" "${steps[@]}" ;;
    *) fail "'$1' is no driver, expected SUITE/pocl, SUITE/rusticl, intel, oclgrind or machine" ;;
    esac
}

tests/scripts/pack-driver-tests.sh
if [ -n "${ISOPEEL_DATA:-}" ]; then
    # A folder that the roots can see.
    mkdir "$tests/volumes"
    cp "$ISOPEEL_DATA"/{mni152-t1.nii.gz,ct-head.nrrd} "$tests/volumes"
    export ISOPEEL_DATA=$tests/volumes
fi
row='%-16s %-48s %7s %7s %8s\n'
# shellcheck disable=SC2059
table=$(printf "$row" driver 'version found' passed failed seconds)
status=0
for driver in "${drivers[@]}"; do
    log=$logs/${driver//\//-}.log
    printf '\n=== %s\n' "$driver"
    (run_driver "$driver") 2>&1 | tee "$log" || status=1
    IFS=$'\t' read -r _ version passed failed seconds < <(grep '^summary' "$log" || printf 'summary\tdid not run to the end\t\t\t\n')
    # shellcheck disable=SC2059
    table+=$'\n'$(printf "$row" "$driver" "$version" "$passed" "$failed" "$seconds")
done
printf '\n%s\n' "$table"
if [ "${STEPS:-}" = surfaces ]; then
    tests/scripts/compare_surfaces.py $(printf "$surfaces/%s\n" "${drivers[@]//\//-}") || status=1
fi
exit "$status"
