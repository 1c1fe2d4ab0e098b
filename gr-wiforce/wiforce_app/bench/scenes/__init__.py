# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes simulated as samples, read with and without a survey (`rooms`) and by many settings."""
