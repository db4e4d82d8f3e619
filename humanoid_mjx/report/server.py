"""Server of a live page: it answers the browsers of this machine, and no page of another site in them."""

import json
import socket
import sys
import threading
import time
from contextlib import suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

LOOPBACK = "127.0.0.1"

LONGEST = 10_000
"""Bytes of a message."""

STREAMS, CONNECTIONS = 16, 256
"""Most streams of frames, and most connections, at a time."""

LATEST_S = 10.0
"""Most time for a request and its answer, and for each frame of a stream, s."""

FULL = f"{STREAMS} windows show this robot already. Close one of them and load this page again.\n"


NO_MESSAGE = ValueError, TypeError, LookupError, AttributeError, ArithmeticError, RecursionError
"""Exceptions of reading what is no message."""


class Server(ThreadingHTTPServer):
    """Server of one page on the loopback interface, which ends connections that are late."""

    def __init__(self, shown: Any, port: int):
        """Serve at a port; 0: any that is free.

        Args:
          shown: what is served, by three methods. `page()` returns the page, bytes; `frames()` yields texts, at least
            one a second, while anybody looks; `take(message)` acts on JSON from the browser, or raises one of
            `NO_MESSAGE`.
          port: of the loopback interface.
        """
        self.shown, self.streams = shown, threading.BoundedSemaphore(STREAMS)
        self.until: dict[socket.socket, float] = {}
        """Time at which each connection ends."""
        super().__init__((LOOPBACK, port), Handler)

    def verify_request(self, request: Any, client_address: Any) -> bool:
        return len(self.until) < CONNECTIONS

    def process_request(self, request: Any, client_address: Any) -> None:
        self.until[request] = time.monotonic() + LATEST_S
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        self.until.pop(request, None)
        super().shutdown_request(request)

    def service_actions(self) -> None:
        """End the connections whose time is over: their threads then read and write no more."""
        for connection, until in list(self.until.items()):
            if time.monotonic() > until:
                with suppress(OSError):
                    connection.shutdown(socket.SHUT_RDWR)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Print what is a fault of the program; a browser that leaves is none."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)


class Handler(BaseHTTPRequestHandler):
    """Answers to one browser."""

    protocol_version = "HTTP/1.1"
    server: Server

    def handle_one_request(self) -> None:
        self._go_on()
        super().handle_one_request()

    def do_GET(self) -> None:
        path = self.path.partition("?")[0]
        if not self._is_for_us():
            self._answer(403)
        elif path == "/":
            self._answer(200, self.server.shown.page(), "text/html; charset=utf-8")
        elif path == "/frames" and self.command == "GET":
            self._stream()
        else:
            self._answer(404)

    do_HEAD = do_GET

    def do_POST(self) -> None:
        length = self.headers.get("Content-Length", "")
        if not self._is_for_us() or self.headers.get("Content-Type") != "application/json":
            self._answer(403)
        elif self.path != "/hands" or not length.isdecimal() or len(length) > 9 or int(length) > LONGEST:
            self._answer(404)
        else:
            try:
                self.server.shown.take(json.loads(self.rfile.read(int(length))))
            except NO_MESSAGE:
                self._answer(400)
            else:
                self._answer(204)

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing of the requests is printed."""

    def _go_on(self) -> None:
        """Let the connection have its time from now on."""
        self.server.until[self.connection] = time.monotonic() + LATEST_S

    def _is_for_us(self) -> bool:
        """Return whether a request names this server as its host, and comes from no page of another site."""
        names = {f"{host}:{self.server.server_address[1]}" for host in (LOOPBACK, "localhost")}
        origin = self.headers.get("Origin")
        return self.headers.get("Host") in names and origin in (None, *(f"http://{name}" for name in names))

    def _stream(self) -> None:
        """Frames as server-sent events, until the browser has gone."""
        if not self.server.streams.acquire(blocking=False):
            return self._answer(503, FULL.encode())
        try:
            self.close_connection = True
            self.send_response(200)
            self.send_header("Content-Type", "text/event-stream")
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            for frame in self.server.shown.frames():
                self.wfile.write(f"data: {frame}\n\n".encode())
                self._go_on()
        finally:
            self.server.streams.release()

    def _answer(self, status: int, content: bytes = b"", kind: str = "text/plain") -> None:
        if status >= 400:
            content = content or f"{HTTPStatus(status).description}\n".encode()
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        if status >= 400:
            self.send_header("Connection", "close")
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(content)
        if status >= 400:  # a browser that still sends would else be cut off before it reads the answer
            self.connection.shutdown(socket.SHUT_WR)
            while self.rfile.read(1 << 16):
                pass
