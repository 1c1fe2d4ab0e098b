# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce check FILE``: what any file is, and whether a tag is seen in it."""

from pathlib import Path

from gnuradio.wiforce.io.capture.channel_snapshots import ChannelSnapshots
from gnuradio.wiforce.io.capture.names import is_snapshots
from gnuradio.wiforce.io.capture.samples import likely_datatype
from gnuradio.wiforce.io.csi_tools import tool_of

from ..read.recordings import SAMPLES_ONLY, open_recording
from ..shell.options import refuse
from . import check_capture, check_samples, check_snapshots

_TOOLS = {
    "intel": "Linux 802.11n CSI Tool (Intel 5300)",
    "atheros": "Atheros CSI Tool",
    "esp32": "ESP32",
    "nexmon": "nexmon_csi",
}


def check_file(path, scene_path, datatype, csi):
    """Examine a file of any kind.

    Returns found; text: the same for a terminal. ``scene_path``: for samples: what was sent. By
    default the capture's own; ``datatype``: of raw samples; by default found by their values;
    ``csi``: arguments of ``open_csi``; by default found by the file itself.
    """
    if datatype is None and csi is None and _is_raw(path):
        datatype = likely_datatype(path)
    recording = open_recording(path, datatype, csi)
    if isinstance(recording, ChannelSnapshots):
        refuse({"--datatype": datatype, "--scene": scene_path}, SAMPLES_ONLY)
        found = check_snapshots.check_snapshots(recording, _kind(path, csi))
        return found, check_snapshots.text(found)
    if scene_path is None and recording.scene is None:
        found = check_samples.check_samples(recording)
        return found, check_samples.text(found)
    found = check_capture.check_capture(path, scene_path, datatype)
    return found, check_capture.report(found)


def _is_raw(path):
    """Whether a file has neither metadata nor a format that is known."""
    file = Path(path)
    known = is_snapshots(path) or file.suffix in (".sigmf-data", ".sigmf-meta")
    metadata = file.with_name(f"{file.name}.sigmf-meta")
    return not known and file.is_file() and not metadata.exists() and tool_of(path) is None


def _kind(path, csi):
    tool = (csi or {}).get("tool") or tool_of(path)
    if tool is None:
        return "channel snapshots (.npz)"
    name, *settings = tool.split("/")
    return " ".join(["channel snapshots of", _TOOLS[name], *settings])
