# SPDX-License-Identifier: GPL-3.0-or-later
"""A device at a low rate that serves all tests of a file."""

import pytest
from live_runs import SLOW, scene_file
from software_usrp import SoftwareUsrp


@pytest.fixture(scope="module")
def slow_scene(tmp_path_factory):
    """An untouched sensor at a low rate."""
    return scene_file(tmp_path_factory.mktemp("slow"), [], 400, 0.3, **SLOW)


@pytest.fixture(scope="module")
def slow_device(slow_scene):
    """A device that serves one test after the other; each session begins the scene anew."""
    device = SoftwareUsrp(slow_scene)
    yield device
    device.stop()
