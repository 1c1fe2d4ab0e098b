# SPDX-License-Identifier: GPL-3.0-or-later
"""A software USRP N210: the device's side of what libuhd's ``usrp2`` driver says on the network."""
