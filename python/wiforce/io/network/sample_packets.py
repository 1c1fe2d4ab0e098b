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

    ``value`` is the fraction of an ``rx_time`` in s, samples per second, or the carrier in Hz.
    """

    key: str
    sample: int
    seconds: int
    value: float


def pack_head(samples: int, tags: Iterable[SampleTag] = ()) -> bytes:
    """What precedes the samples of a packet, 4 bytes each: counts and tags."""
    packed = [
        _TAG.pack(TAG_KEYS.index(tag.key), tag.sample, tag.seconds, tag.value) for tag in tags
    ]
    return _HEAD.pack(samples, len(packed)) + b"".join(packed)


def unpack_counts(head: bytes) -> tuple[int, int]:
    """Number of samples and of tags in a packet, from its first ``HEAD_BYTES``."""
    samples, tags = _HEAD.unpack(head)
    return samples, tags


def unpack_tags(data: bytes) -> list[SampleTag]:
    """Tags of a packet, ``TAG_BYTES`` each, which follow the counts."""
    return [SampleTag(TAG_KEYS[key], *fields) for key, *fields in _TAG.iter_unpack(data)]
