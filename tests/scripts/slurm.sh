#!/bin/bash
# Runs the scripts for Slurm in docker/ as Slurm would run them, with its variables and without Slurm.
#
#   tests/scripts/slurm.sh BINARY
case ${1:-} in -h | --help) sed -n '2,/^[^#]/{/^#/s/^# \{0,1\}//p}' "$0" && exit ;; esac
set -euo pipefail

[ $# -eq 1 ] || { echo "slurm.sh: expected the binary, found: $*" >&2 && exit 2; }
binary=$(realpath "$1")
cd "$(dirname "$0")/../.."
repository=$PWD work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"

fail() {
    printf 'slurm.sh: %s\n' "$*" >&2
    exit 1
}

## Ten volumes by an array of three tasks

for n in $(seq 0 9); do
    {
        printf 'NRRD0004\ntype: uint8\ndimension: 3\nsizes: 8 8 8\nencoding: ascii\n\n'
        awk -v n="$n" 'BEGIN { for (i = 0; i < 512; i++) { x = i % 8; y = int(i / 8) % 8; z = int(i / 64); print ((x - 3.5) ^ 2 + (y - 3.5) ^ 2 + (z - 3.5) ^ 2 < 8 ? 200 + n : 10) } }'
    } >"head $n.nrrd"
done
printf '%s\n' head\ ?.nrrd >list
for task in 0 1 2; do
    SLURM_ARRAY_TASK_ID=$task SLURM_ARRAY_TASK_MIN=0 SLURM_ARRAY_TASK_MAX=2 SLURM_ARRAY_TASK_COUNT=3 ISOPEEL=$binary \
        bash "$repository/docker/isopeel-batch.slurm" list surfaces --iso 100 --format stl 2>>log || fail "task $task: $(cat log)"
done
count=$(find surfaces -name '*.stl' | wc -l)
[ "$count" = 10 ] || fail "$count surfaces of ten volumes: $(find surfaces)"
[ "$(cat surfaces/*/manifest.jsonl | wc -l)" = 10 ] || fail "$(cat surfaces/*/manifest.jsonl)"
[ "$(find surfaces/0 -name '*.stl' | wc -l)" = 4 ] || fail "task 0 has four of ten: $(find surfaces/0)"

# What the pages say of failures: they are listed, the task ends with 1, and others are made.
mkdir "one is broken"
cd "one is broken"
cp "../head 0.nrrd" good.nrrd
echo nothing >broken.nrrd
printf '%s\n' good.nrrd broken.nrrd >list
code=0
SLURM_ARRAY_TASK_ID=0 SLURM_ARRAY_TASK_MIN=0 SLURM_ARRAY_TASK_MAX=0 SLURM_ARRAY_TASK_COUNT=1 ISOPEEL=$binary \
    bash "$repository/docker/isopeel-batch.slurm" list surfaces --iso 100 --format stl 2>log || code=$?
[ "$code" = 1 ] || fail "a task with a file that cannot be read ended with $code: $(cat log)"
grep -h '"problem"' surfaces/*/manifest.jsonl >failures
[ "$(wc -l <failures)" = 1 ] && grep --quiet broken.nrrd failures || fail "failures: $(cat failures)"
[ "$(find surfaces -name '*.stl' | wc -l)" = 1 ] || fail "the other file has no surface: $(find surfaces)"
cd ..

# Of an array with gaps, the third of three tasks.
SLURM_ARRAY_TASK_ID=4 SLURM_ARRAY_TASK_MIN=0 SLURM_ARRAY_TASK_MAX=4 SLURM_ARRAY_TASK_COUNT=3 ISOPEEL=echo \
    bash "$repository/docker/isopeel-batch.slurm" list again --iso 100 >called
grep --quiet 'batch -o again/2 --iso 100 -- head 2.nrrd head 5.nrrd head 8.nrrd' called || fail "$(cat called)"

## A server, with an output of another name

(umask 022 && : >elsewhere)
SLURM_JOB_ID=7 ISOPEEL=echo bash "$repository/docker/isopeel.slurm" a.nrrd >elsewhere 2>&1 || fail "$(cat elsewhere)"
grep --quiet 'serve --listen 127.0.0.1:20007 a.nrrd' elsewhere || fail "$(cat elsewhere)"
[ "$(stat --format %a elsewhere)" = 600 ] || fail "the output may be read by others: $(stat --format %a elsewhere)"
# Not a file: nothing to protect.
SLURM_JOB_ID=7 ISOPEEL=echo bash "$repository/docker/isopeel.slurm" a.nrrd | grep 20007 >pipe || fail "it does not write to a pipe"
echo "slurm.sh: ten surfaces by three tasks, and a server with another --output"
