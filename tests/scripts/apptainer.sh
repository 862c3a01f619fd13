#!/bin/bash
# Builds docker/isopeel.def by Apptainer from an OCI archive of `make dist`, and runs it: a surface, and a server with its page.
#
#   tests/scripts/apptainer.sh ARCHIVE
#
# Apptainer is that of Debian's sid, in a root (tests/scripts/fresh-debian.sh); as root, or after it made the root once. Needs skopeo.
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

# Run in the root, where this repository is read-only at its own path.
in_root() {
    set -euo pipefail
    apptainer --version
    cd "$(mktemp -d)"
    cp "$1/isopeel-cpu.tar" "$1/ball.nrrd" .
    apptainer build isopeel.sif "$2" >build.log 2>&1 || { tail -n 30 build.log >&2 && exit 1; }
    apptainer run isopeel.sif extract ball.nrrd --iso 100 --format stl -o ball.stl
    [ -s ball.stl ]
    apptainer run isopeel.sif serve --listen 127.0.0.1:18492 --no-auth ball.nrrd >log 2>&1 &
    server=$!
    for _ in $(seq 300); do
        [ "$(curl --silent --output /dev/null --write-out '%{http_code}' http://127.0.0.1:18492/readyz)" = 200 ] && break
        sleep 1
    done
    curl --fail --silent http://127.0.0.1:18492/ | grep --quiet '<script' || { cat log >&2 && exit 1; }
    kill "$server" && wait "$server"
    echo "$(stat --format %s isopeel.sif | numfmt --to=si --suffix=B): a surface and the page"
}
tests/scripts/fresh-debian.sh run sid apptainer,ca-certificates,curl bash -c "$(declare -f in_root); in_root \"\$@\"" in_root "$PWD/$work" "$PWD/docker/isopeel.def"
