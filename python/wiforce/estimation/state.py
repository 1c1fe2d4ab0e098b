# SPDX-License-Identifier: GPL-3.0-or-later
"""What travels with a group's vectors from block to block."""

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class ClockState:
    """A tag's clock in one group; ``phase`` in radians at the group's centre."""

    locked: bool
    phase: float = 0.0
    offset_ppm: float = 0.0
    clock2_delay: float = 0.0
    overlapping: bool = False


@dataclass(frozen=True)
class GroupState:
    """What is known of a group beside its vectors; each stage adds its part.

    Attributes
    ----------
    group : int
        Index on the grid of the run.
    missing : int
        Snapshots absent.
    saturated : bool
        Whether samples at full scale are more than chance.
    retuned : bool
        Whether the receiver's settings were changed before it.
    clocks : tuple of ClockState
        One per tag.
    noise : ndarray, shape (K,)
        Variance of the noise in H on each occupied subcarrier.
    gain : ndarray, shape (2S,)
        Variance of V_i over that of H; infinite for an end that is not there.
    snr_db : ndarray, shape (2S,)
        |c1[1] V_i|^2 against the noise in H, mean over subcarriers.
    new_reference : bool
        Whether the untouched reference is taken anew from it on: the first group, or after a tare.
    in_reference : ndarray of bool, shape (2S,)
        Whether the group is part of the untouched reference.
    late_reference : ndarray of bool, shape (2S,)
        Whether the end was absent while the sensor was promised untouched, and its reference is
        what came first.
    reshaped : ndarray of bool, shape (2S,)
        Whether the end's channel has another course over the subcarriers than its reference.
    reference_power : ndarray, shape (2S,)
        Weighted mean of |V_ref|^2; 0 without a reference.
    reference_gain : ndarray, shape (2S,)
        Variance of V_ref over that of H.
    std_deg : ndarray, shape (2S,)
        Standard deviation of arg R_i.
    """

    group: int
    missing: int
    clocks: tuple
    noise: np.ndarray = field(repr=False)
    gain: np.ndarray = field(repr=False)
    snr_db: np.ndarray = field(repr=False)
    saturated: bool = False
    retuned: bool = False
    new_reference: bool = False
    in_reference: np.ndarray = field(default=None, repr=False)
    late_reference: np.ndarray = field(default=None, repr=False)
    reshaped: np.ndarray = field(default=None, repr=False)
    reference_power: np.ndarray = field(default=None, repr=False)
    reference_gain: np.ndarray = field(default=None, repr=False)
    std_deg: np.ndarray = field(default=None, repr=False)
