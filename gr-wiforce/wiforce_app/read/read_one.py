# SPDX-License-Identifier: GPL-3.0-or-later
"""One capture read to files and pictures, also while it is written."""

from gnuradio.wiforce.io.capture.channel_snapshots import ChannelSnapshots
from gnuradio.wiforce.io.capture.names import is_snapshots
from gnuradio.wiforce.io.files import format_of
from gnuradio.wiforce.io.files.writers import open_writer
from gnuradio.wiforce.io.outputs import Outputs
from gnuradio.wiforce.planning.plan import plan
from gnuradio.wiforce.scene import scene_of

from ..shell.interrupts import Interrupted, uninterrupted
from ..shell.log import log, progress, rows_on_terminal
from ..shell.options import refuse
from ..shell.plots import check_picture
from ..shell.provenance import provenance
from .recordings import SAMPLES_ONLY, open_reader, open_recording, warn_of_end, warn_of_start


def read_one(
    capture, scene_path, outputs, mcap, plot_path, follow, datatype, csi, frame_offset, tracked
):
    if is_snapshots(capture):
        refuse({"--datatype": datatype}, SAMPLES_ONLY)
    if follow:
        from .follow import GrowingCapture, open_growing
    recording = (open_growing if follow else open_recording)(capture, datatype, csi)
    if isinstance(recording, ChannelSnapshots):
        refuse({"--frame-offset": frame_offset is not None, "--follow": follow}, SAMPLES_ONLY)
    scene, differences = scene_of(recording, scene_path)
    settings = plan(scene)
    inputs = [*recording.files, *scene.files]
    check_picture(plot_path, inputs)
    writer = FileOutputs(*_writers(outputs, mcap, inputs, scene), needs_all=follow)
    if follow:
        reader = GrowingCapture(capture, datatype, settings, frame_offset, tracked)
    else:
        reader = open_reader(recording, settings, frame_offset, tracked)
    warn_of_start(recording, reader, scene, differences, frame_offset)
    kept = []
    rows = 0 if follow else reader.groups * len(scene.reading_names)
    try:
        with writer, progress("reading", rows, not rows_on_terminal(outputs)) as step:
            for batch in reader:
                writer.write_all(batch)
                if plot_path is not None:
                    kept += batch
                step(len(batch))
    except KeyboardInterrupt as interrupt:
        raise Interrupted(_partial(writer, outputs, rows)) from interrupt
    warn_of_end(capture, reader)
    if plot_path is not None:
        from ..shell.plots import plot_readings

        length_mm = max(each.model.length_mm for each in settings.sensors)
        plot_readings(kept, plot_path, title=str(capture), length_mm=length_mm)
    wrote = ", ".join(str(path) for path in (*outputs, mcap, plot_path) if path is not None)
    log.info(f"read {reader.counts}" + (f"; wrote {wrote}" if wrote else ""))
    return 0


class FileOutputs(Outputs):
    """Files of readings: an interruption waits until rows are in all of them."""

    def __exit__(self, *error):
        with uninterrupted():
            super().__exit__(*error)

    def write_rows(self, rows):
        with uninterrupted():
            super().write_rows(rows)


def _writers(outputs, mcap, inputs, scene):
    """The writers of the readings files and, where that is asked for, of an MCAP file."""
    forms = [form for output in outputs if (form := format_of(output)) is not None]
    described = mcap is not None or not all(form.text for form in forms)
    metadata = provenance(scene) if described else {}
    for output in outputs or [None]:
        yield open_writer(output, inputs, scene.more_columns, metadata=metadata)
    if mcap is not None:
        from gnuradio.wiforce.io.files.mcap_file import McapWriter

        yield McapWriter(mcap, inputs, metadata, scene.reading_names)


def _partial(writer, outputs, rows):
    """What an interrupted run has written."""
    if not writer.rows:
        return "nothing has been written"
    said = "are partial: they hold" if len(outputs) > 1 else "is partial: it holds"
    return f"{', '.join(outputs) or 'the output'} {said} the first {writer.rows} of {rows} rows"
