#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-3.0-or-later
# Installs the packages of /packages after everything else that they depend on, and notes which
# files there were before.
set -euo pipefail
export DEBIAN_FRONTEND=noninteractive
apt-get update -q
# What the steps and debian/tests/control ask for.
apt-get install -q -y --no-install-recommends xvfb xauth x11-utils cmake g++ make >/dev/null
for package in /packages/*.deb; do
    case $package in
    *-dbgsym_*) rm "$package" ;;
    *) dpkg-deb --field "$package" Depends | tr ',' '\n' | sed 's/^ *//; /wiforce/d; /^$/d' ;;
    esac
done | sort --unique | paste --serial --delimiters=, >/packages/others
apt-get satisfy -q -y --no-install-recommends "$(cat /packages/others)"
find / -xdev \( -path /packages -o -path /proc -o -path /sys -o -path /home -o -path /tmp \) \
    -prune -o -print | sort >/packages/before
apt-get install -q -y --no-install-recommends /packages/*.deb
chmod -R a+rX /packages
