# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce keys``: keys for the ZMQ sockets of a live reader."""

import click
from gnuradio.wiforce.io.network.zmq_keys import create_keys


@click.command()
@click.argument("folder", type=click.Path())
@click.option(
    "--client",
    default="client",
    show_default=True,
    metavar="NAME",
    help="Name of the client that gets keys.",
)
def keys(folder, client):
    """Make keys for a live reader and a client of it.

    FOLDER is what `live --zmq-keys` takes. The reader gets keys the first time; each further call
    adds a client. Copy FOLDER/server.key and FOLDER/NAME.key_secret to the client. Nothing is
    overwritten, and only the owner can read the files.
    """
    for path in create_keys(folder, client):
        click.echo(path)
