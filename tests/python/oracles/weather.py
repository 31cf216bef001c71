"""An HTTP server with ranges and ETags that does what tests tell it to."""

from __future__ import annotations

import re
import threading
import time
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import unquote


@dataclass
class Weather:
    """What happens to requests."""

    latency: float = 0.0
    """Seconds before each answer."""
    fail_every: int = 0
    """Of so many requests the last is answered by 503."""
    status: int = 0
    """Answer all by this."""
    ranges: bool = True
    etags: bool = True
    if_match: bool = True
    cut: int = 0
    """Bytes that bodies lack; their length is promised."""
    short: int = 0
    """Bytes that are left out of answers, which say so."""
    total: int | None = None
    """The length of the file that answers state."""
    times: int = -1
    """So many requests are treated like this, and the others well; -1 for all."""
    until: float = float("inf")
    """All requests are treated well from this time on, of `time.monotonic`."""


@dataclass
class Server:
    """Files by name, and what was asked for."""

    files: dict[str, bytes]
    weather: Weather = field(default_factory=Weather)
    requests: list[tuple[str, int, int]] = field(default_factory=list)
    """Method, first byte and last byte but one of each."""
    paths: list[str] = field(default_factory=list)
    versions: dict[str, int] = field(default_factory=dict)
    at_once: int = 0
    most_at_once: int = 0

    def __enter__(self) -> Server:
        self.lock = threading.Lock()
        outer = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def log_message(self, *_: object) -> None:
                pass

            def do_HEAD(self) -> None:
                outer.answer(self)

            def do_GET(self) -> None:
                outer.answer(self)

        class Quiet(ThreadingHTTPServer):
            daemon_threads = True

            def handle_error(self, *_: object) -> None:
                """Readers that go away are no news."""

        self.http = Quiet(("127.0.0.1", 0), Handler)
        threading.Thread(target=self.http.serve_forever, args=(0.02,), daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self.http.shutdown()
        self.http.server_close()

    def url(self, name: str) -> str:
        return f"http://127.0.0.1:{self.http.server_port}/{name}"

    def change(self, name: str, data: bytes) -> None:
        self.files[name] = data
        self.versions[name] = self.versions.get(name, 0) + 1

    def answer(self, request: BaseHTTPRequestHandler) -> None:
        with self.lock:
            self.at_once += 1
            self.most_at_once = max(self.most_at_once, self.at_once)
        try:
            self._answer(request)
        finally:
            with self.lock:
                self.at_once -= 1

    def _answer(self, request: BaseHTTPRequestHandler) -> None:
        weather, name = self.weather, unquote(request.path.partition("?")[0].lstrip("/"))
        data = self.files.get(name)
        asked = re.fullmatch(r"bytes=(\d+)-(\d+)", request.headers.get("Range", ""))
        start, end = (int(asked[1]), int(asked[2]) + 1) if asked else (0, len(data or b""))
        with self.lock:
            self.requests.append((request.command, start, min(end, len(data or b""))))
            self.paths.append(request.path)
            number = len(self.requests)
            bad = weather.times != 0 and time.monotonic() < weather.until
            weather.times -= weather.times > 0
        if not bad:
            weather = Weather(latency=weather.latency)
        time.sleep(weather.latency)
        status = 404 if data is None else weather.status
        if weather.fail_every and number % weather.fail_every == 0:
            status = 503
        etag = f'"{self.versions.get(name, 0)}-{len(data or b"")}"'
        if weather.etags and weather.if_match and request.headers.get("If-Match", etag) != etag:
            status = 412
        if status:
            request.send_response(status)
            request.send_header("Content-Length", "0")
            request.end_headers()
            return
        size, body = len(data), data
        end = min(end, size)
        if asked and weather.ranges:
            request.send_response(206)
            end -= weather.short
            body = data[start:end]
            total = size if weather.total is None else weather.total
            request.send_header("Content-Range", f"bytes {start}-{end - 1}/{total}")
        else:
            request.send_response(200)
        if weather.etags:
            request.send_header("ETag", etag)
        request.send_header("Last-Modified", f"Tue, 03 Nov 2026 10:00:{self.versions.get(name, 0):02} GMT")
        request.send_header("Content-Length", str(len(body)))
        if weather.ranges:
            request.send_header("Accept-Ranges", "bytes")
        request.end_headers()
        if request.command == "GET":
            request.wfile.write(body[: len(body) - weather.cut])
            if weather.cut:
                request.close_connection = True
