# SPDX-License-Identifier: GPL-3.0-or-later
"""The server of the page: who may look, what each viewer is sent, and what it watches."""

import contextlib
import json
import os
import socket
import threading
import time
import urllib.error
import urllib.request
from contextlib import ExitStack, closing
from urllib.parse import urlsplit

import pytest
from command_runs import refused, run_command
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.files.writers import open_writer
from gnuradio.wiforce.io.readings import COLUMNS, SURFACE_COLUMNS
from machine import free_port, wait_until
from web_pages import RUN, RawViewer, publishing, serving, touched, untouched
from wiforce_app.web.address import PageAddress
from wiforce_app.web.page_state import ROW, PageState, loaded, page_row, status_of
from wiforce_app.web.sources import FileSource, ZmqSource

TOKEN = "a-token-of-a-test"
SERVER = "wiforce_app.web.server"  # with Bokeh, which takes 1.5 s


class NoSource:
    """A source that has nothing to say."""

    def fileno(self):
        return None

    def poll(self, page_state):
        page_state.show({"state": "waiting"})

    def close(self):
        pass


class Flood(NoSource):
    """A source with more readings than a viewer's buffers hold."""

    time_s = 0.0

    def poll(self, page_state):
        for _ in range(400):
            self.time_s = round(self.time_s + 0.01, 2)
            page_state.add({"sensor": "arm", "time_s": self.time_s, "flags": "gap " * 20})
        page_state.show({"state": "reading"})


def fetch(url, path="", **headers):
    """Status and text of an answer."""
    try:
        request = urllib.request.Request(url + path, headers=headers)
        with urllib.request.urlopen(request, timeout=300) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode()


@pytest.mark.parametrize(
    "text",
    [
        *("", "0", "70000", "http", "host.example:80", "1.2.3:80", "::80", "-1", " 80", "[]:80"),
        *("224.0.0.1:80", "255.255.255.255:80", "[ff02::1]:80"),
    ],
)
def test_page_address_refuses_what_is_no_address_and_port(text):
    with pytest.raises(InputError, match="--web: must be PORT or ADDRESS:PORT"):
        PageAddress.of(text)


@pytest.mark.parametrize("text", ["8080", "localhost:8080", "127.0.0.2:8080", "[::1]:8080"])
def test_page_on_loopback_needs_no_token(text):
    address = PageAddress.of(text)
    assert address.is_loopback and address.token is None and address.accepts("")


@pytest.mark.parametrize("text", ["*:8080", "0.0.0.0:8080", "192.168.1.20:80", "[2001:db8::1]:80"])
def test_page_beyond_loopback_gets_a_random_token(text):
    first, second = PageAddress.of(text), PageAddress.of(text)
    assert len(first.token) == 32 and first.token != second.token
    assert first.accepts(first.token) and not first.accepts("") and not first.accepts(second.token)
    assert first.url.endswith(f"?token={first.token}") and "plain HTTP" in first.notice


@pytest.mark.parametrize("host", ["203.0.113.1", "2001:db8::1"])
def test_page_at_an_address_of_another_machine_is_refused(host):
    named = f"[{host}]" if ":" in host else host
    with pytest.raises(InputError, match="--web: cannot be opened") as error:
        PageAddress(host, 18080).listen()
    assert str(error.value).endswith(f", got '{named}:18080'")


def test_page_refuses_a_token_that_is_easily_guessed():
    with pytest.raises(InputError, match="--web-token: must be 16 to 128") as error:
        PageAddress.of("8080", "secret")
    assert "secret" not in str(error.value)


def test_watch_port_in_use_is_refused_in_one_line(tmp_path):
    port = free_port()
    with closing(PageAddress.of(str(port)).listen()):
        done = run_command("watch", "--web", port, tmp_path / "readings.csv")
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1
    assert (
        f"--web: cannot be opened (Address already in use), got '127.0.0.1:{port}'" in done.stderr
    )


@pytest.mark.parametrize(
    "arguments, words",
    [
        (["readings.txt"], "must be a file .csv or .jsonl, or a ZMQ endpoint"),
        (["r.csv", "--control", "5556"], "--control: needs a ZMQ endpoint as SOURCE"),
        (["tcp://nowhere"], "SOURCE: must be a port from 1 to 65535, or tcp://ADDRESS:PORT"),
    ],
)
def test_watch_bad_source_is_refused_in_one_line(arguments, words, tmp_path):
    assert words in refused("watch", "--web", "8080", *arguments, cwd=tmp_path)


def test_page_with_token_answers_nobody_without_it():
    """Readings, and the tare button, would be everybody's in the network."""
    with serving(NoSource(), TOKEN) as (url, _):
        for path in ("", "figures.json", "assets/page.js", "bokeh/bokeh.min.js", "readings", "no"):
            for given in ("", "?token=", f"?token={TOKEN}x"):
                status, text = fetch(url, path + given)
                assert status == 403 and "Token missing or wrong" in text and len(text) < 100
        assert fetch(url, f"?token={TOKEN}")[0] == 200
        cookie = f"gr-wiforce-{url.rstrip('/').rpartition(':')[2]}"
        assert fetch(url, "figures.json", Cookie=f"{cookie}={TOKEN}")[0] == 200
        assert fetch(url, "figures.json", Cookie=f"{cookie}={TOKEN[:-1]}")[0] == 403
        for path, status in (("/readings", 403), (f"/readings?token={TOKEN}", 101)):
            with closing(RawViewer(url, path)) as viewer:
                assert viewer.status == status


def test_page_cookie_is_kept_from_scripts_and_other_sites():
    """Another site could read the token, or press the tare button with it."""
    with serving(NoSource(), TOKEN) as (url, _):
        with urllib.request.urlopen(f"{url}?token={TOKEN}", timeout=300) as answer:
            cookie = answer.headers["Set-Cookie"]
    assert TOKEN in cookie and "HttpOnly" in cookie and "SameSite=Strict" in cookie


def test_page_on_loopback_is_not_for_other_pages():
    """A site in the same browser must not read a page, nor press its tare button."""
    with serving(NoSource()) as (url, _):
        assert fetch(url)[0] == 200
        assert fetch(url, Host="rebound.example")[0] == 403
        assert fetch(url, "assets/../server.py")[0] == 403
        for origin, status in (("http://other.example", 403), (url.rstrip("/"), 101)):
            with closing(RawViewer(url, headers=[f"Origin: {origin}"])) as viewer:
                assert viewer.status == status


def test_page_state_keeps_the_history_and_sends_what_a_viewer_lacks():
    page_state = PageState(history_s=10.0)
    for step in range(20):
        page_state.add(untouched(float(step)).row() | {"run": RUN})
    everything = json.loads(page_state.message((-1, 0), status=True))
    assert [row[1] for row in everything["rows"]] == [float(step) for step in range(9, 20)]
    assert everything["restart"] and everything["status"]["run"] == RUN
    position = page_state.position
    assert json.loads(page_state.message(position, status=False))["rows"] == []
    page_state.add(touched(20.0).row())
    more = json.loads(page_state.message(position, status=False))
    assert not more["restart"] and [row[1] for row in more["rows"]] == [20.0]
    # A viewer that fell behind by more than the history begins anew.
    behind = json.loads(page_state.message((position[0], 2), status=False))
    assert behind["restart"] and len(behind["rows"]) == 11


@pytest.mark.parametrize("row", [{"run": "another"}, {"time_s": 0.5}])
def test_page_state_begins_anew_with_another_run(row):
    """Readings of two runs would be drawn over each other."""
    page_state = PageState(history_s=10.0)
    for time_s in (1.0, 2.0):
        page_state.add({"sensor": "arm", "time_s": time_s, "run": RUN})
    position = page_state.position
    page_state.add({"sensor": "arm", "time_s": 3.0, "run": RUN} | row)
    message = json.loads(page_state.message(position, status=False))
    assert message["restart"] and len(message["rows"]) == 1


def test_page_row_takes_numbers_as_text_and_unknown_ones_as_none():
    assert set(ROW) <= {*COLUMNS, *SURFACE_COLUMNS}
    row = dict(zip(ROW, page_row(touched(1.5).row()), strict=True))
    assert row["force_n"] == 3.0 and row["interference"] == 0.25
    text = {key: "" if value is None else str(value) for key, value in touched(1.5).row().items()}
    assert page_row(text) == list(row.values())
    assert page_row({"sensor": "arm", "time_s": "nan"}) is None
    assert page_row({"time_s": 1.0}) is None


@pytest.mark.parametrize("suffix", ["csv", "jsonl"])
def test_file_source_follows_a_file_that_grows_and_is_replaced(suffix, tmp_path):
    path = tmp_path / f"readings.{suffix}"
    now, page_state = [0.0], PageState(30.0)
    source = FileSource(path, now=lambda: now[0])

    def shown():
        source.poll(page_state)
        return json.loads(page_state.message((-1, 0), status=True))

    assert shown()["status"]["state"] == "waiting"
    with open_writer(path) as writer:
        writer.write(touched(1.0))
        assert [row[1] for row in shown()["rows"]] == []  # opened by this call
        assert [row[1] for row in shown()["rows"]] == [1.0]
        writer.write(untouched(2.0))
        message = shown()
        assert [row[1] for row in message["rows"]] == [1.0, 2.0]
        assert message["status"]["state"] == "reading"
    line = path.read_text().splitlines()[-1].replace("2.0", "3.0", 1)
    with path.open("a") as file:
        file.write(line[:20])
        file.flush()
        assert len(shown()["rows"]) == 2
        file.write(line[20:] + "\n")
    assert [row[1] for row in shown()["rows"]] == [1.0, 2.0, 3.0]
    now[0] = 10.0
    message = shown()["status"]
    assert (message["state"], message["reason"]) == ("paused", "the file has not grown for 10 s")
    path.rename(tmp_path / f"old.{suffix}")
    with open_writer(path) as writer:
        writer.write(touched(0.5))
    shown()
    assert [row[1] for row in shown()["rows"]] == [0.5]
    source.close()


def test_file_source_reads_a_file_that_became_shorter_from_its_start(tmp_path):
    """A second run that writes to the same file would not be shown."""
    path, page_state = tmp_path / "readings.jsonl", PageState(30.0)
    lines = [json.dumps({"time_s": time_s, "sensor": "arm"}) + "\n" for time_s in (5.0, 6.0, 1.0)]
    path.write_text("".join(lines[:2]))
    source = FileSource(path)
    source.poll(page_state)
    path.write_text(lines[2])
    for _ in range(2):  # it is noticed by one call, and read by the next
        source.poll(page_state)
    rows = json.loads(page_state.message((-1, 0), status=False))["rows"]
    assert [row[1] for row in rows] == [1.0]
    source.close()


def test_file_source_reads_only_the_end_of_a_long_file(tmp_path, monkeypatch):
    """A file of a month would keep the page busy for minutes."""
    monkeypatch.setattr("wiforce_app.web.sources._TAIL_BYTES", 2000)
    path, page_state = tmp_path / "readings.csv", PageState(1e9)
    with open_writer(path) as writer:
        for step in range(1000):
            writer.write(untouched(float(step)))
    source = FileSource(path)
    source.poll(page_state)
    times = [row[1] for row in json.loads(page_state.message((-1, 0), status=False))["rows"]]
    assert 20 < len(times) < 100 and times == [float(step) for step in range(1000)][-len(times) :]
    source.close()


@pytest.mark.parametrize("suffix", ["csv", "jsonl"])
def test_file_source_skips_damaged_lines(suffix, tmp_path):
    """A power failure leaves such lines in the middle of a file."""
    path, page_state = tmp_path / f"readings.{suffix}", PageState(30.0)
    with open_writer(path) as writer:
        writer.write(untouched(1.0))
        with path.open("ab") as file:
            file.write(b'\0\xff"' + b"[" * 200_000 + b"\n\n{}\nnull\n" + b"x," * 90_000 + b"\n")
        writer.write(untouched(2.0))
    source = FileSource(path)
    source.poll(page_state)
    rows = json.loads(page_state.message((-1, 0), status=False))["rows"]
    assert [row[1] for row in rows] == [1.0, 2.0]
    source.close()


def test_file_source_refuses_a_file_that_holds_no_readings(tmp_path):
    path = tmp_path / "other.csv"
    path.write_text("time_s,value\n1,2\n")
    with pytest.raises(InputError, match="must hold readings, but has no column sensor"):
        FileSource(path)


def test_stalled_viewer_is_dropped_and_others_get_every_reading(monkeypatch):
    """One laptop that was closed must not fill the memory of the robot."""
    monkeypatch.setattr(f"{SERVER}.STALLED_S", 0.5)

    with serving(Flood(), history_s=1000.0) as (url, page):
        with (
            closing(RawViewer(url, receive_buffer=4096)) as stalled,
            closing(RawViewer(url)) as one,
        ):
            assert stalled.status == one.status == 101
            times, deadline = [], time.monotonic() + 60
            while len(page.viewers) < 2 or not times:
                times += [row[1] for row in one.message()["rows"]]
            while len(page.viewers) > 1:
                times += [row[1] for row in one.message()["rows"]]
                assert time.monotonic() < deadline, "the stalled viewer is still there"
            for _ in range(3):
                times += [row[1] for row in one.message()["rows"]]
            assert len(page.viewers) == 1
    assert times == sorted(set(times)) and len(times) == round(100 * (times[-1] - times[0])) + 1


def test_viewer_that_pings_and_does_not_read_is_dropped():
    """The answers to its pings would fill the memory of the robot."""
    with serving(Flood(), history_s=1000.0) as (url, page):
        with closing(RawViewer(url, receive_buffer=4096)) as stalled:
            deadline = time.monotonic() + 60
            while not page.viewers:
                time.sleep(0.01)
            while page.viewers:
                assert time.monotonic() < deadline, "the viewer is still there"
                with contextlib.suppress(OSError):
                    stalled.ping()
                time.sleep(0.01)


@pytest.mark.parametrize(
    "frames",
    [
        pytest.param(bytes([0x8A, 0x80, 0, 0, 0, 0]), id="pongs"),
        pytest.param(bytes([0x81, 0x81, 0, 0, 0, 0, 0x78]), id="texts"),
        pytest.param(bytes([0x00, 0x80, 0, 0, 0, 0]), id="fragments"),
    ],
)
def test_viewer_that_sends_without_a_pause_does_not_delay_others(frames):
    """One viewer kept the page from sending anything to anybody, and from ending."""
    ending = threading.Event()

    def flood(viewer):
        viewer.send_raw(bytes([0x01, 0x80, 0, 0, 0, 0]) if frames[0] == 0 else b"")
        with contextlib.suppress(OSError):
            while not ending.is_set():
                viewer.send_raw(frames * 20_000)

    with serving(Flood()) as (url, _):
        with closing(RawViewer(url)) as flooding, closing(RawViewer(url)) as one:
            one.message()
            thread = threading.Thread(target=flood, args=(flooding,))
            thread.start()
            try:
                time.sleep(0.5)
                end = time.monotonic() + 60
                messages = 0
                while messages < 10 and time.monotonic() < end:
                    one.message()
                    messages += 1
                assert messages == 10
            finally:
                ending.set()
                flooding.shut()
                thread.join()


@pytest.mark.parametrize("request_line", ["GET /bokeh/bokeh.min.js", "POST /"])
def test_connection_that_neither_reads_nor_sends_is_closed(request_line, monkeypatch):
    """Some hundred of them kept everybody else out, as long as they were open."""
    monkeypatch.setattr(f"{SERVER}.STALLED_S", 0.5)
    monkeypatch.setattr(f"{SERVER}._IDLE_S", 0.5)
    with serving(NoSource()) as (url, _):
        before = len(os.listdir("/proc/self/fd"))
        with closing(socket.socket()) as client:
            client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
            client.connect((urlsplit(url).hostname, urlsplit(url).port))
            head = f"{request_line} HTTP/1.1\r\nHost: localhost\r\n".encode()
            if "POST" in request_line:
                client.sendall(head + b"Content-Length: 9\r\n\r\n")
            else:
                client.sendall((head + b"\r\n") * 8)  # more than the system stores
            deadline = time.monotonic() + 2
            while len(os.listdir("/proc/self/fd")) <= before + 1 and time.monotonic() < deadline:
                time.sleep(0.01)
            wait_until(lambda: len(os.listdir("/proc/self/fd")) <= before + 1)


def test_history_is_sent_in_parts_of_limited_size():
    """Of each viewer that stalls, one message waits: megabytes where groups are short."""
    page_state = PageState(history_s=1e9)
    for step in range(5000):
        page_state.add({"sensor": "arm", "time_s": float(step), "run": RUN})
    position, times, parts = (-1, 0), [], []
    while position != page_state.position:
        message = json.loads(page_state.message(position, status=False))
        position = page_state.position_after(position)
        times += [row[1] for row in message["rows"]]
        parts.append((message["restart"], len(message["rows"])))
    assert parts == [(True, 2000), (False, 2000), (False, 1000)]
    assert times == [float(step) for step in range(5000)]


def test_viewers_that_ask_and_leave_are_forgotten():
    """With a reader that hangs, each left sockets for a minute; a forced tare was not asked for."""
    with socket.create_server(("127.0.0.1", 0)) as hung:
        source = ZmqSource(str(free_port()), str(hung.getsockname()[1]))
        with serving(source) as (url, page):
            for _ in range(3):
                with closing(RawViewer(url)) as viewer:
                    for word in ("tare", "tare", "tare force"):
                        viewer.send(word)
                    wait_until(lambda: len(source._asked) == 2)
                    assert {forced for _, forced in source._asked} == {False, True}
                wait_until(lambda: not source._asked and not page.viewers)


def test_viewers_beyond_the_limit_are_refused_with_the_reason(monkeypatch):
    monkeypatch.setattr(f"{SERVER}._MOST_VIEWERS", 2)
    with serving(NoSource()) as (url, page):
        with (
            closing(RawViewer(url)) as first,
            closing(RawViewer(url)),
            closing(RawViewer(url)) as third,
        ):
            assert first.message()["status"]["state"] == "waiting"
            assert third.message() is None and len(page.viewers) == 2


@pytest.mark.parametrize("limited", ["descriptors", "connections"])
def test_connections_beyond_the_limit_are_closed_and_others_served(limited, monkeypatch):
    """Whoever opened a thousand connections filled the journal with tracebacks, without a token."""
    with serving(NoSource(), TOKEN) as (url, _):
        # Of each connection, this process has both ends. Free descriptors below are taken first.
        most = max(int(name) for name in os.listdir("/proc/self/fd")) + 20
        descriptors = 2 * most if limited == "descriptors" else 1 << 20  # as in containers
        monkeypatch.setattr(f"{SERVER}.resource.getrlimit", lambda _: (descriptors,) * 2)
        if limited == "connections":
            monkeypatch.setattr(f"{SERVER}._MOST_DESCRIPTORS", most)
        place = (urlsplit(url).hostname, urlsplit(url).port)
        with ExitStack() as stack:
            opened = []
            for _ in range(most // 2 + 20):
                opened.append(stack.enter_context(socket.create_connection(place, 10)))
                if len(opened) == 1:
                    fetch(url)  # accepted behind the first, which has a low descriptor then
            assert opened[-1].recv(1) == b""
            opened[0].sendall(b"GET / HTTP/1.0\r\n\r\n")
            assert opened[0].recv(12) == b"HTTP/1.1 403"
        assert fetch(url, f"?token={TOKEN}")[0] == 200


def test_viewers_who_ask_for_a_tare_get_an_answer_each():
    """Two people who press the button at once must both see the outcome, and a flood is one."""
    with publishing() as reader:
        reader.refusal = "arm is touched (3.00 N at 40.0 mm)"
        with serving(ZmqSource(reader.readings, reader.control)) as (url, _):
            with closing(RawViewer(url)) as one, closing(RawViewer(url)) as two:
                for viewer in (one, two, two, two):
                    viewer.send("tare")
                for viewer in (one, two):
                    while "answer" not in (message := viewer.message()):
                        pass
                    assert not message["answer"]["ok"]
                    assert message["answer"]["error"] == f"tare refused: {reader.refusal}"
        assert 2 <= reader.tares <= 4


def test_zmq_source_keeps_the_end_of_a_run_after_the_reader_is_silent():
    """A run that ended in order would be shown as lost."""
    now, page_state = [0.0], PageState(30.0)

    def status(seconds):
        now[0] = seconds
        source.poll(page_state)
        return json.loads(page_state.message((-1, 0), status=True))["status"]

    with closing(ZmqSource("5999", now=lambda: now[0])) as source:
        source._take({"message": "heartbeat", "state": "reading"}, page_state)
        assert (status(1.0)["state"], status(3.0)["state"]) == ("reading", "lost")
        assert status(5.4)["reason"].startswith("no messages for 5 s")
        source._take({"message": "end", "state": "ended"}, page_state)
        assert status(60.0)["state"] == "ended"


@pytest.mark.parametrize(
    "data",
    [
        b"[1]",
        b"{",
        pytest.param(b"[" * 100_000, id="nested"),
        b'{"message": "reading"}',
        b'{"message": "heartbeat", "time_s": 1e999}',
    ],
)
def test_zmq_source_ignores_messages_of_another_kind(data):
    page_state = PageState(30.0)
    with publishing() as reader, closing(ZmqSource(reader.readings)) as source:
        source._take(loaded(data), page_state)
        source.poll(page_state)
        assert json.loads(page_state.message((-1, 0), status=True))["rows"] == []


@pytest.mark.parametrize("name", ["time_s", "force_n"])
@pytest.mark.parametrize("suffix", ["csv", "jsonl"])
def test_number_beyond_all_floats_does_not_end_the_page(name, suffix, tmp_path):
    """One such message or row ended the process of the page."""
    values = {"message": "reading", "time_s": 1.0, "sensor": "arm", "force_n": 1.0} | {
        name: 10**400
    }
    shown = [] if name == "time_s" else [[1.0, None]]
    page_state = PageState(30.0)
    with closing(ZmqSource("5999")) as source:
        source._take(loaded(json.dumps(values).encode()), page_state)
    rows = json.loads(page_state.message((-1, 0), status=False))["rows"]
    assert [[row[1], row[3]] for row in rows] == shown
    path, page_state = tmp_path / f"readings.{suffix}", PageState(30.0)
    header = ",".join(values) + "\n" + ",".join(str(value) for value in values.values())
    path.write_text((header if suffix == "csv" else json.dumps(values)) + "\n")
    with closing(FileSource(path)) as source:
        source.poll(page_state)
    rows = json.loads(page_state.message((-1, 0), status=False))["rows"]
    assert [[row[1], row[3]] for row in rows] == shown


def test_heartbeat_of_any_depth_does_not_end_the_page():
    """A list that could just be read could not be written any more, which ended the page."""
    for depth in range(900, 1000):
        data = b'{"message": "heartbeat", "sensors": ' + b"[" * depth + b"]" * depth + b"}"
        page_state = PageState(30.0)
        with closing(ZmqSource("5999")) as source:
            source._take(loaded(data), page_state)
            source.poll(page_state)
        assert json.loads(page_state.message((-1, 0), status=True))["status"]["sensors"] == {}


def test_heartbeat_of_wrong_types_is_shown_without_them():
    """The browser stopped at the first status that it could not draw."""
    surface = {"name": "skin", "strips": [{"x_mm": [0, 80], "y_mm": 5}], "y_span_mm": [0, 10]}
    good = {
        "state": "reading",
        "reason": "",
        "scene": "hand",
        "time_s": 1.0,
        "tare": {"state": "refused", "forced": True, "reason": "arm is touched", "time_s": 1.0},
        "sensors": {
            "arm": {"age_s": 0.1, "received": True, "reference_problem": "", "length_mm": 80.0}
        },
        "surface": surface,
        "gaps": 1,
        "groups": {"dropped": 2},
    }
    assert status_of(good) == good
    for bad in (5, "text", [[]], {"arm": 5, "strips": 5}, True, None):
        shown = status_of(dict.fromkeys(good, bad))
        assert isinstance(shown["state"], str) and isinstance(shown["reason"], str)
        assert all(health == {} for health in shown["sensors"].values())
        assert shown["surface"] is None
    assert (
        status_of({"surface": {**surface, "strips": [{"x_mm": [0], "y_mm": 5}]}})["surface"] is None
    )
    long = status_of({"reason": "x" * 100_000, "sensors": {str(i): {} for i in range(10_000)}})
    assert len(json.dumps(long)) < 10_000


@pytest.mark.parametrize("text", ["x" * 5000, ["arm"], {"a": 1}])
def test_reading_with_another_text_is_ignored(text):
    """The history would hold, and send to all viewers, whatever was published."""
    assert page_row({"sensor": text, "time_s": 1.0}) is None
    assert page_row({"sensor": "arm", "time_s": 1.0, "flags": text}) is None


def test_sensors_beyond_the_limit_are_ignored():
    """Names without end filled the memory, and every status had all of them."""
    page_state = PageState(30.0)
    for number in range(1000):
        page_state.add({"sensor": f"s{number}", "time_s": 1.0})
    page_state.add({"sensor": "s0", "time_s": 2.0})
    message = json.loads(page_state.message((-1, 0), status=True))
    assert len(message["status"]["ages"]) == 256 and len(message["rows"]) == 257


def test_run_that_is_no_text_does_not_begin_a_new_history():
    page_state = PageState(30.0)
    for step in range(3):
        page_state.add({"sensor": "arm", "time_s": float(step), "run": 5})
    assert len(json.loads(page_state.message((-1, 0), status=False))["rows"]) == 3
