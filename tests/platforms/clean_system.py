# SPDX-License-Identifier: GPL-3.0-or-later
"""A minimal Debian system in a folder, and commands that run in it with a kernel's file systems."""

import os
import shlex
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

TESTED = {"bookworm": "Debian 12", "trixie": "Debian 13"}
# Other distributions of the same family: mmdebstrap knows their archives, nobody has tried them.
UNTESTED = {
    "forky": "Debian 14 (untested)",
    "sid": "Debian unstable (untested)",
    "noble": "Ubuntu 24.04 (untested)",
    "plucky": "Ubuntu 25.04 (untested)",
}
_STEPS = Path(__file__).resolve().parent / "steps"
# The name under which the host's certificates are known in the system.
_CERTIFICATES = "/etc/ssl/host.crt"
_CERTIFICATE_VARIABLES = ("PIP_CERT", "SSL_CERT_FILE", "REQUESTS_CA_BUNDLE", "CURL_CA_BUNDLE")
# Settings of apt that concern how the archive is reached.
_APT_KEYS = ("Acquire::http", "Acquire::https", "Acquire::Retries", "Acquire::ForceIPv4")


def make_base(suite: str, archive: Path, mirror: str | None) -> None:
    """A tar archive of the minimal system of a distribution.

    ``suite``: its name, as ``bookworm``; ``mirror``: address of the archive; None lets mmdebstrap
    choose.
    """
    components = "main,universe" if "Ubuntu" in UNTESTED.get(suite, "") else "main"
    command = ["mmdebstrap", "--variant=minbase", f"--components={components}"]
    # A user's system has both, and README begins with them.
    command += ["--include=ca-certificates,sudo,git,procps,locales", *_apt_options()]
    # With sources.list, more than the release itself: its updates and security fixes.
    subprocess.run([*command, suite, archive, *([mirror] if mirror else [])], check=True)


def _apt_settings() -> list[str]:
    shown = subprocess.run(["apt-config", "dump"], capture_output=True, text=True, check=True)
    return [
        line
        for line in shown.stdout.splitlines()
        if line.startswith(_APT_KEYS) and not line.endswith(' "";')
    ]


def _apt_options() -> list[str]:
    return [f"--aptopt={line.rstrip(';')}" for line in _apt_settings()]


def _environment() -> dict[str, str]:
    """What is carried over from this machine's environment."""
    kept = {
        name: value
        for name, value in os.environ.items()
        if name.startswith("PIP_") or name.lower().endswith("_proxy") or name == "DEB_BUILD_OPTIONS"
    }
    if _host_certificates() is not None:
        kept |= dict.fromkeys(_CERTIFICATE_VARIABLES, _CERTIFICATES)
    return kept


def _host_certificates() -> Path | None:
    """The certificates that this machine is set to trust; None: the system's own suffice."""
    for name in _CERTIFICATE_VARIABLES:
        if os.environ.get(name) and Path(os.environ[name]).is_file():
            return Path(os.environ[name])
    return None


def _pip_files() -> Iterator[Path]:
    folders = os.environ.get("XDG_CONFIG_DIRS", "/etc/xdg").split(":")
    for path in [*(Path(folder) / "pip" for folder in folders), Path("/etc/pip.conf")]:
        if path.exists():
            yield path


def _local_folders() -> set[Path]:
    """Folders of this machine from which pip installs, as its settings name them."""
    shown = subprocess.run(
        ["python3", "-m", "pip", "config", "list"], capture_output=True, text=True
    )
    words = [word.strip("'\"") for word in shown.stdout.replace("=", " ").split()]
    paths = [Path(word.removeprefix("file://")) for word in words]
    return {path for path in paths if path.is_absolute() and path.is_dir()}


class CleanSystem:
    """A system in a folder.

    ``archives``: folder of downloaded packages, which several systems share.
    """

    def __init__(self, path: Path, archives: Path) -> None:
        self.path = path
        self._archives = archives

    def exists(self) -> bool:
        return (self.path / "etc/os-release").exists()

    def home(self, user: str) -> Path:
        """Folder of a user, seen from outside."""
        return self.path / ("root" if user == "root" else f"home/{user}")

    def unpack(self, base: Path) -> None:
        """Replace the system by a fresh one.

        ``base``: made by :func:`make_base`.
        """
        shutil.rmtree(self.path, ignore_errors=True)
        self.path.mkdir(parents=True)
        subprocess.run(["tar", "-C", self.path, "--numeric-owner", "-xpf", base], check=True)
        for name in ("etc/resolv.conf", "etc/hosts"):
            if Path("/", name).exists():
                (self.path / name).unlink(missing_ok=True)
                shutil.copyfile(Path("/", name), self.path / name)
        (self.path / "etc/apt/apt.conf.d/99host").write_text("\n".join(_apt_settings()) + "\n")
        # A system that is thrown away need not survive a loss of power.
        (self.path / "etc/dpkg/dpkg.cfg.d/clean-system").write_text("force-unsafe-io\n")
        certificates = _host_certificates()
        if certificates is not None:
            shutil.copyfile(certificates, self.path / _CERTIFICATES.lstrip("/"))
        for path in _pip_files():
            target = self.path / str(path).lstrip("/")
            target.parent.mkdir(parents=True, exist_ok=True)
            (shutil.copytree if path.is_dir() else shutil.copyfile)(path, target)

    def add_user(self, name: str) -> None:
        """A user who may use sudo without a password."""
        self._run(["useradd", "--create-home", "--shell", "/bin/bash", name], "root")
        sudoers = self.path / "etc/sudoers.d" / name
        sudoers.write_text(f"{name} ALL=(ALL) NOPASSWD: ALL\n")
        sudoers.chmod(0o440)

    def clone(self, source: Path, user: str) -> None:
        """The last commit of this repository in the user's folder."""
        target = self.home(user) / "gr-wiforce"
        subprocess.run(
            ["git", "clone", "--quiet", "--no-hardlinks", "--depth=1", f"file://{source}", target],
            check=True,
        )
        self._run(["chown", "-R", f"{user}:", f"/{target.relative_to(self.path)}"], "root")

    def run_step(self, script: str, user: str, *arguments: str, network: bool = True) -> None:
        """Run a script of the folder ``steps`` in the system.

        ``network``: false: without any but the loopback interface. A script that fails raises
        subprocess.CalledProcessError.
        """
        shutil.copyfile(_STEPS / script, self.path / "step.sh")
        self._run(["bash", "/step.sh", *arguments], user, network)

    def _run(self, command: list[str], user: str, network: bool = True) -> None:
        root = shlex.quote(str(self.path))
        mounts = [
            "set -e",
            f"mount -t proc proc {root}/proc",
            f"mount --rbind /sys {root}/sys",
            f"mkdir -p {root}/dev/pts {root}/dev/shm {root}/var/cache/apt/archives",
            # One of its own, with which a process that asks for a terminal gets one.
            f"mount -t devpts -o newinstance,ptmxmode=0666,mode=620,gid=5 devpts {root}/dev/pts",
            f"mount -t tmpfs -o mode=1777 tmpfs {root}/dev/shm",
            f"mount --bind {shlex.quote(str(self._archives))} {root}/var/cache/apt/archives",
        ]
        for folder in sorted(_local_folders()):
            target = shlex.quote(f"{self.path}{folder}")
            mounts.append(f"mkdir -p {target} && mount --bind {folder} {target}")
        if not network:
            mounts.append("ip link set lo up")
        kept = {"PATH": "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"}
        kept |= {"LANG": "C.UTF-8", "USER": user, "LOGNAME": user} | _environment()
        kept["HOME"] = f"/{self.home(user).relative_to(self.path)}"
        inside = ["chroot", str(self.path)]
        if user != "root":
            inside = ["chroot", f"--userspec={user}", f"--groups={user}", str(self.path)]
        inside += ["env", "-i", *(f"{name}={value}" for name, value in kept.items())]
        inside += ["sh", "-c", f"cd && exec {shlex.join(command)}"]
        script = "\n".join([*mounts, f"exec {shlex.join(inside)}"])
        self._archives.mkdir(parents=True, exist_ok=True)
        # The mounts and whatever is still running end with the command.
        spaces = ["unshare", "--mount", "--pid", "--fork", "--kill-child"]
        if not network:
            spaces.append("--net")
        subprocess.run([*spaces, "sh", "-c", script], check=True)
