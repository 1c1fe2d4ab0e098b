#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-3.0-or-later
# Purges the packages; then there must be the files from before, and no others.
set -euo pipefail
export DEBIAN_FRONTEND=noninteractive
mapfile -t packages < <(dpkg-query -W -f '${Package}\n' '*wiforce*')
test "${#packages[@]}" -ge 4
apt-get purge -q -y "${packages[@]}"
find / -xdev \( -path /packages -o -path /proc -o -path /sys -o -path /home -o -path /tmp \) \
    -prune -o -print | sort >/packages/after
# apt, dpkg and the package that has the index of manual pages keep logs and copies of their own.
home=~root
own="^/var/(log|cache|lib/(apt|dpkg|systemd/deb-systemd|ucf))/|^/etc/ld.so.cache|^/step.sh|^$home/"
if diff <(grep -Ev "$own" /packages/before) <(grep -Ev "$own" /packages/after); then
    echo "nothing is left behind"
else
    echo "files that were left behind or removed are listed above" >&2
    exit 1
fi
! find / -xdev \( -path /packages -o -path /proc -o -path /sys -o -path /home \) -prune -o \
    -path '*wiforce*' -print | grep -Ev '^/var/log/|^/var/cache/apt/' ||
    { echo "these were left behind" >&2; exit 1; }
