# SPDX-License-Identifier: GPL-3.0-or-later
"""The receiver's stages from samples to phases.

`groups` is what they pass on, `estimators` which of them a scene selects.
"""
