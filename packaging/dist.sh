#!/bin/bash
# What a release consists of, in target/dist: of each architecture a tarball, a Debian package, symbols and images of containers; licences, a bill of
# materials and checksums.
#
#   packaging/dist.sh check         says what is missing on this machine, before anything is compiled
#   packaging/dist.sh build         compiles the binaries against an old glibc
#   packaging/dist.sh pack          makes the files of them
#   packaging/dist.sh images        makes OCI archives of them, by the targets cpu and gpu of docker/Dockerfile; as root
#   packaging/dist.sh try SUITE...  installs and runs tarball and package in roots of these Debian releases; as root, or after it made the roots once
#
# ARCHITECTURES is "amd64" unless it is set, as to "amd64 arm64"; arm64 is compiled on this machine, for which Rust has to have its target. `build` needs
# Rust and the web client in web/dist, and gets zig and cargo-zigbuild from PyPI. `pack` needs binutils of each architecture, debugedit, dpkg-deb and xz,
# `images` buildah, and qemu-user-static for another architecture than this machine's. Files have the same bytes for the same commit, compilers,
# length of this folder's path and base image: BASE_IMAGE, that of the Dockerfile unless it is set. `try` uses tests/scripts/fresh-debian.sh.
case ${1:-} in -h | --help) sed -n '2,/^[^#]/{/^#/s/^# \{0,1\}//p}' "$0" && exit ;; esac
set -euo pipefail

cd "$(dirname "$0")/.."
# The oldest glibc that is supported: that of Debian 11.
glibc=2.31
read -ra architectures <<<"${ARCHITECTURES:-amd64}"
version=$(sed -n 's/^version = "\(.*\)"/\1/p' Cargo.toml)
dist=$PWD/target/dist
# Where the Dockerfile takes them from.
binaries=$PWD/target/dist-binaries
SOURCE_DATE_EPOCH=${SOURCE_DATE_EPOCH:-$(git log -1 --format=%ct)}
export SOURCE_DATE_EPOCH

fail() {
    printf 'dist.sh: %s\n' "$*" >&2
    exit 1
}

# What `uname -m` prints, by Debian's name of an architecture.
machine_of() {
    case $1 in
    amd64) echo x86_64 ;;
    arm64) echo aarch64 ;;
    *) fail "the architecture is $1, expected amd64 or arm64" ;;
    esac
}
# tool ARCHITECTURE NAME: a program of binutils
tool() { echo "$(machine_of "$1")-linux-gnu-$2"; }
name_of() { echo "isopeel-$version-$(machine_of "$1")-linux"; }

## What it needs

base_image() { echo "${BASE_IMAGE:-$(sed -n 's/^ARG BASE_IMAGE=//p' docker/Dockerfile)}"; }

check() {
    local architecture program
    for architecture in "${architectures[@]}"; do
        command -v "$(tool "$architecture" objcopy)" >/dev/null || fail "needs $(tool "$architecture" objcopy): apt-get install binutils-$(machine_of "$architecture" | tr _ -)-linux-gnu"
    done
    for program in debugedit dpkg-deb xz buildah; do
        command -v "$program" >/dev/null || fail "needs $program: apt-get install debugedit dpkg xz-utils buildah"
    done
    python3 -c 'import ensurepip' 2>/dev/null || fail "needs Python's venv: apt-get install python3-venv"
    # The images come last.
    for architecture in "${architectures[@]}"; do
        buildah inspect --type image "$(base_image)" >/dev/null 2>&1 || buildah pull --quiet --platform "linux/$architecture" "$(base_image)" >/dev/null ||
            fail "cannot get the base image $(base_image); BASE_IMAGE names another one, such as that of tests/scripts/base-images.sh debian: localhost/isopeel-debian"
    done
}

## The binaries

build() {
    local architecture tools=$PWD/target/dist-venv cargo=${CARGO_HOME:-$HOME/.cargo} renamed
    if [ ! -x "$tools/bin/cargo-zigbuild" ]; then
        python3 -m venv "$tools"
        "$tools/bin/pip" --quiet install --requirement packaging/requirements.txt
    fi
    # Zig's own objects name the folder in which it lies; a cache of the user's would have that of another build.
    export ZIG_GLOBAL_CACHE_DIR=$PWD/target/zig-cache
    # Paths of this machine would differ from those of another one.
    renamed="-ffile-prefix-map=$PWD=/isopeel -ffile-prefix-map=$cargo=/cargo"
    for architecture in "${architectures[@]}"; do
        RUSTFLAGS="--remap-path-prefix=$PWD=/isopeel --remap-path-prefix=$cargo=/cargo" CFLAGS=$renamed CXXFLAGS=$renamed \
            CARGO_PROFILE_RELEASE_DEBUG=line-tables-only CARGO_PROFILE_RELEASE_STRIP=none PATH=$tools/bin:$PATH cargo zigbuild --locked --release --package isopeel --target "$(machine_of "$architecture")-unknown-linux-gnu.$glibc"
    done
}

## What of the system the binary needs

# check_binary ARCHITECTURE FILE: no symbols of newer versions than Debian 11 has, and no libraries that are not on each machine.
check_binary() {
    local newest libraries objdump
    objdump=$(tool "$1" objdump)
    newest=$("$objdump" --dynamic-syms "$2" | grep --only-matching 'GLIBC_[0-9.]*' | sort --version-sort --unique | tail -n 1)
    [ "$(printf '%s\n' "GLIBC_$glibc" "$newest" | sort --version-sort | tail -n 1)" = "GLIBC_$glibc" ] ||
        fail "$2 needs $newest, expected GLIBC_$glibc or older"
    # Not by a pipe: one that grep closes early counts as a failure, and the symbols as absent.
    "$objdump" --dynamic-syms "$2" >"$work/dynamic"
    if grep --quiet 'GLIBCXX_\|CXXABI_' "$work/dynamic"; then
        fail "$2 needs libstdc++, expected none"
    fi
    libraries=$("$objdump" --private-headers "$2" | sed -n 's/^ *NEEDED *//p' | grep --invert-match --line-regexp 'lib\(c\|m\|dl\|rt\|pthread\|util\)\.so\.[0-9]*\|ld-linux-[a-z0-9-]*\.so\.[12]' || true)
    [ -z "$libraries" ] || fail "$2 needs $libraries, expected those of glibc alone"
    echo "$1: needs at most $newest, and no library but glibc"
}

## The files

# A folder with the time of the commit, as a tar file whose bytes depend on its content alone.
tar_of() {
    tar --create --sort=name --mtime="@$SOURCE_DATE_EPOCH" --owner=0 --group=0 --numeric-owner --format=gnu --directory "$1" "${@:2}"
}

# documents FOLDER: what is in the tarball, and in /usr/share/doc of the package.
documents() {
    cp README.md CHANGELOG.md LICENSE-MIT LICENSE-APACHE "$work/THIRD-PARTY.txt" "$1"
}

# The unit leaves the service little, where systemd can say so.
check_unit() {
    command -v systemd-analyze >/dev/null || return 0
    systemd-analyze security --offline=yes --threshold=30 packaging/isopeel.service >"$work/unit" || { cat "$work/unit" >&2 && fail "the unit is rated above 3"; }
    tail --lines=1 "$work/unit"
}

# make_package ARCHITECTURE
make_package() {
    local root=$work/$1/deb program
    # Completions and manual are of the binary that this machine runs, if it is there.
    program=$binaries/$(dpkg --print-architecture)/isopeel
    [ -x "$program" ] || program=$binaries/$1/isopeel
    install -D --mode=755 "$binaries/$1/isopeel" "$root/usr/bin/isopeel"
    install -D --mode=644 packaging/isopeel.service "$root/lib/systemd/system/isopeel.service"
    install -D --mode=644 packaging/isopeel.toml "$root/etc/isopeel/isopeel.toml"
    install --directory "$root/usr/share/doc/isopeel" "$root/DEBIAN" "$root/usr/share/bash-completion/completions" "$root/usr/share/man/man1"
    documents "$root/usr/share/doc/isopeel"
    cp LICENSE-MIT "$root/usr/share/doc/isopeel/copyright"
    "$program" completions bash >"$root/usr/share/bash-completion/completions/isopeel"
    "$program" manual "$root/usr/share/man/man1"
    gzip --no-name --best "$root/usr/share/man/man1/"*
    echo /etc/isopeel/isopeel.toml >"$root/DEBIAN/conffiles"
    sed "s/@VERSION@/$version/; s/@GLIBC@/$glibc/; s/@ARCHITECTURE@/$1/; s/@SIZE@/$(du --summarize --apparent-size --block-size=1K "$root" | cut -f1)/" \
        packaging/control >"$root/DEBIAN/control"
    install --mode=755 packaging/postinst packaging/prerm packaging/postrm "$root/DEBIAN"
    chmod -R u=rwX,go=rX "$root"
    dpkg-deb --root-owner-group -Zxz --build "$root" "$dist/isopeel_${version}_$1.deb" >/dev/null
}

# strip_binary ARCHITECTURE: what is compiled, without symbols, which stay beside. The link to them has their checksum, so they have no paths of this
# machine either: compilers rename those of what they compile, and debugedit those of zig's own objects and of assembly in crates.
strip_binary() {
    local binary objcopy symbols=$work/$1/isopeel.debug
    binary=$PWD/target/$(machine_of "$1")-unknown-linux-gnu/release/isopeel
    objcopy=$(tool "$1" objcopy)
    [ -x "$binary" ] || fail "$binary is not there: packaging/dist.sh build"
    mkdir -p "$binaries/$1" "$work/$1"
    cp "$binary" "$work/$1/isopeel"
    debugedit --base-dir="$PWD" --dest-dir=/isopeel "$work/$1/isopeel"
    debugedit --base-dir="${CARGO_HOME:-$HOME/.cargo}" --dest-dir=/cargo "$work/$1/isopeel"
    "$objcopy" --only-keep-debug "$work/$1/isopeel" "$symbols"
    ! grep --quiet --fixed-strings --text -e "$PWD/" -e "${CARGO_HOME:-$HOME/.cargo}/" "$symbols" || fail "$symbols has paths of this machine"
    (cd "$work/$1" && "$objcopy" --strip-all --add-gnu-debuglink=isopeel.debug isopeel "$binaries/$1/isopeel")
    rm "$work/$1/isopeel"
    check_binary "$1" "$binaries/$1/isopeel"
}

# pack_for ARCHITECTURE
pack_for() {
    local name
    name=$(name_of "$1")
    mkdir "$work/$1/$name"
    install --mode=755 "$binaries/$1/isopeel" "$work/$1/$name/isopeel"
    documents "$work/$1/$name"
    cp packaging/isopeel.service packaging/isopeel.toml docker/isopeel.slurm docker/isopeel-batch.slurm "$work/$1/$name"
    chmod -R u=rwX,go=rX "$work/$1/$name"
    tar_of "$work/$1" "$name" | gzip --no-name --best >"$dist/$name.tar.gz"
    tar_of "$work/$1" isopeel.debug | xz --threads=1 -1 >"$dist/$name-symbols.tar.xz"
    make_package "$1"
}

write_sums() {
    (cd "$dist" && rm -f SHA256SUMS && sha256sum -- * >"$work/sums" && mv "$work/sums" SHA256SUMS)
    ls -l "$dist"
}

pack() {
    local architecture
    rm -rf "$dist" "$binaries"
    mkdir -p "$dist"
    for architecture in "${architectures[@]}"; do strip_binary "$architecture"; done
    check_unit
    packaging/third_party.py "$work"
    cp "$work/isopeel.cdx.json" "$dist/isopeel-$version.cdx.json"
    for architecture in "${architectures[@]}"; do pack_for "$architecture"; done
    write_sums
}

## Images

# image_of ARCHITECTURE TARGET: dist/isopeel-VERSION-TARGET-ARCHITECTURE.oci.tar
image_of() {
    local tag=localhost/isopeel:$version-$2-$1 base digest
    base=$(base_image)
    # One that this machine has made has no other name.
    digest=${base##*@}
    [ "$digest" != "$base" ] || digest=$(buildah inspect --type image --format '{{.FromImageDigest}}' "$base")
    buildah build --isolation chroot --no-cache --platform "linux/$1" --timestamp "$SOURCE_DATE_EPOCH" --target "$2" --tag "$tag" \
        --build-arg BINARY=packed --build-arg BASE_IMAGE="$base" \
        --label org.opencontainers.image.revision="$(git rev-parse HEAD)" \
        --label org.opencontainers.image.created="$(date --utc --date="@$SOURCE_DATE_EPOCH" +%Y-%m-%dT%H:%M:%SZ)" \
        --label org.opencontainers.image.base.digest="$digest" \
        --file docker/Dockerfile . >"$work/log" 2>&1 || { tail -n 40 "$work/log" >&2 && fail "could not build the image $2 for $1"; }
    # As a folder first: the archive's own bytes are to depend on its content alone.
    mkdir "$work/oci"
    buildah push --quiet "$tag" "oci:$work/oci:$version-$2" >/dev/null
    tar_of "$work/oci" . >"$dist/isopeel-$version-$2-$1.oci.tar"
    rm -r "$work/oci"
}

images() {
    local architecture target
    for architecture in "${architectures[@]}"; do
        [ -x "$binaries/$architecture/isopeel" ] || fail "$binaries/$architecture/isopeel is not there: packaging/dist.sh pack"
        for target in cpu gpu; do image_of "$architecture" "$target"; done
    done
    write_sums
}

## Trying them

# Run in a root, where this repository is read-only at its own path.
in_root() {
    set -euo pipefail
    . /etc/os-release
    cd "$(mktemp -d)"
    without_internet "$1" "$4"
    tar --extract --gzip --file "$1/$2.tar.gz"
    "./$2/isopeel" --version
    apt-get install --yes --quiet=2 "$1/isopeel_$4_amd64.deb" >/dev/null
    [ "$(command -v isopeel)" = /usr/bin/isopeel ]
    # PoCL 1.6 of Debian 11 compiles for few processors.
    if ! "./$2/isopeel" extract - --iso 100 --format stl -o tarball.stl <"$3" 2>log; then
        grep --quiet 'Update or replace the driver' log || { cat log >&2 && exit 1; }
        isopeel info - <"$3" >info
        grep --quiet '16 x 16 x 16' info
        isopeel token create --state-folder state --user ann --role view | grep --quiet '^isop_'
        dpkg --purge isopeel >/dev/null
        echo "$PRETTY_NAME: tarball and package run, but its PoCL does not compile for this processor: tried without a device"
        return
    fi
    isopeel extract - --iso 100 --format stl -o package.stl <"$3"
    cmp tarball.stl package.stl
    isopeel serve --listen 127.0.0.1:8471 --no-auth --state-folder state &
    server=$!
    for _ in $(seq 300); do
        [ "$(curl --silent --output answer --write-out '%{http_code}' http://127.0.0.1:8471/readyz)" = 200 ] && break
        sleep 1
    done
    # Not by a pipe, which grep would close before curl has written all.
    curl --fail --silent --output page http://127.0.0.1:8471/
    grep --quiet '<script' page
    kill "$server" && wait "$server"
    dpkg --purge isopeel >/dev/null
    [ ! -e /usr/bin/isopeel ] && [ ! -e /etc/isopeel ]
    echo "$PRETTY_NAME: tarball and package run"
}

# without_internet DIST VERSION: what docs/releases.md says to download is all that a minimal system lacks.
without_internet() {
    local download root system
    root=$(realpath "$1/../..")
    download=$(sed -n 's/^    \(apt-get download .*\)/\1/p' "$root"/docs/releases.md)
    mkdir packages lists
    (cd packages && eval "$download" >/dev/null 2>&1)
    cp "$1/isopeel_$2_amd64.deb" packages
    # The state of the release's minimal root, and no list of packages.
    system=(-o Dir::State::Status="$root/target/roots/$VERSION_CODENAME/var/lib/dpkg/status" -o Dir::State::Lists="$PWD/lists"
        -o Dir::Etc::SourceList=/dev/null -o Dir::Etc::SourceParts=/dev/null -o Dir::Cache::pkgcache= -o Dir::Cache::srcpkgcache=)
    (cd packages && apt-get "${system[@]}" install --simulate --yes ./*.deb) >simulated 2>&1 || { cat simulated >&2 && exit 1; }
    grep --quiet '^Inst isopeel ' simulated && grep --quiet '^Inst pocl-opencl-icd ' simulated
    rm -r packages
}

try() {
    [ -f "$dist/SHA256SUMS" ] || fail "nothing is in $dist: packaging/dist.sh pack"
    (cd "$dist" && sha256sum --check --quiet SHA256SUMS)
    awk 'BEGIN {
        printf "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 16 16 16\nencoding: ascii\n\n"
        for (i = 0; i < 4096; i++) { x = i % 16; y = int(i / 16) % 16; z = int(i / 256); print ((x - 7.5) ^ 2 + (y - 7.5) ^ 2 + (z - 7.5) ^ 2 < 25 ? 200 : 10) }
    }' >"$dist/ball.nrrd"
    for suite; do
        tests/scripts/fresh-debian.sh run "$suite" ocl-icd-libopencl1,pocl-opencl-icd,curl \
            bash -c "$(declare -f without_internet in_root); in_root \"\$@\"" in_root "$dist" "$(name_of amd64)" "$dist/ball.nrrd" "$version"
    done
    rm "$dist/ball.nrrd"
}

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

case ${1:-} in
check) check ;;
build) build ;;
pack) pack ;;
images) images ;;
try) shift && try "$@" ;;
*) sed -n '2,11s/^# \{0,1\}//p' "$0" && exit 2 ;;
esac
