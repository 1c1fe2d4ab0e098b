# SPDX-License-Identifier: GPL-3.0-or-later
"""The receiver's stages from tones to force and location, and what comes before them."""
