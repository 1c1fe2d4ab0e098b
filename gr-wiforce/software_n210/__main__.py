# SPDX-License-Identifier: GPL-3.0-or-later
"""``python3 -m software_n210``: the device by itself."""

import sys

import click
from gnuradio.wiforce.errors import InputError

from .command import emulate

if __name__ == "__main__":
    try:
        emulate(prog_name="software_n210")
    except InputError as error:
        click.echo(f"software_n210: {error}", err=True)
        sys.exit(2)
