"""Access to the server, and its answers; these tests render nothing."""

import json
import os
import re
import signal
import threading
import time
from dataclasses import replace
from http.client import HTTPConnection
from pathlib import Path
from queue import SimpleQueue
from types import SimpleNamespace

import pytest
from small_cell import write_cell

from graycast.base.errors import ConfigError, GraycastError
from graycast.cell.config import load_config
from graycast.show.live import Server, serve
from graycast.show.live.asking import Answer
from graycast.show.live.server import GRACE_S
from graycast.show.live.session import Session


@pytest.fixture
def server(tmp_path, monkeypatch):
    monkeypatch.setattr("graycast.show.live.server._BEAT_S", 0.01)  # The server must end quickly.
    with serve(write_cell(tmp_path), port=0, scene_id=0, device="cpu") as running:
        yield running


def response(server, method, path, body=None, **headers):
    connection = HTTPConnection("127.0.0.1", server.port, timeout=10)
    data = None if body is None else json.dumps(body)
    kind = {} if body is None else {"Content-Type": "application/json"}
    connection.request(method, path, data, kind | headers)
    reply = connection.getresponse()
    text = reply.read().decode()
    connection.close()
    return reply.status, text


def test_json_that_is_nested_too_deeply_gets_an_answer(server):
    connection = HTTPConnection("127.0.0.1", server.port, timeout=10)
    for depth in (190, 100_000):
        text = "[" * depth + "]" * depth
        for body in (text, f'{{"do": "set", "key": "exposure", "value": {text[3:-3]}}}'):
            connection.request("POST", "/do", body, {"Content-Type": "application/json"})
            reply = connection.getresponse()
            assert reply.status == 200
            assert "error" in json.loads(reply.read())
    connection.close()


def do(server, **command):
    status, text = response(server, "POST", "/do", command)
    assert status == 200
    return json.loads(text)


def test_the_server_delivers_only_the_page_and_its_scripts(server):
    status, page = response(server, "GET", "/")
    assert status == 200
    for name in re.findall(r'(?:src|href)="(\w+\.\w+)"', page):
        assert response(server, "GET", f"/{name}")[0] == 200, name
    for name in ("live.py", "../server.py", "%2e%2e/server.py", "cell.yaml", "etc/passwd"):
        assert response(server, "GET", f"/{name}")[0] == 404


@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "evil.example"},
        {"Host": "evil.example:{port}"},
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Host": "localhost:{port}", "Origin": "http://127.0.0.1:{port}"},
    ],
)
@pytest.mark.parametrize("method", ["GET", "POST"])
def test_requests_of_other_hosts_and_other_pages_are_refused(server, headers, method):
    sent = {name: value.format(port=server.port) for name, value in headers.items()}
    body = {"do": "undo"} if method == "POST" else None
    assert response(server, method, "/do" if body else "/", body, **sent)[0] == 403


def test_forms_and_large_requests_are_refused(server):
    plain = {"Content-Type": "text/plain"}
    assert response(server, "POST", "/do", {"do": "undo"}, **plain)[0] == 404
    assert response(server, "POST", "/do", None, **{"Content-Length": "99999999"})[0] == 413


@pytest.mark.slow
def test_settings_can_be_set_undone_redone_and_restored(server):
    session = server.session
    assert do(server, do="set", key="exposure.target", value=0.3) == {"number": 1}
    do(server, do="set", key="exposure.target", value=0.4, draft=True)
    do(server, do="set", key="exposure.target", value=0.5, draft=True)
    do(server, do="set", key="exposure.target", value=0.6)
    assert "target: 0.6" in session.state()["text"]
    do(server, do="undo")  # undoes both drafts and the final value
    assert "target: 0.3" in session.state()["text"]
    do(server, do="redo")
    assert "target: 0.6" in session.state()["text"] and session.state()["redo"] == 0
    do(server, do="return", number=1)
    assert "target: 0.3" in session.state()["text"]
    assert session.pid is None  # Without an open page, no picture is made.


@pytest.mark.parametrize(
    ("command", "message"),
    [
        ({"do": "set", "key": "exposure.target", "value": 4}, "exposure.target is 4: it should"),
        ({"do": "set", "key": "code.codec", "value": "morse"}, "code.codec is 'morse'"),
        ({"do": "rewrite", "text": "parts: ["}, "cell.yaml: is not YAML in line 1"),
        ({"do": "rewrite", "text": "count: 3"}, "cell.yaml: parts is missing: add it"),
        ({"do": "set", "key": "rig.baseline", "value": 20}, "have no common field of view"),
        ({"do": "return", "number": 99}, "picture 99 is no longer stored"),
        ({"do": "save", "name": "../cell.yaml"}, "'../cell.yaml' is not a valid file name"),
        ({"do": "save", "name": "cell.yaml"}, "cell.yaml exists already: give another"),
        ({"do": "dance"}, 'the page asked for {"do": "dance"}: reload it'),
    ],
)
def test_a_refused_setting_is_reported_without_any_change(server, command, message):
    before = server.session.state()
    assert message in do(server, **command)["error"]
    assert server.session.state() == before


@pytest.mark.slow
def test_a_file_saved_by_the_same_server_may_be_overwritten(server, tmp_path):
    do(server, do="set", key="rig.power", value=2)
    assert do(server, do="save", name="mine.yaml") == {"saved": str(tmp_path / "mine.yaml")}
    assert (tmp_path / "mine_rig.yaml").exists()
    do(server, do="set", key="count", value=2)
    assert "saved" in do(server, do="save", name="mine.yaml")
    assert "count: 2" in (tmp_path / "mine.yaml").read_text()


def test_a_used_port_and_a_wrong_file_are_reported(server, tmp_path):
    with pytest.raises(GraycastError, match=f"port {server.port} of this machine cannot be opened"):
        Server(tmp_path / "cell.yaml", port=server.port)
    with pytest.raises(ConfigError, match="no such file"):
        Server(tmp_path / "none.yaml")


@pytest.mark.slow
def test_a_saved_file_describes_the_cell_on_the_page(server):
    """`test_line.py` tests that the displayed cell equals that of `make_scene`."""
    for key, value in (("ambient", 2.5), ("rig.power", 0.7), ("rig.toe_in_deg", 0.5)):
        do(server, do="set", key=key, value=value)
    do(server, do="set", key="parts.0.material", value={"roughness": 0.1})
    path = Path(do(server, do="save", name="mine.yaml")["saved"])
    saved, current = load_config(path), server.session._config(server.session._now)
    assert saved.model_dump(exclude={"rig"}) == current.model_dump(exclude={"rig"})
    assert (path.parent / saved.rig).read_bytes() == Path(current.rig).read_bytes()
    assert saved.light.environment.radiance == (0.5, 0.5, 0.5)


@pytest.mark.slow
def test_a_page_opened_later_shows_why_the_picture_is_missing(server, monkeypatch):
    """Without this message, a page whose stream was interrupted would wait for ever."""
    idle = SimpleNamespace(ask=lambda ask: None, stop=lambda: None, pid=1)
    monkeypatch.setattr("graycast.show.live.session.PictureProcess", lambda **_: idle)
    session, refusal = server.session, {"error": "the bin is too small"}

    def heard():
        with server.page() as queue:
            return [queue.get() for _ in range(queue.qsize())]

    def kinds():
        return [message.kind for message in heard()]

    with server.page():
        assert kinds() == ["state"]
        old = Answer(kind="error", number=session.number - 1, header=refusal, arrays={})
        session._answered(old)
        assert kinds() == ["state"]
        session._answered(replace(old, number=session.number))
        assert kinds() == ["state", "error"]
        assert heard()[1].content == refusal | {"number": session.number}  # The page compares it.
        do(server, do="set", key="exposure.target", value=0.3)
        assert kinds() == ["state"]


@pytest.mark.slow
def test_a_page_opened_during_an_answer_receives_the_answer(server, monkeypatch):
    """The answer arrives after the page has read existing answers and before it listens."""
    idle = SimpleNamespace(ask=lambda ask: None, stop=lambda: None, pid=1)
    monkeypatch.setattr("graycast.show.live.session.PictureProcess", lambda **_: idle)
    session = server.session
    newer, threads = session.newer, []
    picture = Answer(kind="picture", number=1, header={}, arrays={"depth": b"0"})

    def newer_and_an_answer(version):
        answers = newer(version)
        threads.append(threading.Thread(target=session._answered, args=(picture,)))
        threads[0].start()
        threads[0].join(0.2)  # The thread does not end if it waits for the page.
        return answers

    monkeypatch.setattr(session, "newer", newer_and_an_answer)
    with server.page() as queue:
        threads[0].join()
        kinds = [queue.get().kind for _ in range(queue.qsize())]
    assert kinds == ["state", "picture"]


@pytest.mark.slow
def test_a_killed_process_is_restarted_only_if_it_finished_a_picture(tmp_path):
    """A killed process stands for a process that crashed or ran out of memory."""
    queue = SimpleQueue()
    session = Session(write_cell(tmp_path), device="cpu", on_message=queue.put)

    def heard(kind):
        while True:
            message = queue.get(timeout=120)
            if message.kind == kind and message.content.get("exact", True):
                return message.content

    session.open()
    heard("picture")
    session.set("exposure.target", 0.3)
    first = session.pid
    os.kill(first, signal.SIGKILL)
    error = heard("error")
    assert "ended by SIGKILL: it was started again" in error["error"] and "number" not in error
    assert session.pid not in (None, first)
    os.kill(session.pid, signal.SIGKILL)  # The process has not finished a picture yet.
    error = heard("error")
    assert "before it finished a picture: undo the" in error["error"]
    assert session.pid is None and error["number"] == session.number
    session.open()  # Reloading the page does the same.
    assert heard("picture")["number"] == session.number
    assert "target: 0.3" in session.state()["text"]
    session.close()
    assert session.pid is None
    while not queue.empty():
        assert queue.get().kind != "error"  # The process was stopped, so it did not crash.


@pytest.mark.slow
def test_the_picture_process_ends_when_the_last_page_is_closed(server):
    threads = threading.active_count()
    pages = []
    for _ in range(2):
        connection = HTTPConnection("127.0.0.1", server.port)
        connection.request("GET", "/events")
        pages.append(connection.getresponse())
        assert pages[-1].readline().startswith(b"data: ")
    pid = server.session.pid
    assert Path(f"/proc/{pid}").exists()
    pages[0].close()
    time.sleep(GRACE_S + 1.5)
    assert server.session.pid == pid  # One page is still open.
    pages[1].close()
    deadline = time.monotonic() + 60
    while Path(f"/proc/{pid}").exists() and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not Path(f"/proc/{pid}").exists() and server.session.pid is None
    while threading.active_count() > threads and time.monotonic() < deadline:
        time.sleep(0.1)
    assert threading.active_count() == threads
