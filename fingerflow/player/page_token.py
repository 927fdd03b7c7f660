"""Secret token of a page, sent in the address that opens the page and then in a cookie."""

import hmac
import html
import secrets
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs


class PageToken:
    """Secret token that admits a browser to the page, valid for one run of a server.

    Attributes:
        text: the token.
        cookie: name of the cookie. It contains the port, because browsers send a cookie to all ports of a host.
    """

    def __init__(self, port: int) -> None:
        self.text = secrets.token_urlsafe(24)
        self.cookie = f"fingerflow-{port}"

    @property
    def set_cookie(self) -> str:
        """Return the value of the Set-Cookie header; pages of other sites cannot make a browser send this cookie."""
        return f"{self.cookie}={self.text}; Path=/; HttpOnly; SameSite=Strict"

    def is_in_query(self, query: str) -> bool:
        """Return whether the query of an address, such as "token=...", contains the token."""
        return self._is(parse_qs(query).get("token", [""])[0])

    def is_in_cookies(self, header: str) -> bool:
        """Return whether the Cookie header of a request contains the token."""
        try:
            cookies = SimpleCookie(header)
        except CookieError:
            return False
        return self.cookie in cookies and self._is(cookies[self.cookie].value)

    def _is(self, text: str) -> bool:
        return hmac.compare_digest(text.encode(errors="replace"), self.text.encode())


def redirect(address: str) -> str:
    """Return an HTML page that redirects to an address, with an empty icon so that the browser requests none.

    A browser sends a strict cookie after this page, but not after an HTTP redirect from a link of another site.
    """
    leads = f'<meta http-equiv="refresh" content="0;url={html.escape(address)}">'
    return f'<!doctype html>{leads}<link rel="icon" href="data:,"><title>fingerflow</title>'
