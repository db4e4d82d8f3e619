"""The server of a live page: late, leaving and too many browsers. What it serves here is no robot."""

import http.client
import socket
import struct
import threading
import time
from contextlib import contextmanager

import pytest

from humanoid_mjx.report import server as module
from humanoid_mjx.report.server import STREAMS, Server

ASK = b"GET %s HTTP/1.1\r\nHost: 127.0.0.1:%d\r\n\r\n"


class Shown:
    size = 10

    def page(self):
        if not self.size:
            raise ZeroDivisionError("a fault of the program")
        return b"x" * self.size

    def frames(self):
        while True:
            yield "x" * self.size
            time.sleep(0.02)

    def take(self, message):
        """Take anything."""


@pytest.fixture
def served(monkeypatch):
    """A server whose patience is short, and its threads counted."""
    monkeypatch.setattr(module, "LATEST_S", 1.0)
    server = Server(0)
    server.shown = Shown()
    before = threading.active_count()
    thread = threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True)
    thread.start()
    server.port, server.busy = server.server_address[1], lambda: threading.active_count() - before - 1
    yield server
    server.shutdown()
    server.server_close()


@contextmanager
def asking(server, text):
    with socket.create_connection(("127.0.0.1", server.port), timeout=20) as connection:
        connection.sendall(text)
        yield connection


def soon(true):
    latest = time.monotonic() + 20
    while not true():
        assert time.monotonic() < latest, "it did not come"
        time.sleep(0.02)


def test_sixteen_streams_and_no_more(served):
    opened = []
    for _ in range(STREAMS):
        opened.append(connection := socket.create_connection(("127.0.0.1", served.port), timeout=20))
        connection.sendall(ASK % (b"/frames", served.port))
        assert connection.recv(15) == b"HTTP/1.1 200 OK"
    with asking(served, ASK % (b"/frames", served.port)) as further:
        answer = further.makefile("rb").read()
    assert answer.startswith(b"HTTP/1.1 503 ") and b"16 windows show this robot already" in answer
    opened.pop().close()

    def room():
        with asking(served, ASK % (b"/frames", served.port)) as further:
            return further.recv(15) == b"HTTP/1.1 200 OK"

    soon(room)
    for connection in opened:
        connection.close()
    soon(lambda: served.busy() == 0)


@pytest.mark.parametrize(
    "text", [b"", b"GET / HT", b"POST /hands HTTP/1.1\r\nHost: x\r\nContent-Le", b"GET / HTTP/1.1\r\n"]
)
def test_half_a_request_holds_no_thread(served, text, capfd):
    with asking(served, text) as connection:
        assert connection.recv(1) == b""  # the server has ended it
    soon(lambda: served.busy() == 0)
    assert capfd.readouterr().err == ""


def test_a_body_that_never_comes_holds_no_thread(served):
    head = ASK.replace(b"GET", b"POST")[:-2] + b"Content-Type: application/json\r\nContent-Length: 100\r\n\r\n{"
    with asking(served, head % (b"/hands", served.port)) as connection:
        assert connection.makefile("rb").read() in (b"", b"HTTP/1.1 400 Bad Request")
    soon(lambda: served.busy() == 0)


def test_a_request_that_drips_holds_no_thread(served):
    """A byte each tenth of a second: each comes soon, the request does not."""
    with asking(served, b"GET / HTTP/1.1\r\nX: ") as connection, pytest.raises(OSError):
        for _ in range(200):
            connection.sendall(b"x")
            time.sleep(0.1)
    soon(lambda: served.busy() == 0)


def test_a_stream_that_nobody_reads_ends(served):
    served.shown.size = 1 << 20
    with asking(served, ASK % (b"/frames", served.port)):
        soon(lambda: served.busy() == 1)
        soon(lambda: served.busy() == 0)
    assert served.streams.acquire(blocking=False)


@pytest.mark.parametrize("path", [b"/", b"/frames"])
def test_a_browser_that_leaves_prints_nothing(served, path, capfd):
    served.shown.size = 1 << 24
    for _ in range(5):
        with asking(served, ASK % (path, served.port)) as connection:
            connection.recv(100)
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))  # a reset
    soon(lambda: served.busy() == 0)
    assert capfd.readouterr().err == ""


def test_a_fault_of_the_program_is_printed(served, capfd):
    served.shown.size = 0
    with asking(served, ASK % (b"/", served.port)) as connection:
        assert connection.recv(1) == b""
    soon(lambda: served.busy() == 0)
    assert "a fault of the program" in capfd.readouterr().err


@pytest.mark.parametrize("length", ["5" * 5000, "1e3", "-1", "", "1" * 9, "\xb2"])
def test_lengths_that_are_none_are_answered(served, length, capfd):
    """Even a browser that sends on gets the answer."""
    connection = http.client.HTTPConnection("127.0.0.1", served.port, timeout=20)
    connection.putrequest("POST", "/hands")
    connection.putheader("Content-Type", "application/json")
    connection.putheader("Content-Length", length)
    connection.endheaders(b"x" * 3_000_000)
    assert connection.getresponse().status == 404
    connection.close()
    assert capfd.readouterr().err == ""
