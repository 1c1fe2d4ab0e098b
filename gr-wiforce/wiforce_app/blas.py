# SPDX-License-Identifier: GPL-3.0-or-later
"""How OpenBLAS, with which NumPy multiplies matrices, is used by the command."""

from pathlib import Path


def settings(cpuinfo=Path("/proc/cpuinfo")):
    """Environment variables of OpenBLAS, read when NumPy is imported.

    One thread, since more only slow down matrices as small as ours. An OpenBLAS that is older than
    the processor falls back to instructions of 2004, four times slower, so those of any processor
    with AVX2 and FMA are stated.

    Examples
    --------
    >>> settings(Path("/nonexistent"))
    {'OPENBLAS_NUM_THREADS': '1'}
    """
    chosen = {"OPENBLAS_NUM_THREADS": "1"}
    try:
        # Only up to the first processor's flags: many processors take long to list.
        with cpuinfo.open(encoding="utf-8", errors="replace") as lines:
            flags = next((line.split() for line in lines if line.startswith("flags")), [])
    except OSError:
        return chosen
    if {"avx2", "fma"} <= set(flags):
        chosen["OPENBLAS_CORETYPE"] = "Haswell"
    return chosen
