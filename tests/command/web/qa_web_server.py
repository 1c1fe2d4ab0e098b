# SPDX-License-Identifier: GPL-3.0-or-later
"""The server of the page: who may look, what each viewer is sent, and what it watches."""

import json
import urllib.error
import urllib.request
from contextlib import closing

import pytest
from command_runs import refused
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.files.writers import open_writer
from gnuradio.wiforce.io.readings import COLUMNS, SURFACE_COLUMNS
from web_pages import RUN, RawViewer, publishing, serving, touched, untouched
from wiforce_app.web.address import PageAddress
from wiforce_app.web.sources import ROW, FileSource, PageState, ZmqSource, loaded, page_row

TOKEN = "a-token-of-a-test"


class NoSource:
    """A source that has nothing to say."""

    def poll(self, page_state):
        page_state.show({"state": "waiting"})

    def close(self):
        pass


def fetch(url, path="", **headers):
    """Status and text of an answer."""
    try:
        request = urllib.request.Request(url + path, headers=headers)
        with urllib.request.urlopen(request, timeout=300) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode()


def test_page_address_refuses_what_is_no_address_and_port():
    unreachable = "224.0.0.1:80", "255.255.255.255:80", "[ff02::1]:80"
    wrong = "", "0", "65536", "x", "1:2:3", "a b:", "host.example:80", "1.2.3:80", "::80", "[]:80"
    for text in (*wrong, *unreachable):
        with pytest.raises(InputError, match="--web: must be PORT or ADDRESS:PORT"):
            PageAddress.of(text)
    with pytest.raises(
        InputError, match=r"--web: cannot be opened .*, got '\[2001:db8::1\]:18080'"
    ):
        PageAddress("2001:db8::1", 18080).listen()  # of another machine


def test_page_has_a_random_token_beyond_loopback_only():
    for text in ("8080", "localhost:8080", "127.0.0.2:8080", "[::1]:8080"):
        address = PageAddress.of(text)
        assert address.is_loopback and address.token is None and address.accepts("")
    for text in ("*:8080", "192.168.1.20:80", "[2001:db8::1]:80"):
        first, second = PageAddress.of(text), PageAddress.of(text)
        assert len(first.token) == 32 and first.token != second.token
        assert first.accepts(first.token) and not first.accepts(second.token)
        assert not first.accepts("") and "plain HTTP" in first.notice
        assert first.url.endswith(f"?token={first.token}")


def test_page_refuses_a_token_that_is_easily_guessed():
    with pytest.raises(InputError, match="--web-token: must be 16 to 128") as error:
        PageAddress.of("8080", "secret")
    assert "secret" not in str(error.value)


@pytest.mark.parametrize(
    "arguments, words",
    [
        (["readings.txt"], "must be a file .csv or .jsonl, or a ZMQ endpoint"),
        (["r.csv", "--control", "5556"], "--control: needs a ZMQ endpoint as SOURCE"),
        (["tcp://nowhere"], "SOURCE: must be a port from 1 to 65535, or tcp://ADDRESS:PORT"),
        (["other.csv"], "must hold readings, but has no column sensor"),
    ],
)
def test_watch_bad_source_is_refused_in_one_line(arguments, words, tmp_path):
    (tmp_path / "other.csv").write_text("time_s,value\n1,2\n")
    assert words in refused("watch", "--web", "8080", *arguments, cwd=tmp_path)


def test_page_with_token_answers_nobody_without_it():
    """Readings, and the tare button, would be everybody's in the network."""
    with serving(NoSource(), TOKEN) as (url, _):
        for path in ("", "figures.json", "assets/page.js", "bokeh/bokeh.min.js", "readings", "no"):
            for given in ("", "?token=", f"?token={TOKEN}x"):
                status, text = fetch(url, path + given)
                assert status == 403 and "Token missing or wrong" in text and len(text) < 100
        with urllib.request.urlopen(f"{url}?token={TOKEN}", timeout=300) as answer:
            given = answer.headers["Set-Cookie"]
        # Another site could read the token, or press the tare button with it.
        assert TOKEN in given and "HttpOnly" in given and "SameSite=Strict" in given
        cookie = f"gr-wiforce-{url.rstrip('/').rpartition(':')[2]}"
        assert fetch(url, "figures.json", Cookie=f"{cookie}={TOKEN}")[0] == 200
        assert fetch(url, "figures.json", Cookie=f"{cookie}={TOKEN[:-1]}")[0] == 403
        for path, status in (("/readings", 403), (f"/readings?token={TOKEN}", 101)):
            with closing(RawViewer(url, path)) as viewer:
                assert viewer.status == status


def test_page_on_loopback_is_not_for_other_pages():
    """A site in the same browser must not read a page, nor press its tare button."""
    with serving(NoSource()) as (url, _):
        assert fetch(url)[0] == 200
        assert fetch(url, Host="rebound.example")[0] == 403
        assert fetch(url, "assets/../server.py")[0] == 403
        for origin, status in (("http://other.example", 403), (url.rstrip("/"), 101)):
            with closing(RawViewer(url, origin=origin)) as viewer:
                assert viewer.status == status


@pytest.mark.parametrize("name", ["%00", "a%00b.js", "x" * 5000, "%ff", "..%2fserver.py", "%2e%2e"])
def test_page_answers_a_name_that_no_file_can_have_with_4xx(name):
    """A scanner's requests looked like faults of the page."""
    with serving(NoSource()) as (url, _):
        for path in ("", "assets/", "bokeh/"):
            status, text = fetch(url, path + name)
            assert 400 <= status < 500 and len(text) < 100, path


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
    # One message with a number beyond all floats ended the process of the page.
    values = {"time_s": 1.0, "sensor": "arm", "force_n": 1.0}
    assert page_row(loaded(json.dumps(values | {"time_s": 10**400}))) is None
    assert page_row(loaded(json.dumps(values | {"force_n": 10**400})))[ROW.index("force_n")] is None


@pytest.mark.parametrize("suffix", ["csv", "jsonl"])
def test_file_source_follows_a_file_that_grows_and_is_replaced(suffix, tmp_path):
    path = tmp_path / f"readings.{suffix}"
    page_state, source = PageState(30.0), FileSource(path)

    def shown():
        source.poll(page_state)
        return json.loads(page_state.message((-1, 0), status=True))

    assert shown()["status"]["state"] == "waiting"
    with open_writer(path) as writer:
        writer.write(touched(1.0))
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
    path.rename(tmp_path / f"old.{suffix}")
    with open_writer(path) as writer:
        writer.write(touched(0.5))
    assert [row[1] for row in shown()["rows"]] == [0.5]
    header = path.read_text().splitlines(keepends=True)[0] if suffix == "csv" else ""
    path.write_text(header)  # a second run that writes to the same file
    shown()
    with path.open("a") as file:
        file.write(line.replace("3.0", "0.2", 1) + "\n")
    assert [row[1] for row in shown()["rows"]] == [0.2]


def test_file_source_says_that_a_file_has_stopped_growing(tmp_path):
    """The page of a complete file shows no new readings, and seemed to wait for them."""
    now, path, page_state = [0.0], tmp_path / "readings.csv", PageState(30.0)
    source = FileSource(path, now=lambda: now[0])

    def reason(seconds):
        now[0] = seconds
        source.poll(page_state)
        return json.loads(page_state.message((-1, 0), status=True))["status"]["reason"]

    assert reason(20.0) == "the file does not exist yet"
    with open_writer(path) as writer:
        writer.write(touched(1.0))
    assert reason(21.0) == reason(30.0) == ""
    assert reason(31.5).startswith("the file has stopped growing")


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


def test_viewer_that_does_not_read_costs_others_no_reading():
    class Flood(NoSource):
        def poll(self, page_state):
            for _ in range(400):
                time_s = page_state.position[1] / 100
                page_state.add({"sensor": "arm", "time_s": time_s, "flags": "gap " * 40})

    with serving(Flood(), history_s=1e6) as (url, page):
        with closing(RawViewer(url, receive_buffer=4096)), closing(RawViewer(url)) as one:
            times = []
            while len(times) < 20_000:
                times += [row[1] for row in one.message()["rows"]]
            assert len(page.viewers) == 2
    assert times == [number / 100 for number in range(len(times))]


def test_viewers_who_ask_for_a_tare_get_an_answer_each():
    """Two people who press the button at once must both see the outcome, and a flood is one."""
    with publishing() as reader:
        reader.refusal, reader.tare_s = "arm is touched (3.00 N at 40.0 mm)", 0.3
        with serving(ZmqSource(reader.readings, reader.control)) as (url, _):
            with closing(RawViewer(url)) as one, closing(RawViewer(url)) as two:
                for viewer in (one, two, two, two):
                    viewer.send("tare")
                for viewer in (one, two):
                    while "answer" not in (message := viewer.message()):
                        pass
                    assert not message["answer"]["ok"]
                    assert message["answer"]["error"] == f"tare refused: {reader.refusal}"
        assert reader.tares == 2


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


def test_zmq_source_ignores_messages_of_another_kind():
    page_state = PageState(30.0)
    nested = b"[" * 100_000
    with publishing() as reader, closing(ZmqSource(reader.readings)) as source:
        for data in (
            b"[1]",
            b"{",
            nested,
            b'{"message": "reading"}',
            b'{"message": "heartbeat", "time_s": 1e999}',
        ):
            source._take(loaded(data), page_state)
        source.poll(page_state)
    assert json.loads(page_state.message((-1, 0), status=True))["rows"] == []
