# SPDX-License-Identifier: GPL-3.0-or-later
"""What ``gr-wiforce check`` advises, of a device and of a capture."""


def advice_on_levels(levels):
    """What to change because of levels, the fields of ``Levels``."""
    peak = levels["peak_dbfs"]
    if levels["clipped"] or peak > -1:
        yield f"the receiver is almost saturated (peak {peak:.1f} dBFS): lower --rx-gain by 6 dB"
    elif peak < -20:
        more = f"raise --rx-gain by {-6 - peak:.0f} dB"
        yield f"the receive level is low (peak {peak:.1f} dBFS): {more}"
    if levels["dc_dbfs"] > -20:
        yield f"the DC offset is high ({levels['dc_dbfs']:.1f} dBFS): calibrate the device"


def advice_on_sensors(tags, scene):
    """What to change because of the tags that were measured (``room_report.measure_tag``)."""
    for tag, sensor in zip(tags, scene.sensors, strict=False):
        yield from _of_sensor(tag, sensor)


def _of_sensor(tag, sensor):
    if tag.clock_offset_ppm is None:
        yield (
            f"{sensor.name}: no tag detected at {sensor.clock_hz:g} Hz: check that it is on and "
            "near enough, and clock_hz in the scene"
        )
        return
    if abs(tag.clock_offset_ppm) > 0.8 * sensor.clock_tolerance_ppm:
        yield (
            f"{sensor.name}: its clock offset is {tag.clock_offset_ppm:+.0f} ppm: raise "
            "clock_tolerance_ppm in the scene"
        )
    errors = tag.phase_error_deg
    if None in errors or max(errors, default=0) > 1.5:
        error = "unknown" if None in errors else f"{max(errors):.1f} deg"
        yield (
            f"{sensor.name}: the expected phase error is {error}: raise "
            "--tx-gain, move the antennas closer, or use longer phase groups"
        )
