#!/bin/bash
# Installs a Debian package of `make dist` in a root that systemd boots, and runs the service as docs/releases.md says: enabled and started, tokens, state of its own,
# a reload, a restart, the end, removal.
#
#   tests/scripts/service.sh PACKAGE [SUITE]     SUITE is bookworm by default
#
# Needs root and systemd-nspawn (Debian's systemd-container). The root is that of tests/scripts/fresh-debian.sh, and stays as it is: what is written is in memory.
case ${1:-} in -h | --help) sed -n '2,/^[^#]/{/^#/s/^# \{0,1\}//p}' "$0" && exit ;; esac
set -euo pipefail

[ $# -ge 1 ] || { echo "service.sh: expected a package, found none" >&2 && exit 2; }
package=$(realpath "$1") suite=${2:-bookworm}
cd "$(dirname "$0")/../.."
[ "$(id -u)" -eq 0 ] || { echo "service.sh: needs root" >&2 && exit 1; }
tests/scripts/fresh-debian.sh run "$suite" systemd,systemd-sysv,dbus,ocl-icd-libopencl1,pocl-opencl-icd,curl true
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cp "$package" "$work/isopeel.deb"
echo "not run" >"$work/result"

cat >"$work/test.sh" <<'SCRIPT'
#!/bin/bash
set -euo pipefail
exec >/test/log 2>&1
trap 'echo "line $LINENO failed" >>/test/log; systemctl --no-pager status isopeel >>/test/log; journalctl --no-pager -u isopeel >>/test/log' ERR
url=http://127.0.0.1:8417
ready() {
    for _ in $(seq 1200); do
        [ "$(curl --silent --output /dev/null --write-out '%{http_code}' "$url/readyz")" = 200 ] && return
        sleep 0.1
    done
    false
}
# systemd-run asks by it.
systemctl start dbus
dpkg --install /test/isopeel.deb
# The installation does not start it.
[ "$(systemctl is-active isopeel || true)" = inactive ]
systemctl enable --now isopeel
ready
# One that systemd has made.
user=$(stat --format %u "/proc/$(systemctl show --property MainPID --value isopeel)")
[ "$user" -ge 61184 ] && [ "$user" -le 65519 ]
[ "$(stat --format %a /var/lib/private/isopeel)" = 700 ]
# As /etc/isopeel/isopeel.toml says it.
command=$(sed -n '/sudo systemd-run/,/[^\\]$/s/^#  *//p' /etc/isopeel/isopeel.toml | sed 's/^sudo //; s/\\$//' | tr '\n' ' ')
token=$(eval "$command" | tail -n 1)
answers() { curl --silent --fail --output /dev/null --retry 8 --retry-delay 1 --retry-all-errors --header "Authorization: Bearer $token" "$url/api/v1/volumes"; }
answers
systemctl reload isopeel
answers
# The process of the device confines itself as far as the kernel can, and is replaced when it ends.
journalctl --no-pager -u isopeel >/test/journal
grep --max-count 1 --only-matching 'the process of the device is .*confined.*' /test/journal
device_process() {
    for process in /proc/[0-9]*; do
        if tr '\0' ' ' <"$process/cmdline" 2>/dev/null | grep --quiet '^isopeel worker '; then echo "${process#/proc/}"; fi
    done
}
first=$(device_process)
[ "$(wc -w <<<"$first")" = 1 ]
kill -9 "$first"
ready
second=$(device_process)
[ -n "$second" ] && [ "$second" != "$first" ]
echo "process $first of the device was killed, replaced by $second"
start=$EPOCHREALTIME
systemctl restart isopeel
ready
echo "$start $EPOCHREALTIME" | awk '{ printf "restart to /readyz: %.1f s\n", $2 - $1 }'
answers
start=$EPOCHREALTIME
systemctl stop isopeel
echo "$start $EPOCHREALTIME" | awk '{ printf "stop: %.1f s\n", $2 - $1 }'
[ "$(systemctl show --property Result --value isopeel)" = success ]
systemd-analyze security --no-pager isopeel | tail -n 1
dpkg --purge isopeel
[ ! -e /usr/bin/isopeel ] && [ -e /var/lib/private/isopeel/state ]
echo passed >/test/result
SCRIPT
chmod 755 "$work" "$work/test.sh"
# Uses the older hierarchy of control groups if this machine has no unified one.
[ -e /sys/fs/cgroup/cgroup.controllers ] || export SYSTEMD_NSPAWN_UNIFIED_HIERARCHY=0
timeout --kill-after=10 600 systemd-nspawn --quiet --register=no --keep-unit --private-network --volatile=overlay --directory="target/roots/$suite-with" \
    --bind="$work:/test" --boot systemd.run=/test/test.sh systemd.run_success_action=exit systemd.run_failure_action=exit </dev/null >"$work/boot" 2>&1 || true
[ "$(cat "$work/result")" = passed ] || { tail -n 20 "$work/boot" >&2 && cat "$work/log" >&2 && echo "service.sh: failed on $suite" >&2 && exit 1; }
grep 'restart to\|stop:\|exposure\|process of the device\|of the device was killed' "$work/log"
echo "service.sh: the service runs on $suite"
