#!/bin/bash
# What a release consists of, in target/dist: a tarball and a Debian package for x86-64, their symbols, licences, a bill of materials and checksums.
#
#   packaging/dist.sh build         compiles the binary against an old glibc
#   packaging/dist.sh pack          makes the files of it
#   packaging/dist.sh try SUITE...  installs and runs both in roots of these Debian releases; as root, or after it made the roots once
#
# `build` needs Rust and the web client in web/dist, and gets zig and cargo-zigbuild from PyPI. `pack` needs binutils, dpkg-deb and xz, and writes
# the same bytes for the same binary and commit. `try` uses tests/scripts/fresh-debian.sh.
case ${1:-} in -h | --help) sed -n '2,/^[^#]/{/^#/s/^# \{0,1\}//p}' "$0" && exit ;; esac
set -euo pipefail

cd "$(dirname "$0")/.."
# The oldest glibc that is supported: that of Debian 11.
glibc=2.31
target=x86_64-unknown-linux-gnu
version=$(sed -n 's/^version = "\(.*\)"/\1/p' Cargo.toml)
name=isopeel-$version-x86_64-linux
dist=$PWD/target/dist
binary=$PWD/target/$target/release/isopeel
SOURCE_DATE_EPOCH=${SOURCE_DATE_EPOCH:-$(git log -1 --format=%ct)}
export SOURCE_DATE_EPOCH

fail() {
    printf 'dist.sh: %s\n' "$*" >&2
    exit 1
}

build() {
    local tools=$PWD/target/dist-venv
    if [ ! -x "$tools/bin/cargo-zigbuild" ]; then
        python3 -m venv "$tools"
        "$tools/bin/pip" --quiet install --requirement packaging/requirements.txt
    fi
    # Paths of this machine would differ from those of another one.
    RUSTFLAGS="--remap-path-prefix=$PWD=/isopeel --remap-path-prefix=${CARGO_HOME:-$HOME/.cargo}=/cargo" \
        PATH=$tools/bin:$PATH cargo zigbuild --locked --release --package isopeel --target "$target.$glibc"
}

## What of the system the binary needs

# Symbols of newer versions than Debian 11 has, and libraries that are not on each machine.
check_binary() {
    local newest libraries
    newest=$(objdump --dynamic-syms "$1" | grep --only-matching 'GLIBC_[0-9.]*' | sort --version-sort --unique | tail -n 1)
    [ "$(printf '%s\n' "GLIBC_$glibc" "$newest" | sort --version-sort | tail -n 1)" = "GLIBC_$glibc" ] ||
        fail "$1 needs $newest, expected GLIBC_$glibc or older"
    if objdump --dynamic-syms "$1" | grep --quiet 'GLIBCXX_\|CXXABI_'; then
        fail "$1 needs libstdc++, expected none"
    fi
    libraries=$(objdump --private-headers "$1" | sed -n 's/^ *NEEDED *//p' | grep --invert-match --line-regexp 'lib\(c\|m\|dl\|rt\|pthread\|util\)\.so\.[0-9]*\|ld-linux-x86-64\.so\.2' || true)
    [ -z "$libraries" ] || fail "$1 needs $libraries, expected those of glibc alone"
    echo "needs at most $newest, and no library but glibc"
}

## The files

# A folder with the time of the commit, as a tar file whose bytes depend on its content alone.
tar_of() {
    tar --create --sort=name --mtime="@$SOURCE_DATE_EPOCH" --owner=0 --group=0 --numeric-owner --format=gnu --directory "$1" "${@:2}"
}

# unpacked FOLDER: what is in the tarball, and in /usr/share/doc of the package.
documents() {
    cp README.md CHANGELOG.md LICENSE-MIT LICENSE-APACHE "$work/THIRD-PARTY.txt" "$1"
}

# The unit leaves the service little, where systemd can say so.
check_unit() {
    command -v systemd-analyze >/dev/null || return 0
    systemd-analyze security --offline=yes --threshold=30 packaging/isopeel.service >"$work/unit" || { cat "$work/unit" >&2 && fail "the unit is rated above 3"; }
    tail --lines=1 "$work/unit"
}

make_package() {
    local root=$work/deb
    install -D --mode=755 "$work/isopeel" "$root/usr/bin/isopeel"
    install -D --mode=644 packaging/isopeel.service "$root/lib/systemd/system/isopeel.service"
    install -D --mode=644 packaging/isopeel.toml "$root/etc/isopeel/isopeel.toml"
    install --directory "$root/usr/share/doc/isopeel" "$root/DEBIAN" "$root/usr/share/bash-completion/completions" "$root/usr/share/man/man1"
    documents "$root/usr/share/doc/isopeel"
    cp LICENSE-MIT "$root/usr/share/doc/isopeel/copyright"
    "$work/isopeel" completions bash >"$root/usr/share/bash-completion/completions/isopeel"
    "$work/isopeel" manual "$root/usr/share/man/man1"
    gzip --no-name --best "$root/usr/share/man/man1/"*
    echo /etc/isopeel/isopeel.toml >"$root/DEBIAN/conffiles"
    sed "s/@VERSION@/$version/; s/@GLIBC@/$glibc/; s/@SIZE@/$(du --summarize --apparent-size --block-size=1K "$root" | cut -f1)/" packaging/control >"$root/DEBIAN/control"
    install --mode=755 packaging/postinst packaging/prerm packaging/postrm "$root/DEBIAN"
    chmod -R u=rwX,go=rX "$root"
    dpkg-deb --root-owner-group -Zxz --build "$root" "$dist/isopeel_${version}_amd64.deb" >/dev/null
}

pack() {
    [ -x "$binary" ] || fail "$binary is not there: packaging/dist.sh build"
    work=$(mktemp -d)
    trap 'rm -rf "$work"' EXIT
    rm -rf "$dist"
    mkdir -p "$dist" "$work/$name"
    objcopy --only-keep-debug "$binary" "$work/isopeel.debug"
    objcopy --strip-all --add-gnu-debuglink="$work/isopeel.debug" "$binary" "$work/isopeel"
    check_binary "$work/isopeel"
    check_unit
    packaging/third_party.py "$work"
    cp "$work/isopeel.cdx.json" "$dist/isopeel-$version.cdx.json"

    install --mode=755 "$work/isopeel" "$work/$name/isopeel"
    documents "$work/$name"
    cp packaging/isopeel.service packaging/isopeel.toml docker/isopeel.slurm docker/isopeel-batch.slurm "$work/$name"
    chmod -R u=rwX,go=rX "$work/$name"
    tar_of "$work" "$name" | gzip --no-name --best >"$dist/$name.tar.gz"
    tar_of "$work" isopeel.debug | xz --threads=1 -1 >"$dist/$name-symbols.tar.xz"
    make_package
    (cd "$dist" && sha256sum -- * >"$work/sums" && mv "$work/sums" SHA256SUMS)
    ls -l "$dist"
}

## Trying them

# Run in a root, where this repository is read-only at its own path.
in_root() {
    set -euo pipefail
    . /etc/os-release
    cd "$(mktemp -d)"
    tar --extract --gzip --file "$1/$2.tar.gz"
    "./$2/isopeel" --version
    dpkg --install "$1/isopeel_$4_amd64.deb" >/dev/null
    [ "$(command -v isopeel)" = /usr/bin/isopeel ]
    # PoCL 1.6 of Debian 11 compiles for few processors.
    if ! "./$2/isopeel" extract - --iso 100 --format stl -o tarball.stl <"$3" 2>log; then
        grep --quiet 'Update or replace the driver' log || { cat log >&2 && exit 1; }
        isopeel info - <"$3" | grep --quiet '16 x 16 x 16'
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
    curl --fail --silent http://127.0.0.1:8471/ | grep --quiet '<script'
    kill "$server" && wait "$server"
    dpkg --purge isopeel >/dev/null
    [ ! -e /usr/bin/isopeel ] && [ ! -e /etc/isopeel ]
    echo "$PRETTY_NAME: tarball and package run"
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
            bash -c "$(declare -f in_root); in_root \"\$@\"" in_root "$dist" "$name" "$dist/ball.nrrd" "$version"
    done
    rm "$dist/ball.nrrd"
}

case ${1:-} in
build) build ;;
pack) pack ;;
try) shift && try "$@" ;;
*) sed -n '2,9s/^# \{0,1\}//p' "$0" && exit 2 ;;
esac
