# SPDX-License-Identifier: GPL-3.0-or-later
"""Frames of recordings and streams, from their first sample to the tones of phase groups."""
