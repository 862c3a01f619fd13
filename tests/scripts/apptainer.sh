#!/bin/bash
# Builds docker/isopeel.def by Apptainer from an OCI archive of `make dist`, and runs it: a surface, and a server with its page.
#
#   tests/scripts/apptainer.sh ARCHIVE
#
# Apptainer is that of Debian's sid, in a root (tests/scripts/fresh-debian.sh). Needs root and skopeo.
case ${1:-} in -h | --help) sed -n '2,/^[^#]/{/^#/s/^# \{0,1\}//p}' "$0" && exit ;; esac
set -euo pipefail

[ $# -eq 1 ] || { echo "apptainer.sh: expected an archive, found: $*" >&2 && exit 2; }
cd "$(dirname "$0")/../.."
work=target/apptainer
rm -rf "$work"
mkdir -p "$work"
trap 'rm -rf "$work"' EXIT
# What `docker save` writes.
skopeo copy --quiet "oci-archive:$1" "docker-archive:$work/isopeel-cpu.tar:isopeel:cpu"
awk 'BEGIN {
    printf "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 16 16 16\nencoding: ascii\n\n"
    for (i = 0; i < 4096; i++) { x = i % 16; y = int(i / 16) % 16; z = int(i / 256); print ((x - 7.5) ^ 2 + (y - 7.5) ^ 2 + (z - 7.5) ^ 2 < 25 ? 200 : 10) }
}' >"$work/ball.nrrd"

# Run in the root, with the files in /srv.
in_root() {
    set -euo pipefail
    apptainer --version
    cd "$(mktemp -d)"
    cp /srv/isopeel-cpu.tar /srv/isopeel.def /srv/ball.nrrd .
    apptainer build isopeel.sif isopeel.def >build.log 2>&1 || { tail -n 30 build.log >&2 && exit 1; }
    apptainer run isopeel.sif extract ball.nrrd --iso 100 --format stl -o ball.stl
    [ -s ball.stl ]
    apptainer run isopeel.sif serve --listen 127.0.0.1:18492 --no-auth ball.nrrd >log 2>&1 &
    server=$!
    for _ in $(seq 300); do
        [ "$(curl --silent --output /dev/null --write-out '%{http_code}' http://127.0.0.1:18492/readyz)" = 200 ] && break
        sleep 1
    done
    curl --fail --silent --output page http://127.0.0.1:18492/ && grep --quiet '<script' page || { cat log >&2 && exit 1; }
    kill "$server" && wait "$server"
    echo "$(stat --format %s isopeel.sif | numfmt --to=si --suffix=B): a surface and the page"
}
cp docker/isopeel.def "$work"
tests/scripts/fresh-debian.sh run sid apptainer,ca-certificates,curl true
# Apptainer refuses a root that is entered by chroot, and wants all capabilities, which it has in a namespace of users.
unshare --mount --pid --fork --kill-child --propagation private bash -euc '
    root=$(realpath "$1")
    mount --bind "$root" "$root"
    mount -t proc proc "$root/proc"
    mount --rbind /sys "$root/sys"
    mount --rbind /dev "$root/dev"
    mount -t tmpfs tmpfs "$root/tmp"
    mount --bind "$2" "$root/srv"
    cd "$root"
    pivot_root . mnt
    umount --lazy /mnt
    exec env HOME=/root PATH=/usr/sbin:/usr/bin:/sbin:/bin LANG=C.UTF-8 unshare --user --map-users=0:0:65536 --map-groups=0:0:65536 --setuid 0 --setgid 0 \
        bash -c "$3; in_root"
' bash target/roots/sid-with "$work" "$(declare -f in_root)" </dev/null
