#!/bin/bash
# File systems of Debian releases, in which this repository is tried. SUITE is a release: bookworm, trixie, forky, sid.
#
#   fresh-debian.sh prove SUITE [TARGET...]             runs `make TARGET` in a fresh clone; without any, `make test` and `make run`
#   fresh-debian.sh make SUITE PACKAGE,...              makes a root that has these packages
#   fresh-debian.sh run SUITE PACKAGE,... COMMAND...    runs a command in such a root; makes it if it is not there
#
# `prove` takes an empty SUITE with Rust, Node, git and make and nothing else, and clones HEAD into it. ISOPEEL_FOLDER is where
# it does so, and is kept for inspection; a temporary folder is not. PORT (8417) is where `make run` serves: the network is this
# machine's. ISOPEEL_DATA names a folder of test volumes to take along.
#
# `run` sees this repository at its own path, read-only, and has a home of its own, which is kept. What it runs inherits
# the environment. Only `make` and `prove` need root; without root, commands run in a user namespace.
#
# Roots are kept in target/roots until `make clean`: SUITE is an empty release, SUITE-with one with packages.
#
# Needs mmdebstrap, and network (Debian; for `prove` crates.io and npm too). Rust and Node are this machine's own, copied. What
# this machine needs to reach the network (proxies, certificates, ~/.npmrc, ~/.cargo/config.toml) is taken from it.
# DEBIAN_MIRROR and DEBIAN_SECURITY_MIRROR replace the usual ones.
case ${1:-} in -h | --help) sed -n '2,/^[^#]/{/^#/s/^# \{0,1\}//p}' "$0" && exit ;; esac
set -euo pipefail

mirror=${DEBIAN_MIRROR:-http://deb.debian.org/debian}
security_mirror=${DEBIAN_SECURITY_MIRROR:-http://deb.debian.org/debian-security}
repository=$(git -C "$(dirname "$0")" -c safe.directory='*' rev-parse --show-toplevel)
roots=$repository/target/roots
script=$repository/tests/scripts/fresh-debian.sh

say() { printf '\n=== %s\n' "$*" >&2; }

fail() {
    printf 'fresh-debian.sh: %s\n' "$@" >&2
    exit 1
}

usage() {
    sed -n 's/^#   \(fresh-debian.sh .*\)/\1/p' "$script" >&2
    exit 2
}

[ $# -ge 2 ] || usage
command=$1 suite=$2
shift 2
[[ $suite =~ ^[a-z]+$ ]] || fail "SUITE is '$suite', expected the name of a release, as bookworm"

## Roots

need_root() {
    [ "$(id -u)" -eq 0 ] || fail "needs root to make a root of $suite, type this, then the command again:" "" "    sudo $script $*"
}

# Copies this machine's network settings: only those of apt, without any user's keys.
copy_network() {
    local file
    for file in /etc/resolv.conf /etc/hosts /etc/apt/apt.conf.d/*proxy*; do
        [ -e "$file" ] && cp --dereference --no-target-directory "$file" "$1$file"
    done
    if [ -d /usr/local/share/ca-certificates ]; then
        cp -a /usr/local/share/ca-certificates/. "$1/usr/local/share/ca-certificates/"
    fi
    cp --dereference /etc/ssl/certs/ca-certificates.crt "$1/etc/ssl/certs/ca-certificates.crt"
}

# Makes target/roots/SUITE. It is renamed when it is complete, so that an interrupted run leaves none.
make_empty_root() {
    local root=$roots/$suite
    [ ! -e "$root" ] || return 0
    command -v mmdebstrap >/dev/null || fail "needs mmdebstrap: apt-get install mmdebstrap"
    say "Debian's $suite in $root"
    rm -rf --one-file-system "$root.new"
    mkdir -p "$roots"
    # A mirror may be a snapshot, older than its lists are valid.
    mmdebstrap --variant=minbase --include=ca-certificates,git,make --aptopt='Acquire::Check-Valid-Until "false"' \
        "$suite" "$root.new" "$mirror" >"$root.log" 2>&1 ||
        { tail -n 20 "$root.log" >&2 && fail "mmdebstrap failed, its log is $root.log"; }
    [ "$suite" = sid ] || cat >>"$root.new/etc/apt/sources.list" <<LIST
deb $mirror $suite-updates main
deb $security_mirror $suite-security main
LIST
    mv "$root.new" "$root"
    rm "$root.log"
}

# has_packages PACKAGE...: all are installed in target/roots/SUITE-with.
has_packages() {
    local installed
    [ -e "$roots/$suite-with" ] || return 1
    installed=$(sed -n '/^Package: /{s///;h}; /^Status: install ok installed/{x;p}' "$roots/$suite-with/var/lib/dpkg/status")
    for package; do
        grep --quiet --line-regexp --fixed-strings "$package" <<<"$installed" || return 1
    done
}

# Brings packages to target/roots/SUITE-with.
make_root() {
    local root=$roots/$suite-with
    need_root make "$suite" "$(IFS=, && echo "$*")"
    make_empty_root
    if [ ! -e "$root" ]; then
        rm -rf --one-file-system "$root.new"
        cp -a "$roots/$suite" "$root.new"
        mkdir -p "$root.new$repository"
        mv "$root.new" "$root"
    fi
    say "$suite: $*"
    copy_network "$root"
    local install=(env DEBIAN_FRONTEND=noninteractive apt-get install --yes --quiet=2 --no-install-recommends "$@")
    inside "$root" sh -c "apt-get update --quiet=2 && $(printf '%q ' "${install[@]}")" </dev/null >"$root.log" 2>&1 ||
        { tail -n 20 "$root.log" >&2 && fail "apt-get failed in $root, its log is $root.log"; }
    rm "$root.log"
    # Locks and homes belong to who uses the root.
    touch "$roots/$suite.lock"
    chown "${SUDO_UID:-0}" "$roots" "$roots/$suite.lock"
}

# inside ROOT COMMAND...: runs it in the root. Mounts live, and processes end, with namespaces of their own: nothing of this
# machine is left mounted where it could be deleted. PoCL reads the processor's topology from /sys, chromium wants /dev/shm. The
# root is a mount itself, so that a command may make namespaces in turn.
inside() {
    local users=()
    [ "$(id -u)" -eq 0 ] || users=(--map-root-user)
    unshare "${users[@]}" --mount --propagation private --pid --fork --kill-child bash -euc '
        root=$1
        shift
        mount --bind "$root" "$root"
        mount -t proc proc "$root/proc"
        mount --rbind /sys "$root/sys"
        mount --rbind /dev "$root/dev"
        if [ -n "${ISOPEEL_MOUNTS:-}" ]; then
            mount --bind -o ro "$ISOPEEL_MOUNTS" "$root$ISOPEEL_MOUNTS"
            mount --bind "$ISOPEEL_MOUNTED_HOME" "$root/root"
        fi
        exec chroot "$root" env -u ISOPEEL_MOUNTS -u ISOPEEL_MOUNTED_HOME "$@"
    ' inside "$@"
}

## Commands

run_command() {
    [ $# -ge 2 ] || usage
    local packages home=$roots/$suite-home-$(id -un)
    IFS=, read -ra packages <<<"$1"
    shift
    mkdir -p "$roots"
    exec {lock}>"$roots/$suite.lock"
    flock "$lock"
    has_packages "${packages[@]}" || make_root "${packages[@]}"
    flock --unlock "$lock"
    [ -d "$roots/$suite-with$repository" ] || need_root make "$suite" "$(IFS=, && echo "${packages[*]}")"
    mkdir -p "$home"
    ISOPEEL_MOUNTS=$repository ISOPEEL_MOUNTED_HOME=$home HOME=/root LANG=C.UTF-8 PATH=/usr/sbin:/usr/bin:/sbin:/bin \
        inside "$roots/$suite-with" "$@"
}

# Rust, Node and what npm and cargo need to reach the network, in the root of a proof.
copy_toolchains() {
    local root=$1 file
    mkdir -p "$root/opt/rust" "$root/opt/node/bin" "$root/opt/node/lib/node_modules"
    tar -C "$(rustc --print sysroot)" --exclude=./share --exclude=./lib/rustlib/src -cf - . | tar -C "$root/opt/rust" -xf -
    cp "$(command -v node)" "$root/opt/node/bin/node"
    cp -a "$(dirname "$(dirname "$(realpath "$(command -v npm)")")")" "$root/opt/node/lib/node_modules/npm"
    ln -s ../lib/node_modules/npm/bin/npm-cli.js "$root/opt/node/bin/npm"
    ln -s ../lib/node_modules/npm/bin/npx-cli.js "$root/opt/node/bin/npx"
    copy_network "$root"
    for file in .npmrc .cargo/config.toml .cargo/config; do
        [ -e "$HOME/$file" ] && install -D --mode=600 "$HOME/$file" "$root/root/$file"
    done
    return 0
}

# in_proof COMMAND...: with nothing of this machine's environment but its way to the network.
in_proof() {
    local network
    mapfile -t network < <(env | grep -iE '^([a-z_]*_proxy|[a-z_]*_ca_certs?|[a-z_]*ca_bundle|ssl_cert_[a-z]+|cargo_(http|net|registr)[a-z_]*|npm_config_[a-z_]+|debian_[a-z_]*mirror)=' || true)
    inside "$proof" env -i "${network[@]}" HOME=/root LANG=C.UTF-8 PATH=/opt/rust/bin:/opt/node/bin:/usr/sbin:/usr/bin:/sbin:/bin \
        ${ISOPEEL_DATA:+ISOPEEL_DATA=/root/data} "$@"
}

# What a user's browser asks for first, and the demo behind it.
check_page() {
    in_proof node - "http://127.0.0.1:$1" <<'SCRIPT'
const url = process.argv[2]
for (let second = 0; ; second++) {
  const answer = await fetch(`${url}/readyz`).catch(() => undefined)
  if (answer?.ok) break
  if (second === 1800) throw new Error('not ready within 1800 s')
  await new Promise((resolve) => setTimeout(resolve, 1000))
}
const page = await fetch(`${url}/`).then((answer) => answer.text())
if (!page.includes('<script')) throw new Error(`the first page is not the client: ${page.slice(0, 200)}`)
const volumes = await fetch(`${url}/api/v1/volumes`).then((answer) => answer.json())
if (volumes.length === 0) throw new Error('no demo volume')
console.log('serves the client and', JSON.stringify(volumes).slice(0, 400))
SCRIPT
}

# The first process of a namespace, here make, may ignore SIGTERM and wait for ever for others that ended.
end_server() {
    kill -- -"$server" || true
    for _ in {1..100}; do
        kill -0 "$server" 2>/dev/null || break
        sleep 0.1
    done
    kill -KILL -- -"$server" 2>/dev/null || true
    wait "$server" || true
}

cleanup() {
    [ -n "${ISOPEEL_FOLDER:-}" ] || rm -rf --one-file-system "$proof"
}

prove() {
    local port=${PORT:-8417} server
    [ $# -gt 0 ] || set -- test run
    need_root prove "$suite" "$@"
    make_empty_root
    proof=${ISOPEEL_FOLDER:-$(mktemp -d /var/tmp/isopeel-fresh.XXXXXX)}
    trap cleanup EXIT
    mkdir -p "$proof"
    proof=$(realpath "$proof")
    say "$suite in $proof, with Rust and Node"
    cp -a "$roots/$suite/." "$proof"
    copy_toolchains "$proof"

    say "clone of $(git -C "$repository" rev-parse --short HEAD)"
    git clone --quiet --no-local "$repository" "$proof/root/isopeel"
    if [ -n "${ISOPEEL_DATA:-}" ]; then
        cp -rL "$ISOPEEL_DATA" "$proof/root/data"
    fi
    in_proof sh -c 'cat /etc/debian_version; cargo --version; node --version; ! command -v cc clinfo chromium'

    for wanted; do
        say "make $wanted"
        case $wanted in
        run)
            set -m # a process group of its own, which is ended as one
            in_proof sh -c "cd ~/isopeel && exec make run LISTEN=127.0.0.1:$port" </dev/null &
            server=$!
            set +m
            trap 'end_server; cleanup' EXIT
            check_page "$port"
            end_server
            trap cleanup EXIT
            ;;
        *) time in_proof make -C /root/isopeel "$wanted" </dev/null ;;
        esac
    done
    say "make $* on a fresh $suite: works"
}

case $command in
make)
    [ $# -eq 1 ] || usage
    IFS=, read -ra packages <<<"$1"
    make_root "${packages[@]}"
    ;;
run) run_command "$@" ;;
prove) prove "$@" ;;
*) usage ;;
esac
