#!/bin/bash
# Builds all images, without a container engine's daemon and without pulling anything, and runs the CPU one as docker/README.md
# says: read-only, as its own user, without capabilities. The browser tests then use it in place of the binary.
#
#   sudo tests/scripts/containers.sh [TEST ...]     names of tests in tests/browser; without any all of them
#
# Needs root, Debian, and network (Debian, crates.io, npm). Rust and Node are this machine's own, copied into images that only
# build. What this machine needs to reach the network (certificates, ~/.npmrc, ~/.cargo/config.toml) is mounted while they build
# and stays out of the images. Bases are those of tests/scripts/base-images.sh. IMAGE_BINARY=packed
# takes the binary of `make dist` instead of compiling another one. ISOPEEL_LOG is where the builds' output goes.
case ${1:-} in -h | --help) sed -n '2,/^[^#]/{/^#/s/^# \{0,1\}//p}' "$0" && exit ;; esac
set -euo pipefail

cd "$(dirname "$0")/../.."
log=${ISOPEEL_LOG:-target/containers.log}
mkdir -p "$(dirname "$log")"

say() { printf '\n=== %s\n' "$*"; }
fail() {
    tail -n 40 "$log" >&2
    printf 'containers.sh: %s; the log is %s\n' "$*" "$log" >&2
    exit 1
}

[ "$(id -u)" -eq 0 ] || { echo "containers.sh: needs root" >&2 && exit 1; }
for tool in buildah podman mmdebstrap runc; do
    command -v "$tool" >/dev/null || apt-get install --yes --no-install-recommends buildah podman mmdebstrap runc >"$log" 2>&1 ||
        fail "could not install $tool"
done

work=$(mktemp -d /var/tmp/isopeel-containers.XXXXXX)
trap 'rm -rf "$work"' EXIT

say "base images"
tests/scripts/base-images.sh debian trixie rust node >"$log" 2>&1 || fail "could not make the base images"

mounts=(--volume "$(realpath /etc/ssl/certs/ca-certificates.crt):/etc/ssl/certs/ca-certificates.crt:ro")
[ -e ~/.npmrc ] && mounts+=(--volume "$HOME/.npmrc:/root/.npmrc:ro")
[ -e ~/.cargo/config.toml ] && mounts+=(--volume "$HOME/.cargo/config.toml:/usr/local/cargo/config.toml:ro")

# build TARGET TAG [BASE]
build() {
    local start=$SECONDS
    # Debian 12's buildah does not see that the default names a stage.
    buildah build --isolation chroot --layers "${mounts[@]}" --target "$1" --tag "localhost/$2" --build-arg BINARY="${IMAGE_BINARY:-compiled}" \
        --build-arg BASE_IMAGE="localhost/isopeel-${3:-debian}" --build-arg RUST_IMAGE=localhost/isopeel-rust \
        --build-arg NODE_IMAGE=localhost/isopeel-node --file docker/Dockerfile . >>"$log" 2>&1 || fail "could not build $1"
    printf '%s: %s, %d s\n' "$2" "$(podman image inspect --format '{{.Size}}' "localhost/$2" | numfmt --to=si --suffix=B)" $((SECONDS - start))
}

# As docker/README.md has it: a file, which a debugger finds for the binary of the image by the checksum that this names.
build_symbols() {
    local container root
    buildah build --isolation chroot --layers "${mounts[@]}" --target symbols --output "$work/symbols" --build-arg BASE_IMAGE=localhost/isopeel-debian \
        --build-arg RUST_IMAGE=localhost/isopeel-rust --build-arg NODE_IMAGE=localhost/isopeel-node --file docker/Dockerfile . >>"$log" 2>&1 || fail "could not build symbols"
    container=$(buildah from --pull=never localhost/isopeel:cpu)
    root=$(buildah mount "$container")
    python3 - "$root/usr/local/bin/isopeel" "$work/symbols/isopeel.debug" <<'SCRIPT' || fail "the symbols are not those of the image's binary"
import subprocess, sys, zlib
binary, symbols = sys.argv[1:]
links = subprocess.run(["readelf", "--debug-dump=links", binary], capture_output=True, text=True).stdout
assert "Separate debug info file: isopeel.debug" in links, links
assert int(links.split("CRC value:")[1].split()[0], 16) == zlib.crc32(open(symbols, "rb").read()), f"another checksum: {links}"
lines = subprocess.run(["readelf", "--debug-dump=decodedline", symbols], check=True, capture_output=True).stdout.count(b"main.rs")
assert lines > 0, "no line numbers"
print(f"{len(open(symbols, 'rb').read()) / 1e6:.0f} MB, with line numbers; the binary has {len(open(binary, 'rb').read()) / 1e6:.0f} MB")
SCRIPT
    buildah umount "$container" >/dev/null
    buildah rm "$container" >/dev/null
}

say "images"
build cpu isopeel:cpu
build gpu isopeel
build mesa isopeel:mesa trixie
build intel isopeel:intel

# Debian 12's buildah names the stage of the binary by the argument.
say "in Docker's format, with the health check"
buildah build --format docker --isolation chroot "${mounts[@]}" --layers --target gpu --tag localhost/isopeel:docker --build-arg BINARY="${IMAGE_BINARY:-compiled}" \
    --build-arg BASE_IMAGE=localhost/isopeel-debian --build-arg RUST_IMAGE=localhost/isopeel-rust --build-arg NODE_IMAGE=localhost/isopeel-node \
    --file docker/Dockerfile . >>"$log" 2>&1 || fail "could not build in Docker's format"
podman image inspect --format '{{.HealthCheck.Test}}' localhost/isopeel:docker | grep healthcheck.sh || fail "the image has no health check"

# With `packed` they are a file of the release.
if [ "${IMAGE_BINARY:-compiled}" = compiled ]; then
    say "symbols of the images' binary"
    build_symbols
fi

say "without a device each says so"
for image in isopeel isopeel:mesa isopeel:intel; do
    if podman run --rm --runtime runc --network host --ulimit nofile=4096:4096 --ulimit nproc=4096:4096 "localhost/$image" devices >"$work/said" 2>&1 ||
        ! grep --quiet 'the OpenCL loader found no driver\|the OpenCL drivers offer no device' "$work/said"; then
        cat "$work/said" >&2 && fail "$image does not say that there is no device"
    fi
done

say "the CPU image, read-only, not root, without capabilities"
# Replaces the binary. The tests' volumes are in /tmp or the fixtures. It writes only to its own folder: PoCL caches compiled kernels there and
# loads them as libraries. The tests choose the folders of state and uploads. It sets limits of its own, as podman's may be above this machine's.
mkdir -m 0777 "$work/home"
chmod a+x "$work"
export ISOPEEL_HOME=$work/home FIXTURES=$PWD/tests/fixtures
cat >"$work/isopeel" <<'SCRIPT'
#!/bin/bash
# The tests make folders for themselves alone: what the server reads becomes readable, what it writes to its user's.
before=
for word; do
    case $before in
    --state-folder | --uploads | --save) mkdir -p "$word" && chmod 700 "$word" && chown 10001 "$word" ;;
    *) [ -e "$word" ] && chmod -R a+rX "$word" ;;
    esac
    folder=$(dirname -- "$word")
    [[ $folder == /tmp/* ]] && chmod -R a+rX "$folder"
    before=$word
done
# Who kills podman means the server.
name=isopeel-$$
(while kill -0 $$; do sleep 0.1; done; podman kill "$name") >/dev/null 2>&1 &
exec podman run --rm --interactive --name "$name" --runtime runc --network host --ulimit nofile=4096:4096 --ulimit nproc=4096:4096 --read-only \
    --read-only-tmpfs=false --cap-drop all --security-opt no-new-privileges --volume "$ISOPEEL_HOME:/var/lib/isopeel" --volume /tmp:/tmp \
    --unsetenv ISOPEEL_STATE_FOLDER --unsetenv ISOPEEL_UPLOADS --unsetenv ISOPEEL_FOLDER_ACCESS \
    --volume "$FIXTURES:$FIXTURES:ro" \
    localhost/isopeel:cpu "$@"
SCRIPT
chmod +x "$work/isopeel"
"$work/isopeel" devices
podman run --rm --runtime runc --network host --ulimit nofile=4096:4096 --ulimit nproc=4096:4096 --entrypoint id localhost/isopeel:cpu

say "browser tests against it"
tests=("$@")
[ ${#tests[@]} -gt 0 ] || mapfile -t tests < <(cd tests/browser && ls ./*.test.mjs)
# Some draw with the viewer's own modules, which web has tools for.
for folder in web tests/browser; do
    [ -d "$folder/node_modules" ] || (cd "$folder" && npm ci --no-audit --no-fund --loglevel=error)
done
cd tests/browser
ISOPEEL_BINARY="$work/isopeel" node --test --test-concurrency=1 "${tests[@]}"
