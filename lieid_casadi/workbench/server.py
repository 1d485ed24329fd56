"""The server of the page: one port, one token, sessions of several tabs."""

from __future__ import annotations

import atexit
import errno
import logging
import os
import secrets
import socket
import tempfile
import threading
import webbrowser
from collections.abc import Callable
from dataclasses import dataclass
from html import escape
from pathlib import Path

from lieid_casadi.errors import MissingDependency, UsageError
from lieid_casadi.workbench.recordings import WorkerSetup
from lieid_casadi.workbench.session import WorkbenchInputs

LOOPBACK = "127.0.0.1"
DEFAULT_PORT = 8765
PORTS_TRIED = 100  # after a busy one, for the port that the error names


@dataclass(frozen=True)
class ServerOptions:
    """Where the page is served.

    Attributes
    ----------
    host : str
        Address to listen on.
    exposed : bool
        Whether the user has confirmed an address that other machines can reach.
    """

    host: str = LOOPBACK
    port: int = DEFAULT_PORT
    exposed: bool = False


def serve(
    inputs: WorkbenchInputs,
    setup: WorkerSetup,
    options: ServerOptions,
    *,
    ready: Callable[[str], None],
) -> None:
    """Serve the page until the process is asked to end.

    Parameters
    ----------
    inputs : WorkbenchInputs
        What a new page opens.
    ready : callable
        Called with the URL once the page can be opened.

    Raises
    ------
    UsageError
        A busy port, or an address that other machines can reach without a confirmation.
    MissingDependency
        The extra ``workbench`` is not installed.
    """
    try:
        import nicegui  # noqa: F401
    except ImportError as error:
        raise MissingDependency(
            "lieid workbench needs NiceGUI: pip install 'lieid-casadi[workbench]'"
        ) from error
    listener = listening_socket(options)
    from lieid_casadi.workbench.application import run_application

    logging.getLogger("nicegui").setLevel(logging.ERROR)
    with listener:
        port = int(listener.getsockname()[1])
        token = secrets.token_urlsafe(24)
        run_application(
            inputs,
            setup,
            listener,
            token=token,
            hosts=_host_names(options.host, port),
            ready=lambda: ready(f"http://{_bracketed(options.host)}:{port}/?token={token}"),
        )


def open_in_browser(url: str) -> None:
    """Open a URL in the user's browser without naming it on a command line, which others can read.

    The browser opens a file that refers to the URL; the file is its owner's, and is deleted when
    the program ends.
    """
    page = f"""<!DOCTYPE html><meta charset="utf-8"><meta name="referrer" content="no-referrer">
<meta http-equiv="refresh" content="0; url={escape(url)}"><a href="{escape(url)}">workbench</a>"""
    handle, name = tempfile.mkstemp(prefix="lieid-workbench-", suffix=".html")  # mode 0600
    with os.fdopen(handle, "w", encoding="utf-8") as file:
        file.write(page)
    atexit.register(Path(name).unlink, missing_ok=True)
    threading.Thread(target=webbrowser.open, args=(Path(name).as_uri(),), daemon=True).start()


def listening_socket(options: ServerOptions) -> socket.socket:
    """Return a bound socket; raises as `serve`."""
    if options.host not in (LOOPBACK, "localhost", "::1") and not options.exposed:
        raise UsageError(
            f"--host {options.host}: other machines could reach the page, and whoever has its URL "
            "can read recordings with your rights; use an SSH tunnel (ssh -L), or add --yes-expose"
        )
    bound = _bound(options.host, options.port)
    if bound is None:
        free = _free_port(options.host, options.port)
        raise UsageError(f"--port {options.port}: is in use; port {free} is free (--port {free})")
    return bound


def _bound(host: str, port: int) -> socket.socket | None:
    """Return a socket that listens on a port, None if it is in use."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    made = socket.socket(family, socket.SOCK_STREAM)
    made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        made.bind((host, port))
        made.listen(128)
    except OSError as error:
        made.close()
        if error.errno == errno.EADDRINUSE:
            return None
        raise UsageError(
            f"--host {host} --port {port}: cannot listen there ({error.strerror})"
        ) from error
    made.set_inheritable(False)
    return made


def _free_port(host: str, after: int) -> int:
    for port in range(after + 1, min(after + PORTS_TRIED, 65536)):
        found = _bound(host, port)
        if found is not None:
            found.close()
            return port
    with socket.socket() as free:
        free.bind((LOOPBACK, 0))
        return int(free.getsockname()[1])


def _host_names(host: str, port: int) -> set[str]:
    names = {host, "localhost", LOOPBACK}
    if host in ("0.0.0.0", "::"):
        names |= {socket.gethostname(), socket.getfqdn(), *_own_addresses()}
    return {f"{_bracketed(name)}:{port}".lower() for name in names}


def _own_addresses() -> set[str]:
    try:
        found = socket.getaddrinfo(socket.gethostname(), None)
    except OSError:
        return set()
    return {str(entry[4][0]) for entry in found}


def _bracketed(host: str) -> str:
    return f"[{host}]" if ":" in host else host
