#!/bin/bash
# Runs an OCI archive of `make dist` by rootless Podman: state is kept, any user may run it, nothing is left behind.
#
#   tests/scripts/podman.sh ARCHIVE
#
# Needs Podman with catatonit, curl and a user that is not root and has subordinate ids (/etc/subuid). PODMAN_NETWORK is "slirp4netns" by default;
# use "host" if a user may not create networks. Removes its own container, volume and image at the end, and no others.
case ${1:-} in -h | --help) sed -n '2,/^[^#]/{/^#/s/^# \{0,1\}//p}' "$0" && exit ;; esac
set -euo pipefail

[ $# -eq 1 ] || { echo "podman.sh: expected an archive, found: $*" >&2 && exit 2; }
archive=$(realpath "$1")
[ "$(id -u)" != 0 ] || { echo "podman.sh: runs as root, expected a user" >&2 && exit 2; }
port=${ISOPEEL_PORT:-18491} network=${PODMAN_NETWORK:-slirp4netns}
name=isopeel-test-$$ work=$(mktemp -d) url=http://127.0.0.1:$port
trap 'podman rm --force --time 1 $name >/dev/null 2>&1; podman volume rm --force $name >/dev/null 2>&1; podman rmi --force "localhost/$name" >/dev/null 2>&1; rm -rf "$work"' EXIT

fail() {
    printf 'podman.sh: %s\n' "$*" >&2
    podman logs "$name" >&2 || true
    exit 1
}
# start PODMAN_OPTION ...
start() {
    podman run --detach --init --name "$name" --network "$network" --volume "$name:/var/lib/isopeel" --publish "127.0.0.1:$port:$port" --read-only --cap-drop all \
        --security-opt no-new-privileges --stop-timeout 20 --env HEALTH_PORT="$port" "$@" "localhost/$name" serve --listen "0.0.0.0:$port" >/dev/null || fail "does not start"
}
ready() {
    local start=$EPOCHREALTIME
    for _ in $(seq 1200); do
        if [ "$(curl --silent --output /dev/null --write-out '%{http_code}' "$url/readyz")" = 200 ]; then
            echo "ready after $(echo "$start $EPOCHREALTIME" | awk '{ printf "%.1f", $2 - $1 }') s"
            return
        fi
        sleep 0.1
    done
    fail "not ready within two minutes"
}
# answers TOKEN: within the time that the server takes to see it
answers() { curl --silent --fail --output /dev/null --retry 8 --retry-delay 1 --retry-all-errors --header "Authorization: Bearer $1" "$url/api/v1/volumes" || fail "refuses a token"; }
# Number of the process of the device, in the container.
device_process() { podman exec "$name" sh -c 'for p in /proc/[0-9]*; do tr "\0" " " <"$p/cmdline" 2>/dev/null | grep --quiet "^isopeel worker " && echo "${p#/proc/}"; done; true'; }

loaded=$(podman load --quiet --input "$archive" | tail -n 1)
podman tag "${loaded##*: }" "localhost/$name"
podman rmi "${loaded##*: }" >/dev/null
echo "=== as it is shipped"
start
ready
token=$(podman exec "$name" isopeel token create --user ann --role view)
answers "$token"
podman exec "$name" healthcheck.sh || fail "healthcheck.sh fails"
podman logs "$name" 2>&1 | grep --only-matching 'the process of the device is .*confined.*' || fail "the log does not say whether the process of the device is confined"
first=$(device_process)
[ "$(wc -w <<<"$first")" = 1 ] || fail "the processes of one device are '$first'"
podman exec "$name" sh -c "kill -9 $first"
ready
second=$(device_process)
[ -n "$second" ] && [ "$second" != "$first" ] || fail "the process $first was killed, and now there is '$second'"
# The server waits for builders of kernels at the end of the check, which goes on.
[ "$(podman exec "$name" sh -c 'cat /proc/[0-9]*/stat' | awk -v killed="$first" '$3 == "Z" && ($4 == 1 || $1 == killed)' | wc -l)" = 0 ] || fail "zombies are left"
echo "=== after a restart"
podman restart "$name" >/dev/null
ready
answers "$token"
podman stop "$name" >/dev/null
[ "$(podman inspect --format '{{.State.ExitCode}}' "$name")" = 0 ] || fail "SIGTERM did not end it with success"
podman rm "$name" >/dev/null
podman volume rm "$name" >/dev/null
echo "=== as any user"
start --user 1234:0
ready
[ "$(podman exec "$name" id -u)" = 1234 ] || fail "another user than 1234"
answers "$(podman exec "$name" isopeel token create --user ann --role view)"
echo "podman.sh: all passed"
