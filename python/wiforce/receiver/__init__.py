# SPDX-License-Identifier: GPL-3.0-or-later
"""The receiver: the stages in their order, from batches of groups, a file, a radio or a name."""

from .receiver import Receiver, make_readout

__all__ = ["Receiver", "make_readout"]
