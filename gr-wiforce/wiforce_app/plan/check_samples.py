# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce check FILE`` of samples without a scene: levels, bursts and repeated symbols."""

import numpy as np
from gnuradio.wiforce.io.capture.samples import likely_datatype

from .check_advice import advice_on_levels

# Samples that are looked at, the first ones, and the length of a piece whose power is compared.
_MOST_SAMPLES, _PIECE = 4_000_000, 64
# Power above the noise at which a burst begins, and samples of a piece that repeat: 10 dB.
_BURST = 10.0
_CLIPPED = 1 - 2**-11
# Lags at which symbols repeat: short and long training symbols of 802.11 sampled at 20 Msps, the
# second one also that of the project's own frames; and how alike repetitions are at least.
_LAGS, _ALIKE = {16: "short training symbols", 64: "symbols"}, 0.8


def check_samples(capture):
    """What a file of samples is, when no scene says so.

    Returns dict: ``file``, ``levels``, ``bursts``, ``advice`` and ``notes``.
    """
    samples = capture.read(_MOST_SAMPLES)
    finite = np.isfinite(samples)
    samples[~finite] = 0
    rate = capture.sample_rate_hz
    parts = np.abs(samples.view(np.float32).reshape(-1, 2))
    power = np.abs(samples[: len(samples) // _PIECE * _PIECE]).reshape(-1, _PIECE) ** 2
    power = power.mean(axis=1)
    noise = float(np.quantile(power, 0.05)) if len(power) else 0.0
    loud = power > _BURST * max(noise, 1e-30)
    dc = float(np.abs(samples.mean()) ** 2)
    found = {
        "file": {
            "path": str(capture.path),
            "datatype": capture.datatype,
            "likely_datatype": likely_datatype(capture.path),
            "samples": capture.samples,
            "sample_rate_hz": rate,
            "center_frequency_hz": capture.center_frequency_hz,
            "seconds": None if rate is None else capture.span / rate,
            "gaps": len(capture.segments) - 1,
            "samples_lost": capture.span - capture.samples,
        },
        "levels": {
            "peak_dbfs": _db(float(parts.max(initial=0)) ** 2),
            "mean_dbfs": _db(float(np.mean(power)) if len(power) else 0.0),
            "quietest_dbfs": _db(noise),
            "dc_dbfs": _db(dc),
            "clipped": float(np.mean(np.any(parts >= _CLIPPED, axis=1))) if len(parts) else 0.0,
            "not_finite": float(np.mean(~finite)) if len(finite) else 0.0,
        },
        "bursts": {
            "count": int(np.count_nonzero(np.diff(loud.astype(int), prepend=0) == 1)),
            "share": float(np.mean(loud)) if len(loud) else 0.0,
            "repeated": [name for lag, name in _LAGS.items() if _repeats(samples, loud, lag)],
        },
        "tag": None,
    }
    found["notes"] = [
        "without a scene the frames, and thus a tag, cannot be looked for; name one with --scene"
    ]
    found["advice"] = list(_advice(found)) or ["none on levels"]
    return found


def _repeats(samples, loud, lag):
    """Whether loud pieces are equal to what follows them after a lag."""
    best = 0.0
    for piece in np.flatnonzero(loud)[:2000]:
        first = samples[piece * _PIECE : (piece + 1) * _PIECE]
        second = samples[piece * _PIECE + lag : (piece + 1) * _PIECE + lag]
        if len(second) == len(first):
            energy = np.linalg.norm(first) * np.linalg.norm(second)
            best = max(best, float(np.abs(np.vdot(first, second))) / max(float(energy), 1e-30))
    return best > _ALIKE


def _advice(found):
    file = found["file"]
    if file["likely_datatype"] not in (None, file["datatype"]):
        likely = file["likely_datatype"]
        yield f"the values are those of {likely} rather than {file['datatype']}: check the type"
    elif found["levels"]["not_finite"]:
        yield "some samples are NaN or infinite: check what wrote the file"
    yield from advice_on_levels(found["levels"])
    if file["samples_lost"]:
        yield "samples were lost while recording: use a faster machine or larger buffers"


def text(found):
    """The result of :func:`check_samples` for a terminal."""
    file, levels, bursts = found["file"], found["levels"], found["bursts"]
    rate, carrier = file["sample_rate_hz"], file["center_frequency_hz"]
    where = "carrier unknown" if carrier is None else f"carrier {carrier / 1e6:g} MHz"
    long = "rate unknown" if rate is None else f"{rate / 1e6:g} Msps, {file['seconds']:.3g} s"
    symbols = ", ".join(bursts["repeated"]) or "no symbols"
    return "\n".join(
        [
            f"file       {file['path']}: samples, {file['datatype']}",
            f"length     {file['samples']} samples, {long}, {where}, {file['gaps']} gaps",
            f"levels     peak {levels['peak_dbfs']:.1f} dBFS, mean {levels['mean_dbfs']:.1f}, "
            f"quietest {levels['quietest_dbfs']:.1f}, {100 * levels['clipped']:.3g} % clipped",
            f"DC offset  {levels['dc_dbfs']:.1f} dBFS",
            f"signal     {bursts['count']} bursts, {100 * bursts['share']:.0f} % of the time; "
            f"{symbols} repeat",
            *(f"note       {note}" for note in found["notes"]),
            *(f"advice     {advice}" for advice in found["advice"]),
        ]
    )


def _db(power):
    return float(10 * np.log10(max(power, 1e-30)))
