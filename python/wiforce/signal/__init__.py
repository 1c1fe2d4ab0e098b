# SPDX-License-Identifier: GPL-3.0-or-later
"""The signal model: sounding frames, the tag's switching, weights for its tones, the bound."""
