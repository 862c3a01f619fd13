#!/bin/bash
# Prepares a machine for `make TARGET`: checks the toolchains and installs the Debian packages that are missing.
#
#   prerequisites.sh build   compilers for Rust's C and C++ dependencies
#   prerequisites.sh run     and an OpenCL loader with a driver
#   prerequisites.sh test    and oclgrind, clang, OpenCL's headers, curl, openssl, Python, chromium, and mmdebstrap for a root of Debian 13
#
# Rust and Node are never installed, only checked: how they come to a machine is its owner's choice. Packages are
# installed on Debian and Ubuntu, as root or through a sudo that asks for no password; everywhere else the missing
# commands are named, with the line to type. Nothing is touched when nothing is missing.
case ${1:-} in -h | --help) sed -n '2,/^[^#]/{/^#/s/^# \{0,1\}//p}' "$0" && exit ;; esac
set -euo pipefail

purpose=${1:?usage: prerequisites.sh build|run|test}
minimum_rust=1.92  # rust-version in Cargo.toml
# What Vite and ESLint ask for, which crash on others: 20.19 of 20, 22.13 of 22, or 24 and newer.
wanted_node="20.19 of 20, 22.13 of 22, or 24 or newer"

fail() {
    printf 'isopeel: %s\n' "$@" >&2
    exit 1
}

# at_least VERSION MINIMUM
at_least() {
    [ "$(printf '%s\n' "$2" "$1" | sort -V | head -n 1)" = "$2" ]
}

# node_serves VERSION
node_serves() {
    case ${1%%.*} in
    20) at_least "$1" 20.19 ;;
    22) at_least "$1" 22.13 ;;
    *) at_least "$1" 24 ;;
    esac
}

check_toolchains() {
    command -v cargo >/dev/null || fail "no cargo found: install Rust $minimum_rust or newer, see https://rustup.rs"
    local rust node
    rust=$(rustc --version | cut -d ' ' -f 2)
    at_least "$rust" "$minimum_rust" ||
        fail "Rust is $rust, expected $minimum_rust or newer: with rustup, type 'rustup update stable'"
    command -v node >/dev/null || fail "no node found: install Node, $wanted_node, see https://nodejs.org"
    command -v npm >/dev/null || fail "no npm found: install the one that comes with Node, see https://nodejs.org"
    node=$(node --version)
    node_serves "${node#v}" || fail "Node is ${node#v}, expected $wanted_node, see https://nodejs.org"
    [ "$purpose" != test ] && return
    cargo fmt --version >/dev/null 2>&1 && cargo clippy --version >/dev/null 2>&1 ||
        fail "no rustfmt or clippy found: with rustup, type 'rustup component add rustfmt clippy'"
}

# Folders that the dynamic linker searches. Its cache is not enough: it lists libraries by soname, but an .icd may name the file.
library_folders() {
    printf '%s\n' "${LD_LIBRARY_PATH:-}" | tr ':' '\n'
    PATH=$PATH:/sbin:/usr/sbin ldconfig -NXv 2>/dev/null | sed -n 's/^\(\/[^:]*\):.*/\1/p'
}

# library_exists NAME_OR_PATH
library_exists() {
    local folder
    case $1 in
    /*) [ -e "$1" ] && return ;;
    *) while read -r folder; do
        [ -n "$folder" ] && [ -e "$folder/$1" ] && return
    done < <(library_folders) ;;
    esac
    return 1
}

# A driver counts when its .icd names a library that is there: containers often keep the .icd of a GPU they do not have.
has_opencl_driver() {
    local icd
    for icd in "${OCL_ICD_VENDORS:-/etc/OpenCL/vendors}"/*.icd; do
        [ -e "$icd" ] && library_exists "$(head -n 1 "$icd" | tr -d '[:space:]')" && return
    done
    return 1
}

is_debian_12() {
    (. /etc/os-release && [ "$ID" = debian ] && [ "${VERSION_ID:-}" = 12 ]) 2>/dev/null
}

has_chromium() {
    command -v "${CHROMIUM:-chromium}" >/dev/null
}

# Prints the Debian packages that are missing, one a line.
missing_packages() {
    if ! command -v cc >/dev/null || ! command -v c++ >/dev/null; then
        printf '%s\n' build-essential
    fi
    [ "$purpose" = build ] && return
    library_exists libOpenCL.so.1 || printf '%s\n' ocl-icd-libopencl1
    has_opencl_driver || printf '%s\n' pocl-opencl-icd
    [ "$purpose" = run ] && return
    # Only Debian 12 has it; elsewhere tests/scripts/oclgrind.sh unpacks that of Debian 12, whose keys it needs
    command -v oclgrind >/dev/null || ! is_debian_12 || printf '%s\n' oclgrind
    [ -e /usr/share/keyrings/debian-archive-keyring.gpg ] || printf '%s\n' debian-archive-keyring
    command -v mmdebstrap >/dev/null || printf '%s\n' mmdebstrap
    command -v "${CLANG:-clang}" >/dev/null || printf '%s\n' clang
    echo '#include <CL/cl_layer.h>' | cc -E - >/dev/null 2>&1 || printf '%s\n' opencl-c-headers
    # Lines of docs/how-to, which are run as they are written
    command -v curl >/dev/null || printf '%s\n' curl
    command -v openssl >/dev/null || printf '%s\n' openssl
    command -v python3 >/dev/null || printf '%s\n' python3
    # For the generated clients, in a virtual environment
    python3 -c 'import ensurepip' 2>/dev/null || printf '%s\n' python3-venv
    # a browser without a font draws boxes
    has_chromium || printf '%s\n' chromium fonts-dejavu-core
}

check_toolchains
mapfile -t missing < <(missing_packages)
[ ${#missing[@]} -eq 0 ] && exit 0

line="apt-get install --yes --no-install-recommends ${missing[*]}"
if ! command -v apt-get >/dev/null; then
    fail "missing on this machine, by their Debian names: ${missing[*]}" \
        "install what your system calls them, then type the command again"
fi
if [ "$(id -u)" -eq 0 ]; then
    root=()
elif command -v sudo >/dev/null && sudo --non-interactive true 2>/dev/null; then
    root=(sudo --non-interactive)
else
    fail "missing: ${missing[*]}; installing needs root, type this, then the command again:" "" "    sudo $line"
fi

printf 'isopeel: installing %s\n' "${missing[*]}"
install=("${root[@]}" env DEBIAN_FRONTEND=noninteractive ${line})
# The lists of a fresh image are empty, those of an old machine name packages that are gone: refresh only then.
"${install[@]}" </dev/null >/dev/null 2>&1 || {
    "${root[@]}" apt-get update --quiet=2 </dev/null
    "${install[@]}" --quiet=2 </dev/null
} || fail "could not install what is missing, type this to see why:" "" "    sudo $line"

mapfile -t missing < <(missing_packages)
[ ${#missing[@]} -eq 0 ] || fail "installed, yet still missing: ${missing[*]}"
