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

STREAMS = 16
"""Most streams of frames at a time."""

LATEST_S = 10.0
"""Most time for a request and its answer, and for each frame of a stream, s."""


class Server(ThreadingHTTPServer):
    """Server of a page on the loopback interface."""

    shown: Any
    """Its methods: `page()`, bytes; `frames()`, one text a second or more; `take(message)`, for JSON of a browser."""

    def __init__(self, port: int):
        self.streams = threading.BoundedSemaphore(STREAMS)
        self.handlers: set[Handler] = set()
        super().__init__((LOOPBACK, port), Handler)

    def service_actions(self) -> None:
        """End the connections that are late: their threads then read and write no more."""
        for handler in list(self.handlers):
            if time.monotonic() > handler.until:
                with suppress(OSError):
                    handler.connection.shutdown(socket.SHUT_RDWR)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Print a fault of the program; a browser that leaves is none."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)


class Handler(BaseHTTPRequestHandler):
    """Answers to one browser."""

    protocol_version = "HTTP/1.1"
    server: Server

    def handle_one_request(self) -> None:
        self.until = time.monotonic() + LATEST_S
        self.server.handlers.add(self)
        super().handle_one_request()

    def finish(self) -> None:
        self.server.handlers.discard(self)
        super().finish()

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
            except (ValueError, TypeError, LookupError, AttributeError, ArithmeticError, RecursionError):
                self._answer(400)
            else:
                self._answer(204)

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing of the requests is printed."""

    def _is_for_us(self) -> bool:
        """Return whether a request names this server as its host, and comes from no page of another site."""
        names = {f"{host}:{self.server.server_address[1]}" for host in (LOOPBACK, "localhost")}
        origin = self.headers.get("Origin")
        return self.headers.get("Host") in names and origin in (None, *(f"http://{name}" for name in names))

    def _stream(self) -> None:
        """Frames as server-sent events, until the browser has gone."""
        if not self.server.streams.acquire(blocking=False):
            return self._answer(503, f"{STREAMS} windows show this robot already: close one of them.\n".encode())
        try:
            self.close_connection = True
            self.send_response(200)
            self.send_header("Content-Type", "text/event-stream")
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            for frame in self.server.shown.frames():
                self.wfile.write(f"data: {frame}\n\n".encode())
                self.until = time.monotonic() + LATEST_S
        finally:
            self.server.streams.release()

    def _answer(self, status: int, content: bytes = b"", kind: str = "text/plain") -> None:
        if status >= 400:
            content, self.close_connection = content or f"{HTTPStatus(status).description}\n".encode(), True
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(content)
        if status >= 400:  # read what the browser still sends, else it is cut off before it reads the answer
            self.connection.shutdown(socket.SHUT_WR)
            while self.rfile.read(1 << 16):
                pass
