# SPDX-License-Identifier: GPL-3.0-or-later
"""A small capture for all that is broken here."""

import subprocess

import press_capture
import pytest
import yaml
from command_runs import run_command

# 30 groups.
SCENE = press_capture.SCENE | {
    "simulation": press_capture.SCENE["simulation"] | {"duration_s": 1.08}
}


class Sandbox:
    """A folder with ``scene.yaml`` and its capture ``press``, and the command run in it."""

    def __init__(self, folder):
        self.folder = folder
        (folder / "scene.yaml").write_text(yaml.safe_dump(SCENE))

    def run(self, *arguments, before=None):
        """The command; with ``before`` as a process of its own, which calls that first."""
        if before is None:
            return run_command(*arguments, cwd=self.folder)
        return subprocess.run(
            ["gr-wiforce", *map(str, arguments)],
            capture_output=True,
            text=True,
            timeout=300,
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
    """The capture's readings as CSV."""
    done = sandbox.run("read", "press", "--scene", "scene.yaml")
    assert done.returncode == 0, done.stderr
    return done.stdout
