# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces: strips side by side under one skin, read together."""
