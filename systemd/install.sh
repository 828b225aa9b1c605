#!/bin/sh
# Installs the application and its service from a wheel, or upgrades them. Enables and starts nothing.
set -eu
umask 022

usage() {
    cat <<'TEXT'
usage: install.sh [--vehicle ardupilot|px4] [--python PY] [--root DIR] WHEEL

  --vehicle   the autopilot of the example configuration (default: ardupilot)
  --python    the interpreter of the application, 3.11 or newer, outside the home folders (default: python3)
  --root      install below DIR, for an image; nothing of the running system is touched
TEXT
}

fail() {
    echo "install.sh: $*" >&2
    exit 1
}

misused() {
    echo "install.sh: $*" >&2
    usage >&2
    exit 2
}

vehicle=ardupilot
python=python3
root=
wheel=
while [ $# -gt 0 ]; do
    case $1 in
    --vehicle | --python | --root)
        # an empty value is a variable somebody forgot to set: with --root it would mean the running system
        [ -n "${2:-}" ] || misused "$1 needs a value"
        case $1 in
        --vehicle) vehicle=$2 ;;
        --python) python=$2 ;;
        --root)
            root=$(realpath -m -- "$2")
            [ "$root" != / ] || misused "--root / would write into the running system: leave it out"
            ;;
        esac
        shift 2
        ;;
    -h | --help)
        usage
        exit 0
        ;;
    -*) misused "no option $1" ;;
    *)
        [ -z "$wheel" ] || misused "one wheel, not $wheel and $1"
        wheel=$1
        shift
        ;;
    esac
done
case $vehicle in
ardupilot | px4) ;;
*) misused "--vehicle is ardupilot or px4, not $vehicle" ;;
esac
[ -n "$wheel" ] || misused "the wheel is missing"
[ -f "$wheel" ] || fail "$wheel is not there: build it with 'pip wheel --no-deps .'"

here=$(CDPATH='' cd -- "$(dirname -- "$0")" && pwd)
if [ -z "$root" ]; then
    [ "$(id -u)" -eq 0 ] || fail "needs root: run it with sudo"
    if systemctl is-active --quiet mscf-companion.service; then
        fail "mscf-companion is running: land, then 'systemctl stop mscf-companion', then install"
    fi
fi

home=/opt/mscf-companion
config=/etc/mscf-companion/config.toml

# The new environment grows beside the old one, which stays as it is until nothing can fail any more.
new=$root$home/venv.new
rm -rf "$new"
mkdir -p "$root$home"
trap 'rm -rf "$new"' EXIT
"$python" -m venv "$new"
constraints=$here/../constraints.txt
if [ -f "$constraints" ]; then # the versions that the project was tested with
    set -- --constraint "$constraints"
else
    set --
fi
# with what encodes the video of the flight record
"$new/bin/python" -m pip install --quiet --disable-pip-version-check "$@" "$wheel[recording]"
# what pip and venv wrote names the folder it was built in, not the one it will run from
grep -rlIF -- "$new" "$new/bin" "$new/pyvenv.cfg" | while IFS= read -r file; do
    [ -L "$file" ] || sed -i "s|$new|$home/venv|g" "$file"
done
"$new/bin/python" "$new/bin/mscf-companion" example "$vehicle" >"$new/config.toml.example" ||
    fail "this wheel has no example for $vehicle"

rm -rf "$root$home/venv.old"
[ ! -e "$root$home/venv" ] || mv "$root$home/venv" "$root$home/venv.old"
mv "$new" "$root$home/venv"
rm -rf "$root$home/venv.old"

put() { # FILE DESTINATION
    mkdir -p "$root$(dirname -- "$2")"
    install -m 0644 "$1" "$root$2"
}
put "$here/mscf-companion.service" /etc/systemd/system/mscf-companion.service
put "$here/mscf-companion.sysusers" /etc/sysusers.d/mscf-companion.conf
put "$here/70-mscf-companion.rules" /etc/udev/rules.d/70-mscf-companion.rules
put "$root$home/venv/config.toml.example" $config.example
rm "$root$home/venv/config.toml.example"

if [ -z "$root" ]; then
    systemd-sysusers /etc/sysusers.d/mscf-companion.conf
fi
if [ -e "$root$config" ] || [ -L "$root$config" ]; then
    echo "kept $root$config; the example of this version is beside it"
else
    install -m 0640 "$root$config.example" "$root$config"
    [ -n "$root" ] || chgrp mscf-companion $config
fi

if [ -n "$root" ]; then
    cat <<TEXT
installed below $root. On the image, before the first start:
  systemd-sysusers && chgrp mscf-companion $config
TEXT
else
    systemctl daemon-reload
    udevadm control --reload
    udevadm trigger --subsystem-match=video4linux --subsystem-match=tty
fi
cat <<TEXT
next:
  sudoedit $config
  sudo $home/venv/bin/mscf-companion check -c $config
  sudo systemctl enable --now mscf-companion
TEXT
