"""The server of the page: only this machine can reach it, and only its own pages can use it.

It listens on the loopback address. The check of the Host header refuses a foreign page whose domain
name points to this address, and the check of the Origin header refuses pages of other origins.
There is no password: anyone with an account on this machine can open the page.
"""

import json
import select
import socket
import struct
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cache
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

from ...base.errors import GraycastError, error_line
from ...base.file_limits import parse_json
from ..report.page.packing import color_table, reason_records, report_script
from .asking import Answer
from .session import Message, Session

HOST = "127.0.0.1"
GRACE_S = 2.0  # time after which a session without pages is paused; reloading a page is faster
MOST_BYTES = 1_000_000  # largest size of a request
_BEAT_S = 0.25  # interval at which a page's stream checks whether the page is still open

_SHARED = ("core.js", "geometry.js", "paint.js", "viewer.js", "shapes.js", "cloud.js", "style.css")
_OWN = (
    *("index.html", "live.css", "state.js", "controls.js", "world.js", "connection.js"),
    *("pictures.js", "views.js", "figures.js", "settings.js", "live.js"),
)
_COLORMAPS = ("viridis_r", "viridis", "RdBu_r", "gray", "magma")
_TYPES = {".html": "text/html", ".js": "text/javascript", ".css": "text/css"}
_POLICY = "default-src 'self'; img-src 'self' data:; style-src 'self' 'unsafe-inline'"


class Server:
    """The server of a session's pages; it keeps no pictures while no page is open."""

    def __init__(self, path: Path, *, port: int = 0, scene_id: int = 0, device: str = "auto"):
        """Read the configuration and open the port.

        Raises:
            ConfigError: see `load_config`.
            GraycastError: the port is in use.
        """
        self.session = Session(path, scene_id=scene_id, device=device, on_message=self._tell)
        self._pages: list[SimpleQueue[Message]] = []
        self._lock = threading.Lock()
        self._turn = threading.Lock()  # This lock serialises opening and pausing of the session.
        self._pause: threading.Timer | None = None
        try:
            self._http = _Http((HOST, port), _Handler)
        except OSError as error:
            self.session.close()
            raise GraycastError(
                f"port {port} of this machine cannot be opened ({error.strerror}): give another "
                "--port, or end the program that uses it"
            ) from error
        self._http.live = self
        self.port = self._http.server_address[1]
        self.url = f"http://{HOST}:{self.port}/"

    def run(self) -> None:
        """Serve until `close` is called, or the program is interrupted."""
        self._http.serve_forever(poll_interval=_BEAT_S)

    def close(self) -> None:
        """End `run`, which runs in a different thread."""
        self._http.shutdown()
        self.release()

    def release(self) -> None:
        """Release all resources after `run` has ended."""
        self._http.server_close()
        with self._turn:
            if self._pause is not None:
                self._pause.cancel()
            self.session.close()

    # --- pages --------------------------------------------------------------------------------

    @contextmanager
    def page(self) -> Iterator["SimpleQueue[Message]"]:
        """Add a listening page; pause the session some time after the last page is closed."""
        queue: SimpleQueue[Message] = SimpleQueue()
        with self._turn:
            if self._pause is not None:
                self._pause.cancel()
            self.session.open()
            with self.session.standing_still():  # No answer may arrive between these calls.
                queue.put(Message(kind="state", content=self.session.state()))
                for version, answer in self.session.newer(0):
                    queue.put(Message(kind=answer.kind, content={"version": version}))
                if (refusal := self.session.refusal) is not None:
                    queue.put(refusal)
                with self._lock:
                    self._pages.append(queue)
        try:
            yield queue
        finally:
            with self._lock:
                self._pages.remove(queue)
                left = len(self._pages)
            if not left:
                self._pause = threading.Timer(GRACE_S, self._pause_if_alone)
                self._pause.daemon = True
                self._pause.start()

    def _pause_if_alone(self) -> None:
        with self._turn:
            with self._lock:
                alone = not self._pages
            if alone:
                self.session.pause()

    def _tell(self, message: Message) -> None:
        with self._lock:
            for queue in self._pages:
                queue.put(message)

    # --- commands of a page -------------------------------------------------------------------

    def do(self, command: Any) -> dict[str, Any]:
        """Execute one command of the user, and return the result for the user's page.

        Raises:
            GraycastError, ValueError: the command is not possible; nothing has changed.
        """
        session = self.session
        match command:
            case {"do": "set", "key": str(key), "value": value}:
                session.set(key, value, draft=command.get("draft") is True)
            case {"do": "rewrite", "text": str(text)}:
                session.rewrite(text)
            case {"do": "undo"}:
                session.undo()
            case {"do": "redo"}:
                session.undo(-1)
            case {"do": "return", "number": int(number)}:
                session.return_to(number)
            case {"do": "look", "frame": int(frame)}:
                session.look(frame)
            case {"do": "save", "name": str(name)}:
                return {"saved": str(session.save(name))}
            case _:
                raise GraycastError(f"the page asked for {json.dumps(command)[:200]}: reload it")
        return {"number": session.number}


@contextmanager
def serve(path: Path, *, port: int, scene_id: int, device: str) -> Iterator[Server]:
    """Yield a server that runs in its own thread during the block."""
    server = Server(path, port=port, scene_id=scene_id, device=device)
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    try:
        yield server
    finally:
        server.close()
        thread.join()


class _Http(ThreadingHTTPServer):
    live: Server
    daemon_threads = True
    block_on_close = False  # A stream ends when its page or the program is closed.

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore errors from pages that close during an answer."""


class _Handler(BaseHTTPRequestHandler):
    """A handler for one request from a browser."""

    server: _Http
    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True

    def do_GET(self) -> None:
        if not self._is_ours():
            return
        name, _, query = self.path.partition("?")
        name = name.lstrip("/") or "index.html"
        if name == "events":
            self._stream()
        elif name == "newer" and query.isdecimal():
            self._send(
                _packed(self.server.live.session.newer(int(query))), "application/octet-stream"
            )
        elif name == "about.js":
            self._send(_about(), _TYPES[".js"])
        elif name in _OWN or name in _SHARED:
            package = "graycast.show.report.page" if name in _SHARED else "graycast.show.live"
            body = resources.files(package).joinpath("web", name).read_bytes()
            self._send(body, _TYPES[Path(name).suffix])
        else:
            self._refuse(HTTPStatus.NOT_FOUND, f"the page has no file {name}")

    def do_POST(self) -> None:
        if not self._is_ours():
            return
        length = self.headers.get("Content-Length", "")
        if not length.isdecimal() or int(length) > MOST_BYTES:
            self.close_connection = True
            self._refuse(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, "too much was sent")
            return
        body = self.rfile.read(int(length))
        if self.path != "/do" or self.headers.get_content_type() != "application/json":
            self._refuse(HTTPStatus.NOT_FOUND, "send JSON to /do")
            return
        try:
            answer = self.server.live.do(_command(body))
        except (GraycastError, ValueError, OSError) as error:
            answer = {"error": error_line(error)}
        self._send(json.dumps(answer).encode(), "application/json")

    def _is_ours(self) -> bool:
        """Return whether a page of this server sent the request, under the server's own name."""
        names = {f"{name}:{self.server.live.port}" for name in (HOST, "localhost")}
        host, origin = self.headers.get("Host"), self.headers.get("Origin")
        if host in names and origin in (None, f"http://{host}"):
            return True
        self.close_connection = True
        self._refuse(HTTPStatus.FORBIDDEN, f"open {self.server.live.url}")
        return False

    def _stream(self) -> None:
        """Send all messages, one per line, while the page is open."""
        self.close_connection = True
        self._head(HTTPStatus.OK, "text/event-stream", None)
        with self.server.live.page() as queue, suppress(OSError):
            while not _is_gone(self.connection):
                with suppress(Empty):
                    message = queue.get(timeout=_BEAT_S)
                    text = json.dumps({"kind": message.kind, **_kindless(message.content)})
                    self.wfile.write(f"data: {text}\n\n".encode())

    def _send(self, body: bytes, content_type: str) -> None:
        self._head(HTTPStatus.OK, content_type, len(body))
        self.wfile.write(body)

    def _refuse(self, status: HTTPStatus, text: str) -> None:
        body = text.encode()
        self._head(status, "text/plain", len(body))
        self.wfile.write(body)

    def _head(self, status: HTTPStatus, content_type: str, length: int | None) -> None:
        self.send_response(status)
        self.send_header("Content-Type", f"{content_type}; charset=utf-8")
        if length is not None:
            self.send_header("Content-Length", str(length))
        self.send_header("Cache-Control", "no-store")
        self.send_header("Content-Security-Policy", _POLICY)
        self.send_header("X-Content-Type-Options", "nosniff")
        self.end_headers()

    def log_message(self, format: str, *args: Any) -> None:
        """Print nothing for a request."""


@cache
def _about() -> bytes:
    """Return the data that a page needs before the first picture."""
    return report_script(
        {
            "reasons": reason_records(),
            "colormaps": {name: color_table(name) for name in _COLORMAPS},
            "scanners": {},
            "statistics": {"part_error": {"sigma_mm": None}},
        }
    )


def _command(body: bytes) -> Any:
    try:
        return parse_json(body)
    except ValueError as error:
        raise GraycastError(f"what the page sent is not JSON ({error}): reload it") from error


def _kindless(content: Mapping[str, Any]) -> dict[str, Any]:
    """Return a picture's header with `kind` renamed, because a message has a `kind`, too."""
    return {("change" if key == "kind" else key): value for key, value in content.items()}


def _is_gone(connection: socket.socket) -> bool:
    """Return whether the browser has closed the connection.

    The connection must be one on which the browser sends no data after its request.
    """
    readable, _, _ = select.select([connection], [], [], 0)
    return bool(readable) and connection.recv(1, socket.MSG_PEEK) == b""


def _packed(answers: list[tuple[int, Answer]]) -> bytes:
    """Return answers as one block: length of the head, head as JSON, and all arrays.

    Arrays begin at multiples of 8 bytes, so that a browser can use them without a copy.
    """
    places: list[dict[str, Any]] = []
    pieces: list[bytes] = []
    at = 0
    for version, answer in answers:
        arrays = {}
        for name, data in answer.arrays.items():
            arrays[name] = [at, len(data)]
            pieces += [data, b"\0" * (-len(data) % 8)]
            at += len(data) + (-len(data) % 8)
        place = {"kind": answer.kind, "version": version}
        places.append({**place, "arrays": arrays, "header": answer.header})
    head = json.dumps(places).encode()
    head += b" " * (-(len(head) + 4) % 8)
    return struct.pack("<I", len(head)) + head + b"".join(pieces)
