"""Saved sessions: JSON, written atomically after every change; nothing in a file is executed."""

from __future__ import annotations

import os
import re
import shutil
import time
from dataclasses import dataclass
from pathlib import Path

import msgspec

from lieid_casadi.atomic_file import atomic_binary
from lieid_casadi.errors import LieidError
from lieid_casadi.workbench.state.session import Session

SCHEMA = 1
KEPT_DAYS = 30.0
_NAME = re.compile(r"[0-9a-f]{16}")


class SessionFileError(LieidError):
    """A saved session that cannot be read."""


class SessionContent(msgspec.Struct, forbid_unknown_fields=True):
    """Content of a file."""

    schema: int
    session: Session


@dataclass(frozen=True)
class SavedSession:
    """A session on disk: its name, when it was saved (s since 1970), and its content."""

    name: str
    saved: float
    session: Session


def session_folder() -> Path:
    """Return the folder of saved sessions.

    ``$LIEID_WORKBENCH_DIR``, else ``lieid-casadi/workbench`` in ``$XDG_STATE_HOME`` or
    ``~/.local/state``.
    """
    stated = os.environ.get("LIEID_WORKBENCH_DIR")
    if stated:
        return Path(stated).absolute()
    state = Path(os.environ.get("XDG_STATE_HOME", ""))
    base = state if state.is_absolute() else Path.home() / ".local" / "state"
    return base / "lieid-casadi" / "workbench"


def upload_folder(name: str) -> Path:
    """Return the folder of files that were dropped on the page of a session."""
    return session_folder() / name


def is_name(text: str) -> bool:
    """Return whether a text can be the name of a session."""
    return _NAME.fullmatch(text) is not None


def save_session(name: str, session: Session) -> None:
    """Write a session.

    Raises
    ------
    OutputError
        The folder cannot be written.
    """
    content = msgspec.to_builtins(SessionContent(SCHEMA, session))
    with atomic_binary(_file(name)) as file:
        file.write(msgspec.json.encode(content))


def load_session(name: str) -> Session | None:
    """Return a saved session, None if there is none.

    Raises
    ------
    SessionFileError
        The file is damaged, or of another schema.
    """
    file = _file(name)
    if not is_name(name) or not file.is_file():
        return None
    try:
        content = msgspec.json.decode(file.read_bytes(), type=SessionContent)
    except (msgspec.MsgspecError, UnicodeDecodeError, OSError) as error:
        raise SessionFileError(f"{file}: not a saved session ({error})") from error
    if content.schema != SCHEMA:
        raise SessionFileError(f"{file}: schema {content.schema}; expected {SCHEMA}")
    session = content.session
    if not 0 <= session.position < max(len(session.history), 1):
        raise SessionFileError(f"{file}: step {session.position} is not in its history")
    return session


def saved_sessions() -> list[SavedSession]:
    """Return the readable sessions, the last saved first; files older than a month are deleted."""
    found = []
    for file in session_folder().glob("*.json"):
        if not is_name(file.stem):
            continue
        saved = file.stat().st_mtime
        if time.time() - saved > KEPT_DAYS * 86400.0:
            file.unlink(missing_ok=True)
            shutil.rmtree(upload_folder(file.stem), ignore_errors=True)
            continue
        try:
            session = load_session(file.stem)
        except SessionFileError:
            continue
        if session is not None and session.history:
            found.append(SavedSession(file.stem, saved, session))
    return sorted(found, key=lambda each: -each.saved)


def _file(name: str) -> Path:
    return session_folder() / f"{name}.json"
