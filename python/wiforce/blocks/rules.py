# SPDX-License-Identifier: GPL-3.0-or-later
"""Rules of the blocks as yes or no, for editors that check a value while it is typed.

The asserts of the GNU Radio Companion descriptions call these. Each does what the constructors
do with the same value, so that the two cannot disagree.
"""

from ..errors import InputError


def is_scene(scene):
    """Whether a reader can be built from a scene: a file, a shipped scene's name, a dict."""
    from ..planning.plan import plan

    def build():
        planned = plan(scene)
        return planned.table, planned.sensors

    return _accepted(build)


def is_sensor(model):
    """Whether a sensor model can be loaded: a file, or a shipped sensor's name."""
    from ..sensor import SensorModel, load_sensor

    return isinstance(model, SensorModel) or _accepted(lambda: load_sensor(model))


def is_carrier_of(model, frequency_hz):
    """Whether a sensor model holds phases at a carrier."""
    from ..sensor import load_sensor

    return _accepted(lambda: load_sensor(model).untouched_deg(frequency_hz))


def is_amplitude_of(waveform, amplitude):
    """Whether a sounding frame of this amplitude stays within full scale."""
    from ..signal.waveform import sounding_waveform
    from .sounding_source import largest_amplitude

    return 0 < amplitude <= largest_amplitude(sounding_waveform(waveform).frame())


def is_capture(capture, datatype=None):
    """Whether a recording can be opened: a SigMF pair, or raw samples of ``datatype``."""
    from ..io.capture import open_capture

    return _accepted(lambda: open_capture(capture, datatype))


def _accepted(build):
    try:
        build()
    except (InputError, TypeError):
        # TypeError: a kind of value that is not taken at all, as a number for a file name.
        return False
    return True
