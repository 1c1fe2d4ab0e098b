# SPDX-License-Identifier: GPL-3.0-or-later
"""Packets of 16-bit samples with the device's tags, for a byte stream between two processes."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from typing import NamedTuple

# Tags that a device attaches to samples, by the number that stands for them in a packet.
TAG_KEYS = ("rx_time", "rx_rate", "rx_freq")

_HEAD = struct.Struct("<II")  # samples, tags
_TAG = struct.Struct("<BIQd")  # number of the key, sample, whole seconds, value or fraction
SAMPLE_BYTES = 4
HEAD_BYTES, TAG_BYTES = _HEAD.size, _TAG.size


class SampleTag(NamedTuple):
    """A tag of a sample in a packet.

    Attributes
    ----------
    key : str
        One of ``TAG_KEYS``.
    sample : int
        Index of the sample in the packet.
    seconds : int
        Whole seconds of an ``rx_time``; 0 for the others.
    value : float
        The fraction of an ``rx_time`` in s; samples per second; carrier in Hz.

    Examples
    --------
    >>> SampleTag("rx_time", 0, 3, 0.25).value
    0.25
    """

    key: str
    sample: int
    seconds: int
    value: float


def pack_head(samples: int, tags: Iterable[SampleTag] = ()) -> bytes:
    """What precedes the samples of a packet.

    Parameters
    ----------
    samples : int
        Number of samples that follow, 4 bytes each.
    tags : iterable of SampleTag

    Returns
    -------
    bytes

    Examples
    --------
    >>> head = pack_head(1000, [SampleTag("rx_freq", 7, 0, 900e6)])
    >>> unpack_counts(head[:HEAD_BYTES]), unpack_tags(head[HEAD_BYTES:])
    ((1000, 1), [SampleTag(key='rx_freq', sample=7, seconds=0, value=900000000.0)])
    """
    packed = [
        _TAG.pack(TAG_KEYS.index(tag.key), tag.sample, tag.seconds, tag.value) for tag in tags
    ]
    return _HEAD.pack(samples, len(packed)) + b"".join(packed)


def unpack_counts(head: bytes) -> tuple[int, int]:
    """Number of samples and of tags in a packet.

    Parameters
    ----------
    head : bytes
        The first ``HEAD_BYTES`` of the packet.

    Returns
    -------
    tuple of (int, int)

    Examples
    --------
    >>> unpack_counts(pack_head(1000))
    (1000, 0)
    """
    samples, tags = _HEAD.unpack(head)
    return samples, tags


def unpack_tags(data: bytes) -> list[SampleTag]:
    """Tags of a packet.

    Parameters
    ----------
    data : bytes
        ``TAG_BYTES`` for each tag; they follow the counts.

    Returns
    -------
    list of SampleTag

    Examples
    --------
    >>> unpack_tags(b"")
    []
    """
    return [SampleTag(TAG_KEYS[key], *fields) for key, *fields in _TAG.iter_unpack(data)]
