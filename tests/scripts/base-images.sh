#!/bin/bash
# Images in the place of those that docker/Dockerfile names, for machines that cannot pull: of Debian's packages by mmdebstrap, with Rust and Node of this
# machine.
#
#   base-images.sh NAME...     debian, rust, node, trixie: localhost/isopeel-NAME, for buildah and podman
#
# ARCHITECTURE is that of debian and trixie, as Debian calls it; by default this machine's. Another one's name ends in it: localhost/isopeel-debian-arm64, and
# needs qemu-user-static and arch-test. Like Debian's slim images these have no documentation. Needs root, buildah, mmdebstrap and network (Debian). DEBIAN_MIRROR replaces
# the usual one.
case ${1:-} in -h | --help) sed -n '2,/^[^#]/{/^#/s/^# \{0,1\}//p}' "$0" && exit ;; esac
set -euo pipefail

mirror=${DEBIAN_MIRROR:-http://deb.debian.org/debian}
here=$(dpkg --print-architecture)
architecture=${ARCHITECTURE:-$here}
suffix=
[ "$architecture" = "$here" ] || suffix=-$architecture
log=$(mktemp)
trap 'rm -f "$log"' EXIT

[ "$(id -u)" -eq 0 ] || { echo "base-images.sh: needs root" >&2 && exit 1; }

# image NAME BASE COMMAND...: runs it with $root, the file system of the new image, and $container
image() {
    local name=$1 container root
    container=$(buildah from --pull=never --platform "linux/$architecture" "$2")
    root=$(buildah mount "$container")
    shift 2
    "$@" "$container" "$root" >"$log" 2>&1 || { tail -n 40 "$log" >&2 && echo "base-images.sh: could not make the image $name" >&2 && exit 1; }
    buildah umount "$container" >/dev/null
    buildah commit --quiet --timestamp 0 --rm "$container" "localhost/isopeel-$name$suffix" >/dev/null
}

# make_debian SUITE CONTAINER ROOT
make_debian() {
    local excluded=() folder
    for folder in doc man info locale; do excluded+=(--dpkgopt="path-exclude=/usr/share/$folder/*"); done
    # usrmerge has done its work, and needs the whole of Perl. A mirror may be a snapshot, older than its lists are valid.
    SOURCE_DATE_EPOCH=0 mmdebstrap --variant=minbase --architectures="$architecture" --include=ca-certificates,usr-is-merged --aptopt='Acquire::Check-Valid-Until "false"' \
        "${excluded[@]}" --customize-hook='chroot "$1" apt-get purge --yes usrmerge perl "libperl5*" "perl-modules-*" "lib*-perl"' "$1" "$3" "$mirror"
}

make_rust() {
    buildah run --isolation chroot "$1" sh -c 'apt-get update && apt-get install --yes --no-install-recommends build-essential' </dev/null
    mkdir -p "$2/opt/rust" "$2/usr/local/cargo"
    tar -C "$(rustc --print sysroot)" --exclude=./share --exclude=./lib/rustlib/src -cf - . | tar -C "$2/opt/rust" -xf -
    buildah config --env CARGO_HOME=/usr/local/cargo --env PATH=/opt/rust/bin:/usr/sbin:/usr/bin:/sbin:/bin "$1"
}

make_node() {
    mkdir -p "$2/usr/local/lib/node_modules"
    cp "$(command -v node)" "$2/usr/local/bin/node"
    cp -a "$(dirname "$(dirname "$(realpath "$(command -v npm)")")")" "$2/usr/local/lib/node_modules/npm"
    ln -s ../lib/node_modules/npm/bin/npm-cli.js "$2/usr/local/bin/npm"
    buildah config --env NODE_EXTRA_CA_CERTS=/etc/ssl/certs/ca-certificates.crt "$1"
}

for name; do
    case $name in
    debian) image debian scratch make_debian bookworm ;;
    trixie) image trixie scratch make_debian trixie ;;
    rust) image rust localhost/isopeel-debian make_rust ;;
    node) image node localhost/isopeel-debian make_node ;;
    *) echo "base-images.sh: the image is $name, expected debian, trixie, rust or node" >&2 && exit 2 ;;
    esac
done
