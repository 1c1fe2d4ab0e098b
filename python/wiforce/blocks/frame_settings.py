# SPDX-License-Identifier: GPL-3.0-or-later
"""The sounding frame that a block's parameters describe."""

from pathlib import Path
from typing import Any

from ..errors import InputError
from ..scene import Scene, load_scene
from ..signal.symbols import LONGEST_SYMBOL
from ..signal.waveform import WAVEFORMS, Waveform, sounding_waveform

# What the parameter ``waveform`` of blocks takes.
WaveformOrScene = str | Path | Waveform | Scene
# Samples that hold five repetitions of any symbol.
LONGEST_PREAMBLE = 5 * LONGEST_SYMBOL


def scene_meant(waveform: WaveformOrScene) -> Scene | None:
    """The scene, or ``.yaml`` file of one, given in place of a waveform; None for a waveform."""
    if isinstance(waveform, Scene):
        return waveform
    if str(waveform).lower().endswith((".yaml", ".yml")):
        return load_scene(str(waveform))
    return None


def frames_of(
    waveform: WaveformOrScene,
    frame_length: int,
    sample_rate: float,
    symbol_length: int = 0,
    repetitions: int = 0,
    averaged_repetitions: int = 0,
) -> Waveform:
    """The frame of a block, of a Waveform, a scene, or a name and keys, 0 for defaults."""
    if isinstance(waveform, Waveform):
        return waveform
    scene = scene_meant(waveform)
    if scene is not None:
        return scene.waveform()
    stated = {
        "symbol_length": symbol_length,
        "repetitions": repetitions,
        "averaged_repetitions": averaged_repetitions,
    }
    for name, value in stated.items():
        if value < 0:
            raise InputError(name, "must be positive, or 0 for the default", value)
    given: dict[str, Any] = {name: value for name, value in stated.items() if value}
    return sounding_waveform(str(waveform), frame_length, sample_rate, **given)


def symbol_length_of(waveform: WaveformOrScene, symbol_length: int = 0) -> int:
    """Samples of the symbol of a waveform or a scene: the length of folded vectors."""
    if isinstance(waveform, Waveform):
        return waveform.symbol_length
    if isinstance(waveform, Scene):
        return waveform.waveform().symbol_length
    name = str(waveform)
    if name in WAVEFORMS or name.lower().endswith(".npy"):
        return frames_of(name, LONGEST_PREAMBLE, 1.0, symbol_length).symbol_length
    return load_scene(name).waveform().symbol_length
