# SPDX-License-Identifier: GPL-3.0-or-later
"""What a scene needs computed, what that costs, which errors to expect, and what to improve."""
