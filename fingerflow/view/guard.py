"""Access control of the server: static files are the same for all, and requests of data need the token of this run."""

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from fingerflow.player.page_token import HEADER, is_token, new_token

_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
_CLOSE = {"Connection": "close"}  # a connection without the token serves one request


class Guard:
    """Middleware that refuses foreign host names (DNS rebinding), requests from other sites, and requests of data
    without the token.

    Attributes:
        token: secret of this run; in the address that opens the page, then in a header that only its pages send.
    """

    def __init__(self, app: ASGIApp, port: int) -> None:
        self._app = app
        self._hosts = {f"127.0.0.1:{port}", f"localhost:{port}"}
        self.token = new_token()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Refuse a request that fails the checks, and pass any other to the application; only HTTP is served."""
        if scope["type"] != "http":
            return
        headers = Headers(scope=scope)
        admitted = is_token(headers.get(HEADER, ""), self.token)
        answer = self._refused(headers, admitted or not scope["path"].startswith("/api/")) or self._app
        await answer(scope, receive, _add_headers(send, _HEADERS if admitted else _HEADERS | _CLOSE))

    def _refused(self, headers: Headers, admitted: bool) -> Response | None:
        hosts, origins = headers.getlist("host"), headers.getlist("origin")
        if len(hosts) != 1 or hosts[0].lower() not in self._hosts:
            return PlainTextResponse("this address is not served under that name", 421)
        if any(origin.lower() != f"http://{hosts[0].lower()}" for origin in origins):
            return PlainTextResponse("pages of other sites are refused", 403)
        if not admitted:
            return PlainTextResponse("open the whole address that `fingerflow view` has printed", 403)
        return None


def _add_headers(send: Send, added: dict[str, str]) -> Send:
    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            for name, value in added.items():
                headers.setdefault(name, value)
        await send(message)

    return sending
