# SPDX-License-Identifier: GPL-3.0-or-later
"""What a scene needs computed, what that costs, and which errors to expect."""
