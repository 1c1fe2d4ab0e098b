# SPDX-License-Identifier: GPL-3.0-or-later
"""A small capture for all that is broken here."""

import subprocess

import pytest
import yaml
from fuzzing import SCENE


class Sandbox:
    """A folder with ``scene.yaml`` and its capture ``press``, and the command run in it."""

    def __init__(self, folder):
        self.folder = folder
        (folder / "scene.yaml").write_text(yaml.safe_dump(SCENE))

    def run(self, *arguments, before=None):
        """The command as a process of its own, ``before`` called in it first."""
        return subprocess.run(
            ["gr-wiforce", *map(str, arguments)],
            capture_output=True,
            text=True,
            timeout=100,
            cwd=self.folder,
            preexec_fn=before,
        )


@pytest.fixture(scope="session")
def sandbox(tmp_path_factory):
    made = Sandbox(tmp_path_factory.mktemp("robustness"))
    done = made.run("simulate", "scene.yaml", "press")
    assert done.returncode == 0, done.stderr
    return made


@pytest.fixture(scope="session")
def readings(sandbox):
    """The lines of the capture's readings."""
    done = sandbox.run("read", "press", "--scene", "scene.yaml")
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines(keepends=True)
