# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs a command in namespaces in which the kernel hands programs of 64-bit ARM to QEMU.

Since Linux 6.7 a user namespace has registrations of its own: nothing is registered for the
machine, and nothing remains when the command ends.

usage: python3 foreign_system.py QEMU COMMAND...
"""

import ctypes
import os
import subprocess
import sys
from pathlib import Path

_NEWNS, _NEWUSER, _NEWPID = 0x00020000, 0x10000000, 0x20000000  # <linux/sched.h>
_REGISTRATIONS = Path("/proc/sys/fs/binfmt_misc")
# An ELF file of 64-bit little-endian ARM, program or library (QEMU, qemu-binfmt-conf.sh). F opens
# QEMU now, so that a changed root need not contain it.
_MAGIC = rb"\x7fELF\x02\x01\x01\x00\x00\x00\x00\x00\x00\x00\x00\x00\x02\x00\xb7\x00"
_MASK = rb"\xff\xff\xff\xff\xff\xff\xff\x00\xff\xff\xff\xff\xff\xff\xff\xff\xfe\xff\xff\xff"
_USERS = 65536


def enter_command(qemu: str) -> list[str]:
    """What precedes a command that is to run there."""
    return [sys.executable, str(Path(__file__).resolve()), qemu]


def why_not(qemu: str) -> str | None:
    """Why this machine cannot run a foreign system; None when it can."""
    if os.geteuid() != 0:
        return "needs root"
    tried = subprocess.run([*enter_command(qemu), "true"], capture_output=True, text=True)
    if tried.returncode == 0:
        return None
    reason = (tried.stderr.strip().splitlines() or ["unknown"])[-1]
    return f"the kernel does not run foreign programs in a namespace (Linux 6.7 or later): {reason}"


def _unshare(flags: int) -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.unshare(flags):
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number), "unshare")


def _mount(kind: str, target: Path) -> None:
    subprocess.run(["mount", "-t", kind, kind, target], check=True)


def _prepare(qemu: str) -> None:
    """In the new namespaces: a registration, and their own processes."""
    _mount("proc", Path("/proc"))
    _mount("binfmt_misc", _REGISTRATIONS)
    line = b":wiforce-aarch64:M::" + _MAGIC + b":" + _MASK + b":" + os.fsencode(qemu) + b":OCF"
    (_REGISTRATIONS / "register").write_bytes(line)


def _run(qemu: str, command: list[str]) -> int:
    """The parent maps the users of the child's namespace, which only it may do."""
    is_apart, is_mapped = os.pipe(), os.pipe()
    child = os.fork()
    if child == 0:
        status = 1
        try:
            _unshare(_NEWUSER | _NEWNS | _NEWPID)
            os.write(is_apart[1], b".")
            os.close(is_mapped[1])
            if os.read(is_mapped[0], 1):
                os.setgid(0)
                os.setuid(0)
                status = _first_process(qemu, command)
        except (OSError, subprocess.CalledProcessError) as error:
            print(error, file=sys.stderr, flush=True)
        os._exit(status)
    os.close(is_apart[1])
    if os.read(is_apart[0], 1):
        for name in ("uid_map", "gid_map"):
            Path(f"/proc/{child}/{name}").write_text(f"0 0 {_USERS}\n")
        os.write(is_mapped[1], b".")
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def _first_process(qemu: str, command: list[str]) -> int:
    """Runs the command as the first process of the namespace: with it, all others end."""
    child = os.fork()
    if child == 0:
        status = 1
        try:
            _prepare(qemu)
            status = subprocess.run(command).returncode
        except (OSError, subprocess.CalledProcessError) as error:
            print(error, file=sys.stderr, flush=True)
        os._exit(status)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


if __name__ == "__main__":
    sys.exit(_run(sys.argv[1], sys.argv[2:]) & 255)
