"""Secret token of a page: in the fragment of the address that opens it, then in a header of each request.

A browser sends neither to the servers of other users: a cookie would go to every port of this computer. Pages of other
sites cannot send the header, because it needs a permission (CORS preflight) that is never granted.
"""

import hmac
import secrets

HEADER = "X-Fingerflow"


def new_token() -> str:
    """Return a new secret token, valid for one run of a server."""
    return secrets.token_urlsafe(24)


def is_token(text: str, token: str) -> bool:
    """Return whether the text of the header of a request is the token, in a time that does not depend on the text."""
    return hmac.compare_digest(text.encode(errors="replace"), token.encode())
