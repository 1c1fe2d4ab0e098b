# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce status`` and ``keys``: health of a live reader, and keys for its ZMQ sockets."""

import json
from functools import partial

import click
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.network.zmq_sockets import ClientKeys, create_keys, request
from gnuradio.wiforce.io.readings import outcome_words

from ..shell.options import FiniteRange, client_keys

# An option that is a time in seconds.
_seconds = partial(
    click.option,
    type=FiniteRange(0, min_open=True),
    default=2.0,
    metavar="S",
)


@click.command()
@click.argument("endpoint")
@click.option("--json", "as_json", is_flag=True, help="Print the reader's whole answer as JSON.")
@_seconds("--max-age", help="Oldest last reading of a sensor that counts as healthy.")
@_seconds("--timeout", help="Time to wait for the answer.")
@client_keys
def status(endpoint, as_json, max_age, timeout, zmq_keys):
    """Print the health of a live reader.

    ENDPOINT is the one given to `live --control`: PORT or tcp://ADDRESS:PORT. The exit status is 0
    if the state is reading, and every sensor has a valid reference and a last reading that is at
    most --max-age old; otherwise 1. It is 2 where the reader does not accept the keys.
    """
    keys = None if zmq_keys is None else ClientKeys.load(zmq_keys)
    text = request(endpoint, "status", timeout, keys=keys)
    try:
        answer = {} if text is None else json.loads(text)
        silent = f"no answer within {timeout:g} s: does `live` run with --control {endpoint}?"
        problems = problems_of(answer, max_age) if answer else [silent]
        lines = list(_lines(answer, problems))
    except (ValueError, LookupError, TypeError, AttributeError) as error:
        rule = "must be the --control endpoint of a reader of this version; it answers otherwise"
        raise InputError(endpoint, rule, text) from error
    if as_json:
        lines = [json.dumps({**answer, "healthy": not problems, "problems": problems})]
    click.echo("\n".join(lines))
    return int(bool(problems))


def problems_of(answer: dict, max_age_s: float) -> list[str]:
    """What is wrong with a reader by its answer to ``status``; empty when it is healthy."""
    if answer.get("ok") is False:
        return [f"status refused: {answer['error']}"]
    problems = []
    if answer.get("state") != "reading":
        reason = f" ({answer['reason']})" if answer.get("reason") else ""
        problems.append(f"state: {answer.get('state', 'unknown')}{reason}")
    for name, sensor in answer.get("sensors", {}).items():
        if sensor["age_s"] is None:
            problems.append(f"{name}: no reading yet")
        elif not sensor["received"] or sensor["age_s"] > max_age_s:
            problems.append(f"{name}: last reading {sensor['age_s']:.1f} s ago")
        if sensor["reference_problem"]:
            problems.append(f"{name}: {sensor['reference_problem']}")
    return problems


def _lines(answer, problems):
    if answer and answer.get("ok") is not False:
        groups = outcome_words(answer["groups"])
        yield f"run {answer['run']}: {answer['state']}, {answer['time_s']:.1f} s, groups: {groups}"
        tare = answer["tare"]
        if tare["state"] != "none":
            yield f"tare {tare['state']}" + (f": {tare['reason']}" if tare["reason"] else "")
    yield from (f"problem: {problem}" for problem in problems)
    if not problems:
        yield "healthy"


@click.command()
@click.argument("folder", type=click.Path())
@click.option(
    "--client",
    default="client",
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
