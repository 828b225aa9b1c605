#!/bin/sh
# Removes what install.sh wrote. The configuration, the state and the recordings stay, unless --purge.
set -eu

usage() {
    cat <<'TEXT'
usage: uninstall.sh [--purge] [--root DIR]

  --purge   also remove configuration, state, recordings and the account
  --root    uninstall below DIR; nothing of the running system is touched
TEXT
}

misused() {
    echo "uninstall.sh: $*" >&2
    usage >&2
    exit 2
}

root=
purge=no
while [ $# -gt 0 ]; do
    case $1 in
    --purge)
        purge=yes
        shift
        ;;
    --root)
        # an empty value is a variable somebody forgot to set: it would mean the running system
        [ -n "${2:-}" ] || misused "$1 needs a value"
        root=$(realpath -m -- "$2")
        [ "$root" != / ] || misused "--root / would remove from the running system: leave it out"
        shift 2
        ;;
    -h | --help)
        usage
        exit 0
        ;;
    *) misused "no option $1" ;;
    esac
done

if [ -z "$root" ]; then
    if [ "$(id -u)" -ne 0 ]; then
        echo "uninstall.sh: needs root: run it with sudo" >&2
        exit 1
    fi
    if systemctl is-active --quiet mscf-companion.service; then
        echo "uninstall.sh: mscf-companion is running: land, then 'systemctl stop mscf-companion', then uninstall" >&2
        exit 1
    fi
    if [ -e /etc/systemd/system/mscf-companion.service ]; then
        systemctl disable --quiet mscf-companion.service
    fi
fi

rm -rf "$root/opt/mscf-companion"
rm -f "$root/etc/systemd/system/mscf-companion.service" "$root/etc/sysusers.d/mscf-companion.conf" \
    "$root/etc/udev/rules.d/70-mscf-companion.rules" "$root/etc/mscf-companion/config.toml.example"
if [ $purge = yes ]; then
    rm -rf "$root/etc/mscf-companion" "$root/var/lib/mscf-companion" "$root/var/log/mscf-companion"
fi

if [ -z "$root" ]; then
    systemctl daemon-reload
    udevadm control --reload
    if [ $purge = yes ] && getent passwd mscf-companion >/dev/null; then
        userdel mscf-companion
    fi
fi
if [ $purge = no ]; then
    echo "kept, where they are: /etc/mscf-companion, /var/lib/mscf-companion, /var/log/mscf-companion, the account" \
        "(uninstall.sh --purge removes them)"
fi
