# SPDX-License-Identifier: GPL-3.0-or-later
"""Requests for a tare to whatever receiver reads a stream at present."""

from __future__ import annotations

from collections.abc import Callable

from .tare_request import TareReports, TareState


class StreamTares(TareReports):
    """Requests for a tare of the receiver that reads a stream at present.

    Parameters
    ----------
    request : callable
        Takes ``force``; gives the TareState.
    cancel : callable
        Takes the reason.

    Examples
    --------
    >>> refuse = lambda force: TareState("refused", "the first reference is not complete", force)
    >>> StreamTares(refuse, cancel=print).request().state
    'refused'
    """

    def __init__(self, request: Callable[[bool], TareState], cancel: Callable[[str], None]) -> None:
        super().__init__()
        self._request, self._cancel = request, cancel

    def request(self, force: bool = False) -> TareState:
        """Measure a new reference, and survey the room in it.

        Parameters
        ----------
        force : bool
            As for ``Receiver.tare``; the room is not surveyed then.

        Returns
        -------
        TareState
        """
        return self._request(force)

    def cancel(self, reason: str) -> TareState:
        """Give up a tare that is being measured; the former reference stays in use.

        Parameters
        ----------
        reason : str

        Returns
        -------
        TareState
        """
        self._cancel(reason)
        return self.state
