#!/bin/bash
# Builds and runs the image isopeel:cpu by docker/compose.yaml with a real engine: state is kept, any user may run it, no request breaks at the end, TLS is as
# docker/README.md says.
#
#   tests/scripts/compose.sh
#
# BASE_IMAGE replaces the Dockerfile's base image, and the binary is then that of `make dist`; so it needs neither a registry of images nor a compiler:
#
#   tests/scripts/base-images.sh debian && podman push localhost/isopeel-debian docker-daemon:isopeel-debian:latest
#   BASE_IMAGE=isopeel-debian tests/scripts/compose.sh
#
# Needs Docker with Compose 2, curl, jq and openssl. COMPOSE is the command, "docker compose" by default. An engine without a bridge gives its
# containers the host's network. Removes the containers and volumes of its own project at the end, and no others.
case ${1:-} in -h | --help) sed -n '2,/^[^#]/{/^#/s/^# \{0,1\}//p}' "$0" && exit ;; esac
set -euo pipefail

cd "$(dirname "$0")/../.."
read -ra compose <<<"${COMPOSE:-docker compose}"
export ISOPEEL_PORT=${ISOPEEL_PORT:-18490}
unset ISOPEEL_DRAIN ISOPEEL_DATA ISOPEEL_USER ISOPEEL_ADDRESS ISOPEEL_PUBLIC_URL ISOPEEL_CERTIFICATE ISOPEEL_KEY ISOPEEL_TOKEN
work=$(mktemp -d)
chmod 755 "$work"
files=(-f docker/compose.yaml)
project="isopeel-test-$$"

fail() {
    printf 'compose.sh: %s\n' "$*" >&2
    run logs --no-color >&2 || true
    exit 1
}
run() { "${compose[@]}" --project-name "$project" --env-file /dev/null "${files[@]}" "$@"; }
trap 'run down --volumes --timeout 5 >/dev/null 2>&1; rm -rf "$work"' EXIT

# Each service listens on a port of its own, so that the host's network serves as well.
{
    echo "services:"
    echo "  cpu:"
    echo "    command: serve --listen 0.0.0.0:$ISOPEEL_PORT"
    echo "    environment: {HEALTH_PORT: '$ISOPEEL_PORT'}"
    build=
    [ -z "${BASE_IMAGE:-}" ] || build="    build: {network: host, args: {BASE_IMAGE: '$BASE_IMAGE', BINARY: packed}}"
    echo "$build"
    if docker network inspect bridge >/dev/null 2>&1; then
        echo "    ports: !override ['127.0.0.1:$ISOPEEL_PORT:$ISOPEEL_PORT']"
    else
        echo "    network_mode: host"
        echo "    ports: !reset []"
    fi
    # As on a machine without a GPU, whose engine would refuse it.
    echo "  gpu:"
    echo "    deploy: !reset null"
    echo "    restart: !reset null"
    echo "$build"
} >"$work/test.yaml"

# answer WANTED CURL_ARGUMENT ...
answer() {
    local wanted=$1 found
    shift
    found=$(curl --silent --output "$work/answer" --write-out '%{http_code}' "$@") || true
    [ "$found" = "$wanted" ] || fail "curl $*: $found, expected $wanted: $(head -c 300 "$work/answer")"
}
# Seconds until the server is ready.
ready() {
    local start=$EPOCHREALTIME
    for _ in $(seq 1200); do
        if [ "$(curl --silent --output /dev/null --write-out '%{http_code}' "$@")" = 200 ]; then
            echo "$start $EPOCHREALTIME" | awk '{ printf "%.1f", $2 - $1 }'
            return
        fi
        sleep 0.1
    done
    fail "not ready within two minutes: curl $*"
}
healthy() {
    for _ in $(seq 600); do
        [ "$(docker inspect --format '{{.State.Health.Status}}' "$(run ps --quiet cpu)")" = healthy ] && return
        sleep 0.1
    done
    fail "not healthy within a minute"
}
# Number of the process of the device, in the container.
device_process() { run exec --no-TTY cpu sh -c 'for p in /proc/[0-9]*; do tr "\0" " " <"$p/cmdline" 2>/dev/null | grep --quiet "^isopeel worker " && echo "${p#/proc/}"; done; true'; }
new_token() { run exec --no-TTY cpu isopeel token create --user ann --role view --role export --role upload 2>"$work/errors" || fail "no token: $(cat "$work/errors")"; }

url=http://127.0.0.1:$ISOPEEL_PORT
files+=(-f "$work/test.yaml")
echo "=== what is only read"
# All that .env.example suggests, for the processor and for a GPU.
sed -n 's/^#\(ISOPEEL_\)/\1/p' docker/.env.example >"$work/env"
read_all() { "${compose[@]}" --env-file "$work/env" -f docker/compose.yaml -f docker/compose.tls.yaml --profile gpu config; }
env -u ISOPEEL_PORT bash -c "$(declare -f read_all); $(declare -p compose work); read_all" >"$work/answer" 2>&1 || fail "cannot be read: $(cat "$work/answer")"
while IFS== read -r variable value; do
    grep --quiet --fixed-strings -e "$value" "$work/answer" || fail "$variable of .env.example changes nothing"
done <"$work/env"
grep --quiet 'driver: nvidia' "$work/answer" || fail "the service gpu asks for no GPU"
echo "$(wc -l <"$work/env") variables of .env.example, and the service gpu"

echo "=== build"
run build --quiet cpu >"$work/answer" 2>&1 || fail "does not build: $(cat "$work/answer")"
# As to a machine without a registry.
docker save isopeel:cpu >"$work/image.tar" && docker load --quiet <"$work/image.tar" >/dev/null && rm "$work/image.tar"
docker image inspect isopeel:cpu >"$work/image"
echo "base image $(jq --raw-output '.[0].Config.Labels."org.opencontainers.image.base.name"' "$work/image"), $(jq '.[0].Size / 1e6 | round' "$work/image") MB"
layers() { docker image inspect "$1" | jq --raw-output '.[0].RootFS.Layers[]'; }
if [ -n "${BASE_IMAGE:-}" ]; then
    # As a change of the source would: another binary.
    binary=target/dist-binaries/$(dpkg --print-architecture)/isopeel
    cp "$binary" "$work/isopeel"
    docker tag isopeel:cpu "$project"
    echo >>"$binary"
    run build --quiet cpu >"$work/answer" 2>&1 || fail "does not build: $(cat "$work/answer")"
    cp "$work/isopeel" "$binary"
    anew=$(comm -13 <(layers "$project" | sort) <(layers isopeel:cpu | sort) | wc -l)
    echo "after a change of the binary: $anew layer anew, $(docker history --human=false --format '{{.Size}} {{.CreatedBy}}' isopeel:cpu | awk '/bin.isopeel/ { printf "%.0f", $1 / 1e6 }') MB"
    [ "$anew" = 1 ] || fail "$anew layers were made anew, expected 1"
    docker tag "$project" isopeel:cpu && docker rmi "$project" >/dev/null
fi
for label in title description licenses version base.name; do
    jq --exit-status ".[0].Config.Labels.\"org.opencontainers.image.$label\" // \"\" | length > 0" "$work/image" >/dev/null || fail "no label $label"
done

echo "=== as it is shipped"
run up --detach --quiet-pull cpu 2>/dev/null || fail "does not start"
echo "ready after $(ready "$url/readyz") s without compiled kernels"
token=$(new_token)
sleep 6
user=(--header "Authorization: Bearer $token")
answer 200 "${user[@]}" "$url/api/v1/volumes"
answer 421 --header 'Host: volumes.example' "${user[@]}" "$url/api/v1/volumes"
answer 200 --header 'Host: volumes.example' "$url/readyz"
answer 201 "${user[@]}" --json '{"files": [{"name": "a.nrrd", "bytes": 4}]}' "$url/api/v1/uploads"
upload=$(jq --raw-output .id "$work/answer")
answer 201 "${user[@]}" --json '{"volume": "mni152", "extractions": [{"iso": 90, "triangles": 5000, "format": "stl"}]}' "$url/api/v1/jobs"
job=$(jq --raw-output .id "$work/answer")
for _ in $(seq 600); do
    answer 200 "${user[@]}" "$url/api/v1/jobs/$job"
    [ "$(jq --raw-output .state "$work/answer")" = done ] && break
    sleep 0.2
done
[ "$(jq --raw-output .state "$work/answer")" = done ] || fail "the job is not done: $(cat "$work/answer")"
healthy
[ "$(run exec --no-TTY cpu id -u)" = 10001 ] || fail "another user than 10001"
run logs --no-color >"$work/log" 2>&1
grep --max-count 1 --only-matching 'the process of the device is .*confined.*' "$work/log" || fail "the log does not say whether the process of the device is confined"

echo "=== the process of the device ends"
first=$(device_process)
[ "$(wc -w <<<"$first")" = 1 ] || fail "the processes of one device are '$first'"
run exec --no-TTY cpu sh -c "kill -9 $first"
start=$EPOCHREALTIME
answer 200 "${user[@]}" --json '{"volume": "mni152", "iso": 95, "triangles": 5000, "format": "stl"}' "$url/api/v1/extract"
echo "a surface $(echo "$start $EPOCHREALTIME" | awk '{ printf "%.1f", $2 - $1 }') s later"
second=$(device_process)
[ -n "$second" ] && [ "$second" != "$first" ] || fail "the process $first was killed, and now there is '$second'"
# The server waits for builders of kernels at the end of the check, which goes on.
[ "$(run exec --no-TTY cpu sh -c 'cat /proc/[0-9]*/stat' | awk -v killed="$first" '$3 == "Z" && ($4 == 1 || $1 == killed)' | wc -l)" = 0 ] || fail "a zombie is left"

echo "=== after a restart"
run restart cpu 2>/dev/null
echo "ready after $(ready "$url/readyz") s"
answer 200 "${user[@]}" "$url/api/v1/volumes"
answer 200 "${user[@]}" "$url/api/v1/jobs/$job/results/0"
answer 200 "${user[@]}" "$url/api/v1/uploads/$upload"
run stop 2>/dev/null
# More than the container may have, and less than most machines have. Almost all of the file is a hole.
printf 'NRRD0004\ntype: uint8\ndimension: 3\nsizes: 1600 1600 1600\nencoding: raw\n\n' >"$work/large.nrrd"
truncate --size +4096000000 "$work/large.nrrd"
if docker run --rm --memory 2g --volume "${project}_state:/var/lib/isopeel" --volume "$work/large.nrrd:/large.nrrd:ro" isopeel:cpu \
    extract /large.nrrd --iso 90 --stats >"$work/answer" 2>&1 || ! grep --quiet "of this machine's memory, the limit is" "$work/answer"; then
    fail "a volume of 4 GB in a container of 2 GiB: $(cat "$work/answer")"
fi
[ "$(docker inspect --format '{{.State.ExitCode}}' "$(run ps --all --quiet cpu)")" = 0 ] || fail "SIGTERM did not end it with success"
run down --volumes 2>/dev/null

echo "=== the GPU image, without a GPU"
if run --profile gpu up --build --exit-code-from gpu gpu >"$work/answer" 2>&1 || ! grep --quiet 'the OpenCL loader found no driver\|the OpenCL drivers offer no device' "$work/answer"; then
    fail "does not say that there is no device: $(cat "$work/answer")"
fi
echo "$(docker image inspect isopeel | jq '.[0].Size / 1e6 | round') MB"
run --profile gpu down --volumes 2>/dev/null

echo "=== the end under load"
# Four clients that ask as a balancer does: for what is ready only.
client() {
    while [ "$(curl --silent --output /dev/null --write-out '%{http_code}' "$url/readyz")" = 200 ]; do
        curl --silent --output /dev/null --write-out '%{http_code}\n' "${user[@]}" \
            --json "{\"volume\": \"mni152\", \"iso\": $((80 + RANDOM % 40)), \"triangles\": 20000, \"format\": \"stl\"}" "$url/api/v1/extract" || echo broken
    done
}
ISOPEEL_DRAIN=8 run up --detach cpu 2>/dev/null || fail "does not start"
ready "$url/readyz" >/dev/null
token=$(new_token)
user=(--header "Authorization: Bearer $token")
sleep 6
# Compiles the kernels that are not compiled yet.
answer 200 "${user[@]}" --json '{"volume": "mni152", "iso": 90, "triangles": 20000, "format": "stl"}' "$url/api/v1/extract"
clients=()
for n in 1 2 3 4; do
    client >"$work/client-$n" &
    clients+=($!)
done
sleep 4
before=$(cat "$work"/client-? | wc -l)
start=$EPOCHREALTIME
# As without Compose.
docker stop --time 25 "$(run ps --quiet cpu)" >/dev/null
seconds=$(echo "$start $EPOCHREALTIME" | awk '{ printf "%.1f", $2 - $1 }')
wait "${clients[@]}"
all=$(cat "$work"/client-? | wc -l) broken=$(cat "$work"/client-? | grep --count --invert-match '^200$' || true)
echo "ended after $seconds s, $((all - before)) of $all requests after SIGTERM, $broken broken"
[ "$broken" = 0 ] || fail "requests broke: $(cat "$work"/client-? | sort | uniq -c)"
[ "$all" -gt "$before" ] || fail "nothing was asked for after SIGTERM"
awk "BEGIN { exit !($seconds <= 10) }" || fail "took longer than 10 s"
run down --volumes 2>/dev/null

echo "=== as any user, with volumes of a folder"
mkdir "$work/scans"
awk 'BEGIN { printf "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 8 8 8\nencoding: ascii\n\n"; for (i = 0; i < 512; i++) print i % 200 }' >"$work/scans/ramp.nrrd"
export ISOPEEL_DATA=$work/scans
sed -i "s|command: .*|command: serve --listen 0.0.0.0:$ISOPEEL_PORT /data|" "$work/test.yaml"
ISOPEEL_USER=1234567 run up --detach cpu 2>/dev/null || fail "does not start as another user"
echo "ready after $(ready "$url/readyz") s"
token=$(ISOPEEL_USER=1234567 new_token)
[ -n "$token" ] || fail "no token as another user"
sleep 6
answer 200 --header "Authorization: Bearer $token" "$url/api/v1/volumes/data"
ISOPEEL_USER=1234567 run exec --no-TTY cpu sh -c 'test "$(id -u)" = 1234567 && ls kernels/pocl >/dev/null && test "$(stat -c %a state)" = 700' ||
    fail "kernels and state are not kept by another user"
run down --volumes 2>/dev/null
unset ISOPEEL_DATA
sed -i 's| /data$||' "$work/test.yaml"

echo "=== with TLS"
if "${compose[@]}" -f docker/compose.yaml -f docker/compose.tls.yaml config >"$work/answer" 2>&1 || ! grep --quiet "required variable ISOPEEL_.* is missing a value: set it to" "$work/answer"; then
    fail "what is missing for TLS is not named: $(cat "$work/answer")"
fi
new_certificate() { openssl req -x509 -newkey rsa:2048 -nodes -days 2 -subj /CN=localhost -addext subjectAltName=DNS:localhost,DNS:volumes.test -keyout "$1" -out "$2" 2>/dev/null; }
new_certificate "$work/key.pem" "$work/certificate.pem"
openssl rand -hex 32 >"$work/token"
chmod 600 "$work/key.pem" "$work/token"
export ISOPEEL_USER=1234567
chown "$ISOPEEL_USER" "$work/key.pem" "$work/token"
export ISOPEEL_CERTIFICATE=$work/certificate.pem ISOPEEL_KEY=$work/key.pem ISOPEEL_TOKEN=$work/token
export ISOPEEL_PUBLIC_URL=https://volumes.test:$ISOPEEL_PORT,https://localhost:$ISOPEEL_PORT
sed -i "s/HEALTH_PORT: .*/HEALTH_PORT: '9417'}/" "$work/test.yaml"
files=(-f docker/compose.yaml -f docker/compose.tls.yaml -f "$work/test.yaml")
run up --detach cpu 2>/dev/null || fail "does not start with TLS"
tls=(--cacert "$work/certificate.pem" --resolve "volumes.test:$ISOPEEL_PORT:127.0.0.1")
echo "ready after $(ready "${tls[@]}" "https://localhost:$ISOPEEL_PORT/readyz") s"
answer 200 "${tls[@]}" --header "Authorization: Bearer $(cat "$work/token")" "https://volumes.test:$ISOPEEL_PORT/api/v1/volumes"
answer 401 "${tls[@]}" "https://localhost:$ISOPEEL_PORT/api/v1/volumes"
healthy
# A certificate that was renewed, in the files that the container has.
new_certificate "$work/key.new" "$work/certificate.new"
cat "$work/key.new" >"$work/key.pem"
cat "$work/certificate.new" >"$work/certificate.pem"
run kill --signal HUP cpu 2>/dev/null
for _ in $(seq 50); do
    curl --silent --output /dev/null "${tls[@]}" "https://localhost:$ISOPEEL_PORT/healthz" && break
    sleep 0.1
done
answer 200 "${tls[@]}" "https://localhost:$ISOPEEL_PORT/healthz"
# One that has another file.
new_certificate "$work/key.new" "$work/certificate.new"
chown "$ISOPEEL_USER" "$work/key.new"
mv "$work/key.new" "$work/key.pem"
mv "$work/certificate.new" "$work/certificate.pem"
run up --force-recreate --detach cpu 2>/dev/null || fail "does not start with another certificate"
echo "ready after $(ready "${tls[@]}" "https://localhost:$ISOPEEL_PORT/readyz") s with another certificate"
echo "compose.sh: all passed"
