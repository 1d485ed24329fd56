"""Access to the page: a secret token, and the addresses that requests may come from."""

from __future__ import annotations

import hmac
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs

from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

POLICY = (
    "default-src 'self' data: blob:; script-src 'self' 'unsafe-inline' 'unsafe-eval' blob:; "
    "style-src 'self' 'unsafe-inline'; frame-ancestors 'none'; form-action 'self'"
)


class AccessControl:
    """Lets requests through that have the token and come from the page itself.

    The token is in the URL that the command prints; the answer to it sets a cookie, with which
    the page loads its scripts and opens its socket. A request of another host name (DNS
    rebinding) or of another site's page is refused.

    Parameters
    ----------
    app : ASGI application
    token : str
    hosts : set of str
        Values of the header ``Host`` that are served, with the port.
    port : int
    """

    def __init__(self, app: ASGIApp, *, token: str, hosts: set[str], port: int) -> None:
        self._app, self._token, self._hosts = app, token, hosts
        self._cookie = f"lieid-workbench-{port}"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve or refuse one request."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        reason = self._refusal(headers)
        stated = parse_qs(scope["query_string"].decode("latin-1")).get("token", [""])[0]
        by_url = self._is_token(stated)
        if not reason and not by_url and not self._is_token(self._cookie_value(headers)):
            reason = "no valid token; open the URL that lieid workbench has printed"
        if reason:
            await self._refuse(scope, receive, send, reason)
            return

        async def sent(message: Message) -> None:
            if message["type"] == "http.response.start":
                added = [
                    (b"content-security-policy", POLICY.encode()),
                    (b"referrer-policy", b"no-referrer"),
                    (b"x-content-type-options", b"nosniff"),
                ]
                if by_url:
                    value = f"{self._cookie}={self._token}; HttpOnly; SameSite=Strict; Path=/"
                    added.append((b"set-cookie", value.encode()))
                message = {**message, "headers": [*message.get("headers", []), *added]}
            await send(message)

        await self._app(scope, receive, sent)

    def _refusal(self, headers: Headers) -> str:
        """Return why a request is refused because of where it comes from, or an empty text."""
        if headers.get("host", "").lower() not in self._hosts:
            return "unknown host name; open the URL that lieid workbench has printed"
        origin = headers.get("origin")
        if origin is not None and origin.partition("://")[2].lower() not in self._hosts:
            return "a page of another site may not use the workbench"
        return ""

    def _cookie_value(self, headers: Headers) -> str:
        cookies = SimpleCookie()
        try:
            cookies.load(headers.get("cookie", ""))
        except CookieError:
            return ""
        return cookies[self._cookie].value if self._cookie in cookies else ""

    def _is_token(self, text: str) -> bool:
        return hmac.compare_digest(text.encode(), self._token.encode())

    async def _refuse(self, scope: Scope, receive: Receive, send: Send, reason: str) -> None:
        if scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008, "reason": reason})
            return
        await PlainTextResponse(f"lieid workbench: {reason}\n", 403)(scope, receive, send)
