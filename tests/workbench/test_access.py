"""Who may use the page: token, host name, origin, port, address."""

import asyncio
import socket

import pytest

from lieid_casadi.cli.main import main
from lieid_casadi.workbench.server import AccessControl

TOKEN, HOST = "secret-token", "127.0.0.1:8765"
COOKIE = f"lieid-workbench-8765={TOKEN}"


def answer(kind="http", query="", **headers):
    """Return the status or close code of a request, and its headers."""
    sent = []

    async def application(scope, receive, send):
        start = {"type": "http.response.start", "status": 200, "headers": []}
        accept = {"type": "websocket.accept", "headers": []}
        await send(accept if kind == "websocket" else start)

    async def send(message):
        sent.append(message)

    guarded = AccessControl(application, token=TOKEN, hosts={HOST}, port=8765)
    pairs = [(k.encode(), v.encode()) for k, v in {"host": HOST, **headers}.items()]
    scope = {"type": kind, "path": "/", "query_string": query.encode(), "headers": pairs}
    asyncio.run(guarded(scope, None, send))
    first = sent[0]
    status = first.get("status", first.get("code", first["type"]))
    return status, dict(first.get("headers", []))


def test_the_printed_url_opens_the_page_and_sets_a_cookie():
    status, headers = answer(query=f"token={TOKEN}")
    assert status == 200
    assert headers[b"set-cookie"].startswith(COOKIE.encode())
    assert b"HttpOnly" in headers[b"set-cookie"]


@pytest.mark.parametrize("query", ["", "token=", "token=guess", "token=secret-toke%C3%A9"])
def test_without_the_token_nothing_is_served(query):
    assert answer(query=query)[0] == 403
    assert answer("websocket", query=query)[0] == 1008


def test_the_cookie_is_enough_for_what_the_page_loads():
    assert answer(cookie=COOKIE)[0] == 200
    assert answer("websocket", cookie=COOKIE)[0] == "websocket.accept"
    assert answer(cookie="lieid-workbench-9999=" + TOKEN)[0] == 403


@pytest.mark.parametrize(
    "headers",
    [
        {"host": "evil.example:8765"},
        {"host": "127.0.0.1"},
        {"host": ""},
        {"origin": "http://evil.example"},
        {"origin": "null"},
        {"origin": "http://127.0.0.1:9999"},
    ],
    ids=str,
)
def test_another_host_name_and_pages_of_other_origins_are_refused(headers):
    assert answer(query=f"token={TOKEN}", cookie=COOKIE, **headers)[0] == 403
    assert answer("websocket", cookie=COOKIE, **headers)[0] == 1008
    assert answer("websocket", cookie=COOKIE, origin=f"http://{HOST}")[0] == "websocket.accept"


def test_a_busy_port_is_an_error(capsys):
    with socket.socket() as busy:
        busy.bind(("127.0.0.1", 0))
        busy.listen()
        port = busy.getsockname()[1]
        status = main(["workbench", "two_link", "--no-browser", "--port", str(port)])
    out, err = capsys.readouterr()
    assert (status, out) == (2, "")
    assert err.count("\n") == 1
    assert "is in use" in err
