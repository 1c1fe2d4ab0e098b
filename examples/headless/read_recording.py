#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Read a capture and write its readings to a file.

The same as read_recording.grc, without a window:

    build/run gr-wiforce simulate tabletop table
    build/run python3 examples/headless/read_recording.py table readings.csv tabletop
"""

from command_line import start
from gnuradio import gr, wiforce
from gnuradio.wiforce.io.capture import open_capture


def main(capture, output, scene):
    capture, scene = open_capture(capture), wiforce.load_scene(scene)
    flowgraph = gr.top_block("read_recording", catch_exceptions=False)
    source = wiforce.capture_source(capture, scene)
    inputs = [*capture.files, *scene.files]  # the output must be none of them
    with wiforce.open_writer(output, inputs) as writer:
        reader = wiforce.reader(scene, input_type="folded", on_reading=writer.write)
        flowgraph.connect(source, reader)
        flowgraph.run()
        if reader.failure is not None:
            raise reader.failure


if __name__ == "__main__":
    start(main, "CAPTURE READINGS.csv SCENE", (3,))
