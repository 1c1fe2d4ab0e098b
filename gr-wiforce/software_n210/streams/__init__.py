# SPDX-License-Identifier: GPL-3.0-or-later
"""The receive and the transmit stream: packets, samples and flow control."""
