# SPDX-License-Identifier: GPL-3.0-or-later
"""What is at the antenna connectors: daughterboards, a cable or the channel of a scene."""
