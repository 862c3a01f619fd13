#!/bin/bash
# The kernels under Oclgrind: fails when it finds an access outside a buffer, a race, or anything else it has words for.
#
#   oclgrind.sh   builds and runs kernels/reference/tests/oclgrind_cases.rs
#
# Debian 12 has Oclgrind, newer releases do not. There, Debian 12's packages are unpacked into target/drivers/oclgrind.
#
# Oclgrind exits with 0 whatever it finds, so its log decides: it must be empty. Writes of one value by several work-items
# are no findings (OCLGRIND_UNIFORM_WRITES stays off).
case ${1:-} in -h | --help) sed -n '2,/^[^#]/{/^#/s/^# \{0,1\}//p}' "$0" && exit ;; esac
set -euo pipefail
cd "$(dirname "$0")/../.."

scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT

# Oclgrind, and the libraries that it needs in versions that newer releases do not have.
packages=(oclgrind liboclgrind-21.10 libllvm14 libz3-4 libedit2 libbsd0 libmd0 libtinfo6 libffi8 libxml2 libicu72 liblzma5 libreadline8)
keys=/usr/share/keyrings/debian-archive-keyring.gpg

# unpack_packages FOLDER: apt with lists and a state of its own, which needs no root and leaves the system as it is.
unpack_packages() {
    local archive
    command -v apt-get >/dev/null && [ -e "$keys" ] || {
        echo 'isopeel: no oclgrind found: install it; on Debian and Ubuntu, debian-archive-keyring is enough' >&2
        exit 1
    }
    echo "isopeel: unpacking Debian 12's oclgrind into $1"
    rm -rf "$1"
    mkdir -p "$1" "$scratch/apt/lists/partial" "$scratch/apt/archives/partial"
    touch "$scratch/apt/status"
    echo "deb [signed-by=$keys] ${DEBIAN_MIRROR:-http://deb.debian.org/debian} bookworm main" >"$scratch/apt/sources.list"
    local apt=(apt-get --quiet=2 -o Dir::Etc::SourceList="$scratch/apt/sources.list" -o Dir::Etc::SourceParts=/dev/null
        -o Dir::State::Lists="$scratch/apt/lists" -o Dir::State::Status="$scratch/apt/status"
        -o Dir::Cache="$scratch/apt" -o Acquire::Check-Valid-Until=false -o APT::Sandbox::User="$(id -un)")
    "${apt[@]}" update
    (cd "$scratch/apt" && "${apt[@]}" download "${packages[@]}")
    for archive in "$scratch"/apt/*.deb; do
        dpkg-deb --extract "$archive" "$1"
    done
    rm -rf "$scratch/apt"
    touch "$1/complete"
}

find_library() {
    find "$@" -name liboclgrind-rt-icd.so 2>/dev/null | head -n 1
}

library=$(find_library /usr/lib /usr/local/lib || true) libraries=
if [ -z "$library" ]; then
    folder=$PWD/target/drivers/oclgrind
    [ -e "$folder/complete" ] || unpack_packages "$folder"
    library=$(find_library "$folder")
    libraries=$folder/usr/lib/x86_64-linux-gnu:$folder/lib/x86_64-linux-gnu
fi
echo "$library" >"$scratch/oclgrind.icd"

# Found through cargo's own messages: the binary's name has a hash in it. `cat >&2` and not /dev/stderr, which would be opened
# again; if it is a file, that would truncate the output of other processes. The whole workspace is built, because otherwise
# dependencies would be rebuilt with other features.
binary=$(cargo test --locked --workspace --test oclgrind_cases --no-run 2>&1 |
    tee >(cat >&2) | sed -n 's/.*oclgrind_cases.rs (\(.*\))$/\1/p')
export OCL_ICD_VENDORS="$scratch" OCLGRIND_DATA_RACES=1 ISOPEEL_DEVICE=oclgrind
[ -z "$libraries" ] || export LD_LIBRARY_PATH=$libraries${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}

# Oclgrind uses one core: a process for each test.
started=$SECONDS
"./${binary#"$PWD/"}" --list --format terse | sed -n 's/: test$//p' >"$scratch/tests"
[ -s "$scratch/tests" ] || {
    echo "isopeel: no tests in $binary" >&2
    exit 1
}
xargs -P "$(nproc)" -I '{}' env OCLGRIND_LOG="$scratch/{}.log" "./${binary#"$PWD/"}" --exact '{}' <"$scratch/tests" |
    tee "$scratch/output" || true

# A test also fails if Oclgrind found something.
passed=0 failed=0
while read -r test; do
    if grep --quiet --line-regexp --fixed-strings "test $test ... ok" "$scratch/output" && [ ! -s "$scratch/$test.log" ]; then
        passed=$((passed + 1))
    else
        failed=$((failed + 1))
        printf 'isopeel: oclgrind, %s:\n' "$test" >&2
        head -n 200 "$scratch/$test.log" >&2 || true
    fi
done <"$scratch/tests"
version=$(find "$(dirname "$(dirname "$library")")" -name 'liboclgrind-*.so' | sed -n 's/.*liboclgrind-\(.*\)\.so/\1/p' | grep -v rt | head -n 1)
printf 'summary\tOclgrind %s\t%d\t%d\t%d\n' "$version" "$passed" "$failed" $((SECONDS - started))
[ "$failed" -eq 0 ]
