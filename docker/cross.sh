#!/bin/bash
# Of the Dockerfile: compiles isopeel on BUILDARCH for TARGETARCH, each amd64 or arm64; without them for this machine.
#
#   cross.sh prepare    installs the compilers, where the two differ
#   cross.sh build      puts the binary into /usr/local/bin, and its line tables into /symbols
set -euo pipefail

here=$(dpkg --print-architecture)
from=${BUILDARCH:-$here} to=${TARGETARCH:-$here}
case $to in
amd64) cpu=x86_64 packages="gcc-x86-64-linux-gnu g++-x86-64-linux-gnu" ;;
arm64) cpu=aarch64 packages="gcc-aarch64-linux-gnu g++-aarch64-linux-gnu" ;;
*) echo "cross.sh: the architecture is $to, expected amd64 or arm64" >&2 && exit 1 ;;
esac
target=$cpu-unknown-linux-gnu

case ${1:-} in
prepare)
    [ "$from" != "$to" ] || exit 0
    apt-get update
    # shellcheck disable=SC2086
    apt-get install --yes --no-install-recommends $packages
    rm -rf /var/lib/apt/lists/*
    rustup target add "$target"
    ;;
build)
    linker=CARGO_TARGET_$(tr 'a-z-' 'A-Z_' <<<"$target")_LINKER
    export "$linker=$cpu-linux-gnu-gcc"
    CARGO_PROFILE_RELEASE_DEBUG=line-tables-only CARGO_PROFILE_RELEASE_STRIP=none cargo build --locked --release --package isopeel --target "$target"
    built=target/$target/release/isopeel
    mkdir /symbols
    "$cpu-linux-gnu-objcopy" --only-keep-debug "$built" /symbols/isopeel.debug
    "$cpu-linux-gnu-objcopy" --strip-debug --add-gnu-debuglink=/symbols/isopeel.debug "$built" /usr/local/bin/isopeel
    ;;
*) sed -n '2,5s/^# \{0,1\}//p' "$0" && exit 2 ;;
esac
