#!/bin/bash
# The kernels on another OpenCL driver: twins and expected cuts on Intel's runtime for CPUs.
#
#   drivers.sh   installs the driver into target/drivers (1 GB), and runs the tests of the kernels' crates on it
#
# Outside of CI: the download is large and under Intel's licence. No part of the machine's own OpenCL setup is changed.
set -euo pipefail
cd "$(dirname "$0")/../.."

fail() {
    printf 'isopeel: %s\n' "$@" >&2
    exit 1
}

requirements=tests/scripts/drivers-requirements.txt
folder=$PWD/target/drivers/intel
if ! cmp --silent "$requirements" "$folder/installed.txt"; then
    echo "isopeel: installing Intel's OpenCL runtime into $folder"
    rm -rf "$folder"
    python3 -m venv "$folder" || fail 'python3 makes no virtual environment: on Debian, apt-get install python3-venv'
    "$folder/bin/pip" install --quiet --disable-pip-version-check --requirement "$requirements"
    # The machine's own loader stays the one that is used.
    rm -f "$folder"/lib/libOpenCL.so*
    mkdir "$folder/vendors"
    echo "$folder/lib/libintelocl.so" >"$folder/vendors/intel.icd"
    cp "$requirements" "$folder/installed.txt"
fi

cargo build --locked --package isopeel
cargo test --locked --package isopeel-kernels --package isopeel-reference --no-run

# A loader that is given this folder knows no other driver.
export OCL_ICD_VENDORS=$folder/vendors LD_LIBRARY_PATH=$folder/lib${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}
devices=$(target/debug/isopeel devices)
printf '%s\n' "$devices"
grep --quiet '^ *platform *Intel(R) OpenCL' <<<"$devices" || fail 'the device is not of the platform Intel(R) OpenCL'

started=$SECONDS
cargo test --locked --package isopeel-kernels --package isopeel-reference
echo "Intel's runtime: all tests passed in $((SECONDS - started)) s"
