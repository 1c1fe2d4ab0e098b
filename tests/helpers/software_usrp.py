# SPDX-License-Identifier: GPL-3.0-or-later
"""Radios for any test: a software USRP at a loopback address of its own, a player by SoapySDR."""

from pathlib import Path

import pytest
from wiforce_app.bench.live import DeviceProcess


class SoftwareUsrp(DeviceProcess):
    """A running software N210."""

    def __init__(self, *arguments, speed=1.0, faults=(), address=None):
        options = ["--speed", speed]
        for fault in faults:
            options += ["--fault", fault]
        super().__init__(*arguments, *options, address=address)


@pytest.fixture
def software_usrp():
    """Starts devices: ``software_usrp(SCENE or "--air", "cable", ..., speed=1, faults=())``."""
    running = []

    def start(*arguments, **options):
        running.append(SoftwareUsrp(*arguments, **options))
        return running[-1]

    yield start
    for device in running:
        if device.process.returncode is None:
            device.stop()


@pytest.fixture
def soapy_player(monkeypatch):
    """The SoapySDR module ``player`` (soapy_player.cc)."""
    module = Path(__file__).parents[2] / "build" / "tests" / "libsoapy_player.so"
    if not module.exists():
        pytest.skip("not built: libsoapysdr-dev was missing")
    monkeypatch.setenv("SOAPY_SDR_PLUGIN_PATH", str(module.parent))
