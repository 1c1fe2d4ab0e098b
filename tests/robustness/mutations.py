# SPDX-License-Identifier: GPL-3.0-or-later
"""Broken versions of a file: what a slip of the hand, a bad disk or malice makes of it."""

import io
import re
import warnings

import numpy as np

_NUMBER = re.compile(rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_WORD = re.compile(rb"[A-Za-z_][\w-]*")
_NUMBERS = (
    b"0", b"-0", b"-1", b"1e-320", b"1e308", b"-1e308", b"1e999", b"nan", b".nan", b"inf", b".inf",
    b"2147483648", b"9223372036854775808", b"18446744073709551616", b"1" * 400, b"0x7f", b"1_0",
    b"3.7", b"1e5", b"true", b"null", b"", b"[]", b"{}", b'"x"', b"[1, 2]", b"0.5", b"2", b"100",
)  # fmt: skip
_TOKENS = (
    b"\x00", b"\xff\xfe", b"\xef\xbb\xbf", "é\u2028ß".encode(), b"\x1b[2J", b"&a *a", b"*a",
    b"!!python/object/apply:os.system [x]", b"!!binary aa", b"<<: {}", b"---\n", b"? a\n: b\n",
    b"\t", b"\r", b'"', b"'", b",", b",,,,", b":", b"{", b"[" * 40, b"[" * 5000, b"{a: " * 40,
    b"\\u0000", b"../../../etc/passwd", b"/dev/zero", b"#", b"%s%n", b"A" * 5000, b"\n" * 200,
    b"2001-01-01", b"NULL", b"~", b"~user", b"-", b"..", b"\xed\xa0\x80",
)  # fmt: skip


def mutated(data, rng):
    """``data`` (bytes) after one to four random accidents."""
    for _ in range(int(rng.choice([1, 1, 1, 2, 4]))):
        data = _ACCIDENTS[rng.integers(len(_ACCIDENTS))](data, rng)
    return data


def mutated_samples(data, rng):
    """Samples (bytes) with random stretches lost, doubled, overwritten or cut off."""
    data = bytearray(data)
    for _ in range(int(rng.integers(1, 6))):
        start = int(rng.integers(len(data) + 1))
        end = min(len(data), start + int(2 ** rng.uniform(0, 20)))
        what = rng.integers(6)
        if what == 0:
            del data[start:end]
        elif what == 1:
            data[start:start] = data[start:end]
        elif what == 2:
            data[start:end] = bytes(end - start)
        elif what == 3:
            data[start:end] = rng.bytes(end - start)
        elif what == 4:
            data[start:end] = b"\xff\x7f" * ((end - start) // 2)
        else:
            del data[int(rng.choice([start, len(data) // 2, 3, 0])) :]
    return bytes(data)


def mutated_arrays(data, rng):
    """A ``.npy`` or ``.npz`` file (bytes) with arrays of other values, shapes, types or names."""
    whole = np.load(io.BytesIO(data))
    is_one = isinstance(whole, np.ndarray)
    arrays = {"": whole} if is_one else dict(whole)
    for _ in range(int(rng.choice([1, 1, 2]))):
        name = sorted(arrays)[int(rng.integers(len(arrays)))]
        arrays[name] = _other_array(arrays[name], rng)
        if not is_one and rng.random() < 0.1:
            arrays[_pick(("time_s", "channel", "subcarrier_hz", "other"), rng)] = arrays.pop(name)
    stream = io.BytesIO()
    if is_one:
        np.save(stream, arrays[""])
    else:
        np.savez(stream, **arrays)
    return stream.getvalue()


_VALUES = (0, -1, 1, np.nan, np.inf, -np.inf, 1e-320, 1e30, 1e300, -1e300, 2**53, 0.5)
_TYPES = ("f2", "f4", "f8", ">f8", "c8", "c16", "i1", "u8", "?", "S4", "U3", "M8[s]", "V8", "g")


def _other_array(array, rng):
    what = rng.integers(8)
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            if what < 3 and array.size:
                out = array.copy()
                at = rng.integers(out.size, size=int(rng.choice([1, 3, out.size])))
                out.reshape(-1)[at] = _pick(_VALUES, rng)
                return out
            if what == 3:
                return array.astype(_pick(_TYPES, rng))
            if what == 4:
                return array[: int(rng.integers(len(array) + 1))]
            if what == 5:
                return array.reshape(_pick(((1, -1), (-1, 1), (-1,), (2, -1), (1, 1, 1, -1)), rng))
            if what == 6:
                return _pick((array[..., None], array.T, array[:0], array[::-1], array * 0), rng)
            return _pick((np.array(7.0), np.array("text"), np.zeros((3, 0)), array[0]), rng)
        except (ValueError, TypeError, OverflowError, IndexError):
            return np.zeros(3)


def _place(data, rng):
    return int(rng.integers(len(data) + 1))


def _pick(choices, rng):
    return choices[int(rng.integers(len(choices)))]


def _flip(data, rng):
    out = bytearray(data or b"x")
    for _ in range(int(rng.integers(1, 8))):
        out[int(rng.integers(len(out)))] ^= 1 << int(rng.integers(8))
    return bytes(out)


def _cut(data, rng):
    return data[: _place(data, rng)]


def _delete(data, rng):
    start = _place(data, rng)
    return data[:start] + data[start + int(rng.integers(1, 60)) :]


def _repeat(data, rng):
    start = _place(data, rng)
    return data[:start] + data[start : start + int(rng.integers(1, 200))] * 2 + data[start:]


def _insert(data, rng):
    start = _place(data, rng)
    return data[:start] + _pick(_TOKENS, rng) + data[start:]


def _replace(pattern, replacements):
    def accident(data, rng):
        found = list(pattern.finditer(data))
        if not found:
            return data
        match = _pick(found, rng)
        return data[: match.start()] + _pick(replacements, rng) + data[match.end() :]

    return accident


def _exchange(data, rng):
    """Two words or numbers change places."""
    found = list(_pick((_NUMBER, _WORD), rng).finditer(data))
    if len(found) < 2:
        return data
    a, b = sorted(rng.choice(len(found), 2, replace=False))
    a, b = found[a], found[b]
    return data[: a.start()] + b[0] + data[a.end() : b.start()] + a[0] + data[b.end() :]


def _lines(data, rng):
    lines = data.split(b"\n")
    a, b = (int(i) for i in rng.integers(len(lines), size=2))
    what = rng.integers(3)
    if what == 0:
        del lines[a]
    elif what == 1:
        lines.insert(b, lines[a])
    else:
        lines[a], lines[b] = lines[b], lines[a]
    return b"\n".join(lines)


_ACCIDENTS = (
    _flip,
    _cut,
    _delete,
    _repeat,
    _insert,
    _lines,
    _exchange,
    _replace(_NUMBER, _NUMBERS),
    _replace(_NUMBER, _NUMBERS),
    _replace(_NUMBER, _NUMBERS),
    _replace(_WORD, _TOKENS),
)
