# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce watch``: readings of a file or of a live reader, in a browser."""

import math
from pathlib import Path

import click
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.network.zmq_sockets import ClientKeys

from ..shell.commands import GroupedHelp
from ..shell.log import log
from ..shell.options import FiniteRange, client_keys, web_options


@click.command(
    cls=GroupedHelp,
    examples=("watch readings.csv --web 8080", "watch 5555 --control 5556 --web 8080"),
)
@click.argument("source")
@web_options(required=True)
@click.option(
    "--control",
    metavar="ENDPOINT",
    help="Control endpoint of the live reader, for the tare button: PORT or tcp://ADDRESS:PORT.",
)
@client_keys
@click.option(
    "--history",
    type=FiniteRange(1, 86_400),
    metavar="S",
    help="Seconds of signal to scroll back to. Default: 600; all of a file, up to 50 000 readings.",
)
@click.option(
    "--length",
    type=FiniteRange(0, 10_000, min_open=True),
    metavar="MM",
    help="Length of the sensors, where the source does not state it.",
)
def watch(source, web, web_token, control, zmq_keys, history, length):
    """Show readings in browsers, until interrupted.

    SOURCE is a file of readings, .csv or .jsonl, that may still grow, or the endpoint of
    `live --zmq`: PORT or tcp://ADDRESS:PORT.
    """
    from .address import PageAddress

    address = PageAddress.of(web, web_token)
    opened = _open_source(source, control, zmq_keys)
    with address.listen() as listening:
        from .server import HISTORY_S, PageServer, serve_until_signal

        log.info(address.notice)
        if not _is_endpoint(source) and not Path(source).exists():
            log.info(f"waiting for {source}, which does not exist yet")
        kept_s = history or (HISTORY_S if _is_endpoint(source) else math.inf)
        serve_until_signal(lambda: PageServer(opened, address, listening, kept_s, length))
    return 0


def _open_source(source, control, zmq_keys):
    from .sources import FileSource, ZmqSource

    if _is_endpoint(source):
        keys = None if zmq_keys is None else ClientKeys.load(zmq_keys)
        return ZmqSource(source, control, keys)
    for option, value in (("--control", control), ("--zmq-keys", zmq_keys)):
        if value is not None:
            raise InputError(option, "needs a ZMQ endpoint as SOURCE, not a file", value)
    return FileSource(source)


def _is_endpoint(source):
    return source.startswith(("tcp://", "ipc://")) or source.isdecimal()
