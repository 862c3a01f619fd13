#!/bin/bash
# Proves the two commands: makes an empty Debian 12 root file system with Rust, Node, git and make and nothing else, clones
# this repository's HEAD into it, and runs `make test` and `make run` there.
#
#   sudo tests/scripts/fresh-debian.sh [FOLDER]     FOLDER is made, and and kept for inspection; a temporary one is not
#
# Needs root, debootstrap, and network (Debian, crates.io, npm). Rust and Node are this machine's own, copied. What this
# machine needs to reach the network (proxies, certificates, ~/.npmrc, ~/.cargo/config.toml) is taken from it while the
# script runs. PORT (8417) is where `make run` serves: the network is this machine's. DEBIAN_MIRROR and
# DEBIAN_SECURITY_MIRROR replace the usual ones; ISOPEEL_DATA names a folder of test volumes to take along.
set -euo pipefail

port=${PORT:-8417}
mirror=${DEBIAN_MIRROR:-http://deb.debian.org/debian}
security_mirror=${DEBIAN_SECURITY_MIRROR:-http://deb.debian.org/debian-security}
repository=$(git -C "$(dirname "$0")" rev-parse --show-toplevel)

say() { printf '\n=== %s\n' "$*"; }

# Mounts live and processes end with this namespace: nothing of this machine is left mounted where it could be deleted.
if [ -z "${ISOPEEL_FRESH_INSIDE:-}" ]; then
    [ "$(id -u)" -eq 0 ] || { echo "fresh-debian.sh: needs root" >&2 && exit 1; }
    command -v debootstrap >/dev/null || { echo "fresh-debian.sh: needs debootstrap" >&2 && exit 1; }
    folder=${1:-}
    if [ -z "$folder" ]; then
        folder=$(mktemp -d /var/tmp/isopeel-fresh.XXXXXX)
        trap 'rm -rf --one-file-system "$folder"' EXIT
    fi
    ISOPEEL_FRESH_INSIDE=1 unshare --mount --propagation private --pid --fork --kill-child "$0" "$(realpath "$folder")"
    exit
fi

root=$1

say "Debian 12 in $root"
mkdir -p "$root"
debootstrap --variant=minbase --include=ca-certificates,git,make bookworm "$root" "$mirror" >"$root.log" 2>&1 ||
    { tail -n 20 "$root.log" && exit 1; }
rm "$root.log"
cat >"$root/etc/apt/sources.list" <<LIST
deb $mirror bookworm main
deb $mirror bookworm-updates main
deb $security_mirror bookworm-security main
LIST

say "Rust and Node"
mkdir -p "$root/opt/rust" "$root/opt/node/bin" "$root/opt/node/lib/node_modules"
tar -C "$(rustc --print sysroot)" --exclude=./share --exclude=./lib/rustlib/src -cf - . | tar -C "$root/opt/rust" -xf -
cp "$(command -v node)" "$root/opt/node/bin/node"
cp -a "$(dirname "$(dirname "$(realpath "$(command -v npm)")")")" "$root/opt/node/lib/node_modules/npm"
ln -s ../lib/node_modules/npm/bin/npm-cli.js "$root/opt/node/bin/npm"
ln -s ../lib/node_modules/npm/bin/npx-cli.js "$root/opt/node/bin/npx"

say "this machine's way to the network"
for file in /etc/resolv.conf /etc/hosts /etc/apt/apt.conf.d/*proxy*; do
    [ -e "$file" ] && cp --dereference --no-target-directory "$file" "$root$file"
done
for file in .npmrc .cargo/config.toml .cargo/config; do
    [ -e "$HOME/$file" ] && install -D --mode=600 "$HOME/$file" "$root/root/$file"
done
if [ -d /usr/local/share/ca-certificates ]; then
    cp -a /usr/local/share/ca-certificates/. "$root/usr/local/share/ca-certificates/"
fi
cp --dereference /etc/ssl/certs/ca-certificates.crt "$root/etc/ssl/certs/ca-certificates.crt"
mapfile -t network < <(env | grep -iE '^([a-z_]*_proxy|[a-z_]*_ca_certs?|[a-z_]*ca_bundle|ssl_cert_[a-z]+|cargo_(http|net|registr)[a-z_]*|npm_config_[a-z_]+)=' || true)

# PoCL reads the processor's topology from /sys, chromium wants /dev/shm
mount -t proc proc "$root/proc"
mount --rbind /sys "$root/sys"
mount --rbind /dev "$root/dev"

inside() {
    env -i "${network[@]}" HOME=/root LANG=C.UTF-8 PATH=/opt/rust/bin:/opt/node/bin:/usr/sbin:/usr/bin:/sbin:/bin \
        ${ISOPEEL_DATA:+ISOPEEL_DATA=/root/data} chroot "$root" "$@"
}

say "clone of $(git -C "$repository" rev-parse --short HEAD)"
git clone --quiet --no-local "$repository" "$root/root/isopeel"
if [ -n "${ISOPEEL_DATA:-}" ]; then
    cp -rL "$ISOPEEL_DATA" "$root/root/data"
fi
inside sh -c 'cargo --version; node --version; ! command -v cc clinfo chromium'

say "make test"
time inside sh -c 'cd ~/isopeel && make test' </dev/null

say "make run"
inside sh -c "cd ~/isopeel && exec make run LISTEN=127.0.0.1:$port" </dev/null &
server=$!
# what a user's browser asks for first, and the demo behind it
inside node - "http://127.0.0.1:$port" <<'SCRIPT'
const url = process.argv[2]
for (let second = 0; ; second++) {
  const answer = await fetch(`${url}/readyz`).catch(() => undefined)
  if (answer?.ok) break
  if (second === 600) throw new Error('not ready within 600 s')
  await new Promise((resolve) => setTimeout(resolve, 1000))
}
const page = await fetch(`${url}/`).then((answer) => answer.text())
if (!page.includes('<script')) throw new Error(`the first page is not the client: ${page.slice(0, 200)}`)
const volumes = await fetch(`${url}/api/v1/volumes`).then((answer) => answer.json())
if (volumes.length === 0) throw new Error('no demo volume')
console.log('serves the client and', JSON.stringify(volumes).slice(0, 400))
SCRIPT
kill "$server" && wait "$server" || true
say "both commands work on a fresh Debian 12"
