# SPDX-License-Identifier: GPL-3.0-or-later
"""What blocks of the chain share: groups in tags, their state and noise, and readings."""

import dataclasses
import math
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from threading import Event
from typing import Any

import numpy as np
import pmt
from gnuradio import gr

from ..errors import InputError
from ..estimation.capture.folded_groups import SnapshotGroup
from ..estimation.groups import Array, Groups
from ..io.outputs import Output
from ..io.readings import Reading
from ..wiforce_python import collected_groups, input_has_ended
from . import names
from .argument_types import Kept

# Arrays that are the stream's items, or are not sent.
_ITEMS = {"tones", "snapshot_weights", "ends", "changes", "ratios"}
_NAMES = [item.name for item in dataclasses.fields(Groups) if item.name not in _ITEMS]


def state_to_pmt(group: Groups) -> Any:
    """A batch of one group as a pmt dict, with a row of each array that is not None."""
    known = {name: getattr(group, name) for name in _NAMES}
    rows = {name: np.asarray(values[0]) for name, values in known.items() if values is not None}
    return pmt.to_pmt({name: _sendable(row) for name, row in rows.items()})


def _sendable(row: Array) -> Any:
    """A number, or a vector of a type that pmt has."""
    if row.ndim == 0:
        return row.item()
    if row.dtype == bool:
        return row.astype(np.uint8)
    return row.astype(complex if np.iscomplexobj(row) else float)


def state_from_pmt(value: Any) -> Groups:
    """A batch of one group from :func:`state_to_pmt`; other entries are ignored."""
    try:
        items = {name: pmt.dict_ref(value, pmt.intern(name), pmt.PMT_NIL) for name in _NAMES}
        known = {name: item for name, item in items.items() if not pmt.is_null(item)}
        rows = {name: np.array(pmt.to_python(item)) for name, item in known.items()}
        flags = {name: row.astype(bool) for name, row in rows.items() if row.dtype == np.uint8}
        return Groups(**{name: row[None] for name, row in (rows | flags).items()})
    except (RuntimeError, TypeError, ValueError) as error:
        rule = "must hold the state of a group, as the previous stage sends it"
        raise InputError(f"tag {names.STATE}", rule) from error


def noise_value(noise: Array) -> Any:
    """f32vector for the tag ``noise`` of folded vectors, from (n, 2): smallest and largest."""
    return pmt.init_f32vector(noise.size, np.asarray(noise, np.float32).ravel())


class NoiseTags:
    """Reads the tags ``noise`` of one input."""

    def __init__(self) -> None:
        self._runs: deque[tuple[int, Array]] = deque()

    def add(self, item: int, value: Any) -> None:
        """Take the tag of an item, in the order of items; ignored if it is none of ours."""
        if pmt.is_f32vector(value) and pmt.length(value) % 2 == 0:
            self._runs.append((item, np.array(pmt.f32vector_elements(value)).reshape(-1, 2)))

    def noise(self, first: int, count: int) -> Array:
        """Noise of some items, (count, 2), zeros where unknown; earlier tags are forgotten."""
        noise = np.zeros((count, 2))
        while self._runs and self._runs[0][0] + len(self._runs[0][1]) <= first:
            self._runs.popleft()
        for item, values in self._runs:
            begin, end = max(item, first), min(item + len(values), first + count)
            if begin < end:
                noise[begin - first : end - first] = values[begin - item : end - item]
        return noise


def occupied_subcarriers(items: Array, rows: int, bins: Array) -> Array:
    """Occupied subcarriers (G, rows, K), by their FFT bins, of whole spectra (G, N rows)."""
    return items.reshape(len(items), rows, -1)[:, :, bins].astype(complex)


def whole_spectra(values: Array, bins: Array, symbol_length: int) -> Array:
    """Vectors (G, N rows) of occupied subcarriers (G, rows, K), zeros in the others."""
    items = np.zeros((*values.shape[:2], symbol_length), complex)
    items[:, :, bins] = values
    return items.reshape(len(values), -1)


# Tags of each item, by name.
Tags = Sequence[dict[str, Any]]

_STATE = pmt.intern(names.STATE)
_DONE = -1
_NOTHING = Groups(np.zeros(0, np.int64))
_PAGE_BYTES, _LEAST_GROUPS = 4096, 32


class GroupBlock(Kept, gr.basic_block):
    """Passes the groups that have arrived to ``take``, and sends the groups that it returns.

    Subclasses implement ``take(items, tags)``, the input's vectors and tags by name of each, which
    returns how many were taken and a Groups that ``vectors(groups)`` turns into items, and
    ``flush()``, the groups held back, once the input has ended. An exception, or one passed to
    ``fail``, ends the flowgraph in order as ``failure``. 0 outputs make a sink.
    """

    def __init__(self, name: str, inputs: int, outputs: int) -> None:
        out_sig = [(np.complex64, outputs)] if outputs else None
        gr.basic_block.__init__(self, name, in_sig=[(np.complex64, inputs)], out_sig=out_sig)
        self.set_tag_propagation_policy(gr.TPP_DONT)
        if outputs:
            # A short buffer of whole pages: tags of all items that it holds are kept.
            size = self.output_signature().sizeof_stream_item(0)
            in_pages = math.lcm(size, _PAGE_BYTES) // size
            self.set_max_output_buffer(in_pages * math.ceil(_LEAST_GROUPS / in_pages))
        self._ready: deque[tuple[Groups, Array]] = deque()
        self.failure: Exception | None = None
        self._sends, self._flushed = bool(outputs), False

    def take(self, items: Array, tags: Tags) -> tuple[int, Groups]:
        """Process items (G, n); return how many were taken and the groups that are ready."""
        raise NotImplementedError

    def flush(self) -> Groups:
        """Give the groups that are held back at the end of the input; none by default."""
        return _NOTHING

    def vectors(self, groups: Groups) -> Array:
        """Items (G, n) of a batch."""
        raise NotImplementedError

    def fail(self, error: Exception) -> None:
        """End the flowgraph with an exception."""
        self.failure = error
        gr.log.error(f"{self.name()}: {type(error).__name__}: {error}")

    def start(self) -> bool:
        self._flushed = False
        return super().start()

    def forecast(self, noutput_items: int, ninputs: int) -> list[int]:
        # A block that needs input is not called any more when its input has ended.
        needed = 0 if self._ready or self._must_flush() else 1
        return [needed] * ninputs

    def general_work(self, input_items: list[Array], output_items: list[Array]) -> int:
        if self.failure is not None or self._flushed and not self._ready:
            return _DONE
        consumed = 0
        if not self._ready:
            try:
                consumed, groups = self._next(input_items[0])
                rows = self.vectors(groups) if self._sends and len(groups) else ()
            except Exception as error:
                self.fail(error)
                return _DONE
            self._ready.extend((groups[i : i + 1], row) for i, row in enumerate(rows))
        self.consume(0, consumed)
        return self._put_out(output_items[0]) if self._sends else 0

    def _next(self, items: Array) -> tuple[int, Groups]:
        """Take the items; when all are taken and the input has ended, flush."""
        if len(items) and not self._flushed:
            return self.take(items, self._tags_of(len(items)))
        if not self._must_flush():
            return 0, _NOTHING
        self._flushed = True
        return 0, self.flush()

    def _must_flush(self) -> bool:
        return not self._flushed and input_has_ended(self.gateway)

    def _tags_of(self, count: int) -> Tags:
        tags: list[dict[str, Any]] = [{} for _ in range(count)]
        first = self.nitems_read(0)
        for tag in self.get_tags_in_range(0, first, first + count):
            tags[tag.offset - first][pmt.symbol_to_string(tag.key)] = tag.value
        return tags

    def _put_out(self, out: Array) -> int:
        count, first = min(len(self._ready), len(out)), self.nitems_written(0)
        for item in range(count):
            group, out[item] = self._ready.popleft()
            self.add_item_tag(0, first + item, _STATE, state_to_pmt(group))
        return count


class SnapshotSink(GroupBlock):
    """Passes the collected snapshots (N x symbol length) that have arrived to ``read``.

    Arrays of the groups are valid during the call only.
    """

    def __init__(self, name: str, group_length: int, symbol_length: int) -> None:
        GroupBlock.__init__(self, name, group_length * symbol_length, outputs=0)
        self.everything = np.ones(group_length, bool)  # ``kept`` of groups that are whole

    def read(self, groups: list[SnapshotGroup]) -> None:
        """Take groups, in order."""
        raise NotImplementedError

    # What GNU Radio itself does here, a class for every array and an object for every tag, takes
    # longer than to compute the tones of a group.

    def handle_forecast(self, noutput_items: int, ninputs: int) -> list[int]:
        return [1]

    def handle_general_work(
        self, noutput_items: int, ninput_items: list[int], *pointers: list[Any]
    ) -> int:
        if self.failure is not None:
            return _DONE
        count, everything = ninput_items[0], self.everything
        try:
            groups = []
            for each in collected_groups(self.gateway, count, len(everything)):
                index, folded, present, undisturbed, saturated, retuned, misplaced = each
                present = everything if present is None else present
                kept = present if undisturbed is None else present & undisturbed
                groups.append(
                    SnapshotGroup(index, folded, present, kept, saturated, retuned, misplaced)
                )
            self.read(groups)
        except Exception as error:
            self.fail(error)
            return _DONE
        self.gateway.consume(0, count)
        return 0


def groups_of(tags: Tags) -> Groups:
    """The batch that the previous stage described in tags; RuntimeError without a state."""
    if any(names.STATE not in own for own in tags):
        raise RuntimeError(f"group without a {names.STATE!r} tag: connect after end_separation")
    return Groups.concatenate(state_from_pmt(own[names.STATE]) for own in tags)


def count_of(tags: dict[str, Any], name: str) -> int:
    """Value of a tag that counts, 0 where an item has none."""
    return int(pmt.to_uint64(tags[name])) if name in tags else 0


def misplaced_in(tags: dict[str, Any]) -> list[tuple[int, int]]:
    """Frames before each slip that may lie elsewhere, by an item's tag: the first, the end."""
    if names.SLIPPED not in tags:
        return []
    ranges = np.array(pmt.u64vector_elements(tags[names.SLIPPED]), np.int64)
    return [(int(first), int(end)) for first, end in ranges.reshape(-1, 2)]


# What takes every Reading, in the block's thread: a function, or an output, which is begun with the
# first one and closed when the stream has ended.
ReadingTaker = Callable[[Reading], None] | Output | None


class ReadingPort(GroupBlock):
    """A block that ends the chain: ``finish`` publishes the groups held back."""

    def open_port(self, on_reading: ReadingTaker) -> None:
        """Register the message port, and keep what takes the readings."""
        self._output = on_reading if isinstance(on_reading, Output) else None
        self._on_reading = on_reading.write if isinstance(on_reading, Output) else on_reading
        self.ended = Event()
        self.message_port_register_out(pmt.intern(names.READINGS))

    def finish(self) -> None:
        """Publish the readings that are held back."""
        raise NotImplementedError

    def publish(self, readings: Iterable[Reading]) -> None:
        """Send readings to the callback and the message port."""
        port = pmt.intern(names.READINGS)
        # A message takes as long as a fifth of the receiver, and mostly nobody is connected.
        heard = not pmt.is_null(self.message_subscribers(port))
        for reading in readings:
            if self._on_reading is not None:
                self._on_reading(reading)
            if heard:
                known = {key: value for key, value in reading.row().items() if value is not None}
                self.message_port_pub(port, pmt.to_pmt(known))

    def start(self) -> bool:
        self.ended.clear()
        return super().start()

    def stop(self) -> bool:
        self.end()
        return super().stop()

    def end(self) -> None:
        """Read the groups held back; called by hand where the flowgraph cannot be stopped."""
        if self.ended.is_set():
            return
        try:
            if self.failure is None:
                self.finish()
                self._close_output()
        except Exception as error:
            # Raised through the scheduler it would abort the process.
            self.failure = error
        if self.failure is not None and self._output is not None:
            self._output.abandon()
        self.ended.set()

    def _close_output(self) -> None:
        """Close the output; without input, as of a device that did not start, it stays as it is."""
        if self._output is not None:
            end = self._output.close if self.nitems_read(0) else self._output.abandon
            end()
