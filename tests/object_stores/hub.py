"""Mock server of Hugging Face's hub, for reading and writing data sets."""

import base64
import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import sha1
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qs, unquote, urlsplit


class Hub(ThreadingHTTPServer):
    """Mock hub with data sets in memory."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), _Answers)
        self.repositories: dict[str, dict[str, bytes]] = {}

    @property
    def address(self) -> str:
        """Address for ``HF_ENDPOINT``."""
        return f"http://127.0.0.1:{self.server_port}"


@contextmanager
def served() -> Iterator[Hub]:
    """Context manager with a running hub."""
    with Hub() as hub:
        threading.Thread(target=hub.serve_forever, daemon=True).start()
        yield hub
        hub.shutdown()


class _Answers(BaseHTTPRequestHandler):
    server: Hub
    protocol_version = "HTTP/1.1"

    def log_message(self, *_: object) -> None:
        return

    def do_GET(self) -> None:
        path = unquote(urlsplit(self.path).path).strip("/").split("/")
        if path[:2] == ["api", "datasets"]:
            repository, (request, rest) = "/".join(path[2:4]), (path[4:5], path[6:])
            files = self._files(repository)
            if files is None:
                return
            if request == ["tree"]:
                recursive = parse_qs(urlsplit(self.path).query).get("recursive", ["False"])[0]
                self._tree(files, "/".join(rest), recursive.lower() == "true")
            else:
                names = {"_id": repository, "id": repository}
                self._json({**names, "private": False, "tags": [], "siblings": []})
        else:
            self._file("/".join(path[1:3]), "/".join(path[5:]))

    def do_HEAD(self) -> None:
        self.do_GET()

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
        path = unquote(urlsplit(self.path).path).strip("/").split("/")
        if path[1] == "validate-yaml":
            self._json({"errors": [], "warnings": []})
            return
        files = self._files("/".join(path[2:4]))
        if files is None:
            return
        if path[4] == "paths-info":
            wanted = parse_qs(body.decode())["paths"]
            self._json([entry for each in wanted for entry in _entries(files, each)])
        elif path[4] == "preupload":
            asked = json.loads(body)["files"]
            mode = {"uploadMode": "regular", "shouldIgnore": False}
            self._json({"files": [{"path": file["path"], **mode} for file in asked]})
        else:
            _commit(files, body)
            url = f"{self.server.address}/datasets/{path[2]}/{path[3]}/commit/1"
            self._json({"commitUrl": url, "commitOid": "1"})

    def _files(self, repository: str) -> dict[str, bytes] | None:
        """Return the files of a data set, or send an error and return None if it is missing."""
        found = self.server.repositories.get(repository)
        if found is None:
            self._send(401, b'{"error":"Invalid username or password."}', {"X-Error-Code": "RepoNotFound"})
        return found

    def _tree(self, files: dict[str, bytes], folder: str, recursive: bool) -> None:
        below = f"{folder}/" if folder else ""
        found: dict[str, dict[str, Any]] = {}
        for path in sorted(path for path in files if path.startswith(below)):
            parts = path.removeprefix(below).split("/")
            for depth in range(1, len(parts) + 1) if recursive else (1,):
                each = below + "/".join(parts[:depth])
                found.update({entry["path"]: entry for entry in _entries(files, each)})
        if found:
            self._json(list(found.values()))
        else:
            self._send(404, b'{"error":"no such folder"}', {"X-Error-Code": "EntryNotFound"})

    def _file(self, repository: str, path: str) -> None:
        data = self.server.repositories.get(repository, {}).get(path)
        if data is None:
            self._send(404, b"", {"X-Error-Code": "EntryNotFound"})
            return
        first, last = 0, len(data) - 1
        if asked := self.headers.get("Range"):
            start, _, end = asked.removeprefix("bytes=").partition("-")
            first, last = int(start), min(int(end or last), last)
        head = {"Content-Range": f"bytes {first}-{last}/{len(data)}"} if asked else {}
        self._send(206 if asked else 200, data[first : last + 1], head)

    def _json(self, content: object) -> None:
        self._send(200, json.dumps(content).encode(), {"Content-Type": "application/json"})

    def _send(self, status: int, body: bytes, head: dict[str, str]) -> None:
        self.send_response(status)
        for name, value in {"X-Repo-Commit": "1", "Content-Length": str(len(body)), **head}.items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)


def _entries(files: dict[str, bytes], path: str) -> list[dict[str, Any]]:
    """Return the hub's entry of a file or folder, as a list, which is empty if it is missing."""
    if (data := files.get(path)) is not None:
        return [{"type": "file", "path": path, "size": len(data), "oid": sha1(data).hexdigest()}]
    if any(each.startswith(f"{path}/") for each in files):
        return [{"type": "directory", "path": path, "size": 0, "oid": sha1(path.encode()).hexdigest()}]
    return []


def _commit(files: dict[str, bytes], body: bytes) -> None:
    for line in body.decode().splitlines():
        operation = json.loads(line)
        path = operation["value"].get("path", "")
        if operation["key"] == "file":
            files[path] = base64.b64decode(operation["value"]["content"])
        elif operation["key"] == "deletedFile":
            del files[path]
        elif operation["key"] == "deletedFolder":
            for each in [each for each in files if each.startswith(path)]:
                del files[each]
