# SPDX-License-Identifier: GPL-3.0-or-later
"""Arguments, lifetime and buffers of Python blocks, where GNU Radio leaves them to chance."""

import ctypes
import inspect
import types
from collections import abc
from collections.abc import Callable, Sequence
from functools import cache, wraps
from numbers import Complex, Integral, Real
from typing import Any, ParamSpec, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
import pmt
from gnuradio import gr

from ..errors import InputError
from ..io.outputs import Output
from ..wiforce_python import keep_thread_state, kept_with

_P = ParamSpec("_P")
_R = TypeVar("_R")

# What a message calls a type. Classes have their names.
_WORDS: dict[Any, str] = {
    bool: "True or False",
    int: "a whole number",
    float: "a number",
    complex: "a number",
    str: "text",
    abc.Callable: "a function",
    Output: "an output of readings",
    type(None): "None",
    Sequence[str]: "a list of texts",
    Sequence[float]: "a list of numbers",
    tuple[float, float]: "2 numbers",
}


def typed(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Let a constructor or method refuse arguments whose type is not the annotated one.

    Without it, Python would fail somewhere inside the function. NumPy's numbers are accepted, and
    floats without a fraction where an integer is asked for.
    """
    signature = inspect.signature(function)
    hints = cache(lambda: get_type_hints(function))

    @wraps(function)
    def checked(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        try:
            bound = signature.bind(*args, **kwargs)
        except TypeError:
            return function(*args, **kwargs)  # Python's own message names the function
        for name, value in bound.arguments.items():
            if name in hints():
                bound.arguments[name] = _checked(name, value, hints()[name])
        return function(*bound.args, **bound.kwargs)

    return checked


def _checked(name: str, value: Any, hint: Any) -> Any:
    kinds = _kinds(hint)
    if not any(_is_of(value, kind) for kind in kinds):
        *others, last = dict.fromkeys(_words(kind) for kind in kinds)
        rule = f"{', '.join(others)} or {last}" if others else last
        raise InputError(name, f"must be {rule}", value)
    if int in kinds and isinstance(value, Real) and not isinstance(value, Integral):
        return int(float(value))
    return value


def _kinds(hint: Any) -> tuple[Any, ...]:
    return get_args(hint) if get_origin(hint) in (Union, types.UnionType) else (hint,)


def _is_of(value: Any, kind: Any) -> bool:
    origin = get_origin(kind) or kind
    if origin is Any:
        return True
    if origin is abc.Callable:
        return callable(value)
    if origin in (Sequence, tuple):
        items = get_args(kind)
        return (
            isinstance(value, Sequence | np.ndarray)
            and not isinstance(value, str | bytes)
            and (origin is Sequence or len(value) == len(items))
            and all(_is_of(each, items[0]) for each in value)
        )
    if origin is bool:
        return isinstance(value, bool | np.bool_) or isinstance(value, Integral) and value in (0, 1)
    if origin in (int, float, complex):
        if isinstance(value, bool):
            return False
        if origin is int and not isinstance(value, Integral):
            return isinstance(value, Real) and float(value).is_integer()
        return isinstance(value, Complex if origin is complex else Real)
    return isinstance(value, origin)


def _words(kind: Any) -> str:
    origin = get_origin(kind) or kind
    return _WORDS.get(kind) or _WORDS.get(origin, f"a {origin.__name__}")


class Kept:
    """Mix-in of Python blocks, before GNU Radio's class: a flowgraph keeps the whole block.

    A flowgraph holds only the C++ part. Without this class, a block to which Python has no other
    reference is destroyed while it runs.
    """

    def to_basic_block(self) -> Any:
        """The block as a flowgraph connects it."""
        # The C++ part of a hierarchical block, and that of another one.
        own = self.__dict__
        return kept_with(own["_impl"] if "_impl" in own else own["gateway"], self)

    def take_messages(self: Any, port: str, handler: Callable[[Any], None]) -> None:
        """Let a method, which GNU Radio finds by its name, take what comes to an input port."""
        self.message_port_register_in(pmt.intern(port))
        self.set_msg_handler(pmt.intern(port), handler)

    # GNU Radio calls both in the block's thread.

    def start(self) -> bool:
        """Begin a run; derived blocks that have a beginning of their own call this one as well."""
        keep_thread_state(True)
        return True

    def stop(self) -> bool:
        """End a run, likewise."""
        keep_thread_state(False)
        return True

    def handle_general_work(
        self: Any, most: int, ninput_items: list[int], inputs: list[Any], outputs: list[Any]
    ) -> int:
        """What the gateway of GNU Radio does, which makes a class for every array of every call."""
        general = self._block_type == gr.GW_BLOCK_GENERAL
        counts = ninput_items if general else [most] * len(inputs)
        input_items = _arrays(inputs, self.in_sig(), counts)
        output_items = _arrays(outputs, self.out_sig(), [most] * len(outputs))
        if general:
            return int(self.general_work(input_items, output_items))
        done = int(self.work(input_items, output_items))
        if done > 0:
            self.consume_items(done)
        return done


_address_in = ctypes.PYFUNCTYPE(ctypes.c_void_p, ctypes.py_object, ctypes.c_char_p)(
    ("PyCapsule_GetPointer", ctypes.pythonapi)
)
_memory_at = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_void_p, ctypes.c_ssize_t, ctypes.c_int)(
    ("PyMemoryView_FromMemory", ctypes.pythonapi)
)
_WRITABLE = 0x200  # PyBUF_WRITE


def _arrays(pointers: Sequence[Any], signature: Any, counts: Sequence[int]) -> list[Any]:
    """Items in the buffers of GNU Radio, (count, ...) each, valid during a call."""
    return [
        np.ndarray(
            (count, *kind.shape),
            kind.base,
            _memory_at(_address_in(pointer, None), count * kind.itemsize, _WRITABLE),
        )
        for pointer, kind, count in zip(
            pointers, signature.port_types(len(counts)), counts, strict=True
        )
    ]


def enlarge_output_buffer(block: Any, items: int) -> None:
    """Call ``set_min_output_buffer`` of a block without the line that it prints."""
    level = block.log_level()
    block.set_log_level("warn")
    block.set_min_output_buffer(items)
    block.set_log_level(level)
