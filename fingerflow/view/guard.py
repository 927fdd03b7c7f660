"""Access control of the server: only requests with the token, from the server's page on this computer, pass."""

from starlette.datastructures import Headers
from starlette.responses import HTMLResponse, PlainTextResponse, Response
from starlette.types import ASGIApp, Receive, Scope, Send

from fingerflow.player.page_token import PageToken, redirect

HEADER = "x-fingerflow"  # other sites cannot send it without a CORS permission, which is never granted
_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


class Guard:
    """Middleware that refuses foreign host names (DNS rebinding), requests from other sites, and requests without the
    token.

    Attributes:
        token: secret of this run; in the address that opens the page, then in a cookie that only its pages send.
    """

    def __init__(self, app: ASGIApp, port: int) -> None:
        self._app = app
        self._hosts = {f"127.0.0.1:{port}", f"localhost:{port}"}
        self.token = PageToken(port)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Refuse a request that fails the checks, and pass any other to the application; only HTTP is served."""
        if scope["type"] != "http":
            return
        refused = self._refused(Headers(scope=scope), scope)
        if refused is not None:
            await refused(scope, receive, send)
        else:
            await self._app(scope, receive, _add_headers(send))

    def _refused(self, headers: Headers, scope: Scope) -> Response | None:
        hosts, origins = headers.getlist("host"), headers.getlist("origin")
        if len(hosts) != 1 or hosts[0].lower() not in self._hosts:
            return PlainTextResponse("this address is not served under that name", 421)
        this_origin = f"http://{hosts[0].lower()}"
        if any(origin.lower() != this_origin for origin in origins):
            return PlainTextResponse("pages of other sites are refused", 403)
        if headers.get("sec-fetch-site", "none") not in ("none", "same-origin") and not _opens_start_page(
            headers, scope
        ):
            return PlainTextResponse("pages of other sites are refused", 403)
        query = scope["query_string"].decode("latin-1")
        if scope["method"] == "GET" and scope["path"] == "/" and self.token.is_in_query(query):
            return HTMLResponse(redirect("/"), headers={"Set-Cookie": self.token.set_cookie})
        if not self.token.is_in_cookies(headers.get("cookie", "")):
            return PlainTextResponse("open the whole address that `fingerflow view` has printed", 403)
        if scope["method"] not in ("GET", "HEAD") and HEADER not in headers:
            return PlainTextResponse("pages of other sites are refused", 403)
        return None


def _opens_start_page(headers: Headers, scope: Scope) -> bool:
    """Return True if a request opens the start page, which links on other sites may do; the token is still required.

    Such a request is allowed, but needs the token.
    """
    return scope["path"] == "/" and headers.get("sec-fetch-mode") == "navigate" and scope["method"] == "GET"


def _add_headers(send: Send) -> Send:
    async def sending(message: object) -> None:
        if isinstance(message, dict) and message["type"] == "http.response.start":
            headers = list(message.get("headers", []))
            stated = {name for name, _ in headers}
            added = [(name.lower().encode(), value.encode()) for name, value in _HEADERS.items()]
            message = {**message, "headers": [*headers, *(header for header in added if header[0] not in stated)]}
        await send(message)  # type: ignore[arg-type]

    return sending
