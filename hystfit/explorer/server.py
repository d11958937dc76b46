"""A server for the page of one session: on this machine only, for those who know its address.

Other pages in the same browser can send requests to any local port, under another name of it too (DNS rebinding). So the path
begins with a random token, the Host header must be this server's own, and a request with a body must come from its page.
"""

from __future__ import annotations

import hmac
import json
import re
import secrets
import sys
import threading
from collections.abc import Callable, Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any

from hystfit.errors import DataError, HystfitError
from hystfit.explorer.session import Points, Session

_LARGEST = 2**20  # bytes of a request
_PATIENCE_S = 60.0  # for the rest of a request
_FRAMES = "http://localhost:* http://127.0.0.1:*"  # notebooks that show the page

Answer = Points | Mapping[str, Any]


class Server(ThreadingHTTPServer):
    """The page of a session and its answers, from `open` until `close`; `url` is its address, with its token."""

    daemon_threads = True

    def __init__(self, session: Session, port: int = 0):
        """Listen on a port of 127.0.0.1; 0 takes a free one."""
        try:
            super().__init__(("127.0.0.1", port), _Handler)
        except (OSError, OverflowError) as error:
            raise DataError(f"port {port} cannot be used ({error}): choose another one, or leave out port=") from error
        self.session, self.token = session, secrets.token_urlsafe(24)
        number = self.server_address[1]
        self.hosts = (f"127.0.0.1:{number}", f"localhost:{number}")
        self.url = f"http://{self.hosts[0]}/{self.token}/"
        self.answers: dict[str, Callable[[Mapping[str, Any]], Answer]] = {
            "model": session.choose,
            "measured": session.measured,
            "predict": session.predict,
            "fit": session.start_fit,
            "fit-state": lambda _: session.fit_state(),
        }

    def open(self) -> None:
        """Answer requests in the background."""
        threading.Thread(target=self.serve_forever, kwargs={"poll_interval": 0.1}, daemon=True).start()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore a page that was closed during an answer."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)

    def close(self) -> None:
        """Stop; a fit that runs ends with the process."""
        self.shutdown()
        self.server_close()


class _Handler(BaseHTTPRequestHandler):
    """GET of the page, POST of a question as JSON; nothing else exists."""

    server: Server
    protocol_version = "HTTP/1.1"  # one connection for all requests of a page
    server_version, sys_version = "hystfit", ""
    disable_nagle_algorithm = True
    wbufsize = -1
    timeout = _PATIENCE_S

    def do_GET(self) -> None:
        if fault := self._fault(""):
            return self._fail(fault)
        nonce = secrets.token_urlsafe(16)
        page = document({"live": True, **self.server.session.scene()}, nonce=nonce)
        policy = (
            f"default-src 'none'; script-src 'nonce-{nonce}'; style-src 'nonce-{nonce}'; connect-src 'self'; img-src data:; "
            f"base-uri 'none'; form-action 'none'; frame-ancestors {_FRAMES}"
        )
        return self._send(HTTPStatus.OK, page.encode(), "text/html; charset=utf-8", {"Content-Security-Policy": policy})

    def do_POST(self) -> None:
        """The answer to a question of the page."""
        length = self.headers.get("Content-Length", "")
        if not re.fullmatch(r"[0-9]{1,7}", length) or int(length) > _LARGEST:
            self.close_connection = True
            return self._fail(HTTPStatus.REQUEST_ENTITY_TOO_LARGE)
        body = self.rfile.read(int(length))  # first, since a connection closed with unread data loses the answer
        name = self.path.rpartition("/")[2]
        if fault := self._fault(name) or self._foreign():
            return self._fail(fault)
        if name not in self.server.answers:
            return self._fail(HTTPStatus.NOT_FOUND)
        try:
            content = self.server.answers[name](json.loads(body, parse_int=float))
        except HystfitError as error:
            return self._send_json(HTTPStatus.UNPROCESSABLE_ENTITY, {"error": str(error)})
        except (ArithmeticError, LookupError, TypeError, ValueError, AttributeError, RecursionError):
            return self._fail(HTTPStatus.BAD_REQUEST)
        if isinstance(content, Points):
            facts = {"X-Facts": json.dumps(content.facts)}
            return self._send(HTTPStatus.OK, content.numbers.tobytes(), "application/octet-stream", facts)
        return self._send_json(HTTPStatus.OK, content)

    def _fault(self, name: str) -> HTTPStatus | None:
        """Why a request is refused: not from this address, or without the token."""
        if self.headers.get_all("Host") not in [[host] for host in self.server.hosts]:
            return HTTPStatus.FORBIDDEN
        own = f"/{self.server.token}/{name}"
        return None if hmac.compare_digest(self.path.encode(), own.encode()) else HTTPStatus.NOT_FOUND

    def _foreign(self) -> HTTPStatus | None:
        """Refuse a question that another page may have sent; browsers send JSON to another origin only after asking it."""
        host = self.headers["Host"]
        own = (
            self.headers.get_content_type() == "application/json"
            and self.headers.get("Origin", f"http://{host}") == f"http://{host}"
            and self.headers.get("Sec-Fetch-Site", "same-origin") == "same-origin"
            and "Transfer-Encoding" not in self.headers
        )
        return None if own else HTTPStatus.FORBIDDEN

    def _fail(self, status: HTTPStatus) -> None:
        self._send_json(status, {"error": status.phrase})

    def _send_json(self, status: HTTPStatus, content: Any) -> None:
        self._send(status, json.dumps(content, allow_nan=False).encode(), "application/json", {})

    def _send(self, status: HTTPStatus, body: bytes, kind: str, more: Mapping[str, str]) -> None:
        self.send_response(status)
        for name, value in {"Content-Type": kind, "Content-Length": str(len(body)), **_CAREFUL, **more}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)
        self.wfile.flush()

    def log_message(self, *args: Any) -> None:
        """Print no log."""


_CAREFUL = {
    "Cache-Control": "no-store",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",  # the address holds the token
    "X-Content-Type-Options": "nosniff",
}


_PARTS = ("panel.js", "source.js", "explorer.js")


def document(scene: Mapping[str, Any], *, model_script: str = "", nonce: str = "") -> str:
    """HTML with style, scripts and data in it; `scene` is what the page shows first."""
    from jinja2 import Environment, PackageLoader

    texts = {
        path.name: path.read_text(encoding="utf-8") for path in files("hystfit.explorer").joinpath("page").iterdir()
    }
    environment = Environment(loader=PackageLoader("hystfit.explorer", "page"), autoescape=True)
    return environment.get_template("explorer.html").render(
        style=texts["explorer.css"],
        script="\n".join([model_script, *(texts[part] for part in _PARTS)]),
        scene=json.dumps(scene, allow_nan=False).replace("<", "\\u003c"),
        name=scene["record"]["name"],
        nonce=nonce,
    )
