"""Proxy of an S3 server that records requests and refuses some of them."""

import http.client
from collections import Counter
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Lock, Thread
from typing import Self
from urllib.parse import urlsplit

SLOW_DOWN = b"<Error><Code>SlowDown</Code><Message>Please reduce your request rate.</Message></Error>"
_HOP_BY_HOP = ("connection", "transfer-encoding", "content-length", "server", "date")


class Proxy:
    """Proxy on a free port that forwards requests to `target`."""

    def __init__(self, target: str) -> None:
        self.target = urlsplit(target).netloc
        self.seen: list[tuple[str, str]] = []  # method and path, with query
        self.refuse: Callable[[str, str], bool] = lambda method, path: False  # with `refusal`
        self.refusal = (503, SLOW_DOWN)
        self.drop: Callable[[str, str], bool] = lambda method, path: False  # without an answer
        self._lock = Lock()
        self._server = ThreadingHTTPServer(("127.0.0.1", 0), type("Handler", (_Handler,), {"proxy": self}))
        self.url = f"http://127.0.0.1:{self._server.server_port}"

    def __enter__(self) -> Self:
        Thread(target=self._server.serve_forever, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.shutdown()
        self._server.server_close()

    def kinds(self) -> Counter[str]:
        """Return the number of requests by method."""
        return Counter(method for method, _ in self.seen)

    def judge(self, method: str, path: str) -> tuple[bool, bool]:
        """Record a request; return the results of `refuse` and `drop`."""
        with self._lock:
            self.seen.append((method, path))
            return self.refuse(method, path), self.drop(method, path)


class _Handler(BaseHTTPRequestHandler):
    proxy: Proxy
    protocol_version = "HTTP/1.1"

    def handle_any(self) -> None:
        body = self._body()
        refuse, drop = self.proxy.judge(self.command, self.path)
        if drop:
            self.close_connection = True
        elif refuse:
            status, reason = self.proxy.refusal
            self._answer(status, {"Content-Type": "application/xml"}, reason)
        else:
            self._pass_on(body)

    def _body(self) -> bytes:
        if self.headers.get("Transfer-Encoding", "") != "chunked":
            return self.rfile.read(int(self.headers.get("Content-Length", 0)))
        data = b""
        while size := int(self.rfile.readline().split(b";")[0], 16):
            data += self.rfile.read(size)
            self.rfile.readline()
        self.rfile.readline()
        return data

    def _pass_on(self, body: bytes) -> None:
        connection = http.client.HTTPConnection(self.proxy.target)
        headers = {k: v for k, v in self.headers.items() if k.lower() not in _HOP_BY_HOP}
        connection.request(self.command, self.path, body, {**headers, "Content-Length": str(len(body))})
        answer = connection.getresponse()
        kept = {k: v for k, v in answer.getheaders() if k.lower() not in _HOP_BY_HOP}
        size = answer.getheader("Content-Length") if self.command == "HEAD" else None
        self._answer(answer.status, kept, answer.read(), size)
        connection.close()

    def _answer(self, status: int, headers: dict[str, str], body: bytes, size: str | None = None) -> None:
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name, value)
        self.send_header("Content-Length", size or str(len(body)))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def log_message(self, *_: object) -> None: ...


for _method in ("GET", "PUT", "POST", "HEAD", "DELETE"):
    setattr(_Handler, f"do_{_method}", _Handler.handle_any)
