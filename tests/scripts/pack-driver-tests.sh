#!/bin/bash
# Packs the kernels' tests and isopeel itself, with the files that they read, so that they run on a machine that has an OpenCL
# driver and no compiler: `run.sh` in the folder does, which is driver-tests.sh.
#
#   pack-driver-tests.sh               builds, and makes target/driver-tests
#   pack-driver-tests.sh ARCHIVE       and packs it, with the OpenCL loader, into ARCHIVE, a .tar.xz
case ${1:-} in -h | --help) sed -n '2,/^[^#]/{/^#/s/^# \{0,1\}//p}' "$0" && exit ;; esac
set -euo pipefail
cd "$(dirname "$0")/../.."

fail() {
    printf 'isopeel: %s\n' "$@" >&2
    exit 1
}

archive=${1:-}
folder=target/driver-tests
binaries=(isopeel_kernels device twins expected_cuts e2e)

# Found through cargo's own messages: a binary's name has a hash in it. The whole workspace, or dependencies would be built
# again with other features.
messages=$(cargo test --locked --workspace --tests --no-run 2>&1) || fail "$messages"
rm -rf "$folder"
mkdir -p "$folder/bin" "$folder/repository"
for name in "${binaries[@]}"; do
    binary=$(sed -n "s/.*Executable.*(\(.*\/$name-[0-9a-f]*\))$/\1/p" <<<"$messages")
    [ -x "$binary" ] || fail "cargo built no test binary $name"
    strip --output-file="$folder/bin/$name" "$binary"
done
strip --output-file="$folder/bin/isopeel" target/debug/isopeel-under-test

cp tests/scripts/driver-tests.sh "$folder/run.sh"
cp --parents kernels/cl/lib/*.h server/demo/*.nii.gz tests/fixtures/expected-cuts-*.jsonl "$folder/repository"
# Volume for machines that cannot extract a larger one: a sphere of radius 24 in 64³ samples, of value 100 on its surface.
python3 - "$folder/repository/sphere-64.nrrd" <<'SCRIPT'
import gzip, itertools, math, sys
samples = bytes(max(0, min(255, round(100 + 4 * (24 - math.dist(at, (31.5, 31.5, 31.5))))))
                for at in itertools.product(range(64), repeat=3))
with open(sys.argv[1], "wb") as file:
    file.write(b"NRRD0004\ntype: uint8\ndimension: 3\nsizes: 64 64 64\nspacings: 1 1 1\nencoding: gzip\n\n")
    file.write(gzip.compress(samples, mtime=0))
SCRIPT

[ -n "$archive" ] || exit 0
loader=$(PATH=$PATH:/sbin:/usr/sbin ldconfig -p | sed -n 's|^\s*libOpenCL.so.1 .*x86-64.* => ||p' | head -n 1)
[ -n "$loader" ] || fail 'no libOpenCL.so.1 found: on Debian, apt-get install ocl-icd-libopencl1'
mkdir "$folder/lib"
cp --dereference "$loader" "$folder/lib/libOpenCL.so.1"
XZ_OPT='-6 --threads=0' tar -C target --owner=0 --group=0 -cJf "$archive" driver-tests
echo "$archive: $(stat --format=%s "$archive" | numfmt --to=si --suffix=B); unpack it and run driver-tests/run.sh"
