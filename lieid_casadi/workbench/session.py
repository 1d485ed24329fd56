"""State of one page: what is open, the steps taken so far, and how they are saved.

Every change is a new object. Sessions are JSON files, written after every change; they can be read
by their owner alone, and nothing in them is executed.
"""

from __future__ import annotations

import contextlib
import os
import re
import secrets
import shutil
import stat
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import msgspec

from lieid_casadi.atomic_file import atomic_binary
from lieid_casadi.errors import LieidError

if TYPE_CHECKING:
    from lieid_casadi.identification import Fit
    from lieid_casadi.recording import Recording
    from lieid_casadi.robot import Robot

Role = Literal["train", "test"]
Numbers = tuple[float | None, ...]  # one per joint, None where unknown
Options = tuple[tuple[str, tuple[str, ...]], ...]
Progress = Callable[[str, float], None]  # of a stage and the fraction done

START = "first model"
SCHEMA = 2
KEPT_DAYS = 30.0
_NAME = re.compile(r"[0-9a-f]{16}")
_TOKEN = re.compile(r"[\w-]{32}", re.ASCII)


@dataclass(frozen=True)
class RecordingInput:
    """A recording that is open: its path, or ``FILE@T0:T1``, and what it is used for."""

    path: str
    role: Role


@dataclass(frozen=True)
class WorkbenchInputs:
    """What is open on a page.

    ``robot`` is a path or bundled name, ``fit`` the path of a fit in its place, whose model is
    fitted again. ``effects`` are those of the first model, of the fit if empty. ``options`` are
    those of the command line: name without dashes, and values.
    """

    robot: str = ""
    fit: str = ""
    recordings: tuple[RecordingInput, ...] = ()
    effects: tuple[str, ...] = ()
    options: Options = ()

    @property
    def lacking(self) -> str:
        """What is missing; empty if they can be opened."""
        if not (self.robot or self.fit):
            return "no robot; expected a file, or a bundled name such as panda"
        if not self.recordings:
            return "no recordings; expected at least one"
        if not self.paths("train"):
            return "no recording to fit; set at least one of them to “fit”"
        return ""

    @property
    def words(self) -> list[str]:
        """The options as words of a command line."""
        return [word for name, values in self.options for word in (f"--{name}", *values)]

    def with_options(self, words: Sequence[str]) -> WorkbenchInputs:
        """Return the inputs with further options, as on a command line, in place of the same ones.

        Units are added to those that are stated.
        """
        given = dict(self.options)
        name = ""
        for word in words:
            if word.startswith("--"):
                name = word.removeprefix("--")
                units = given.get(name, ()) if name == "units" else ()
                given[name] = ()
            elif name == "units" and units:
                given[name] = (",".join([*units, word]),)
            else:
                given[name] = (*given[name], word)
        return replace(self, options=tuple(given.items()))

    def without_option(self, name: str) -> WorkbenchInputs:
        """Return the inputs without an option."""
        return replace(self, options=tuple(o for o in self.options if o[0] != name))

    def paths(self, role: Role) -> list[str]:
        """Return the paths of the recordings with this role."""
        return [r.path for r in self.recordings if r.role == role]


@dataclass(frozen=True)
class WorkerSetup:
    """What a worker process runs with: picklable functions of the command line.

    ``prepare`` is called once, before anything is opened: it loads the user's file of effects.
    """

    prepare: Callable[[], None]
    robot: Callable[[WorkbenchInputs], Robot]
    read: Callable[[WorkbenchInputs, Robot | Fit], list[Recording]]


@dataclass(frozen=True)
class ExcludedRange:
    """A stretch of one recording that is left out, from ``start`` to ``end`` seconds."""

    recording: int
    start: float
    end: float


def kept_parts(
    excluded: Sequence[ExcludedRange], recording: int
) -> list[tuple[float | None, float | None]]:
    """Return start and end of the stretches of one recording that are used, s.

    None is the recording's own start or end.
    """
    ranges = sorted((e.start, e.end) for e in excluded if e.recording == recording)
    parts: list[tuple[float | None, float | None]] = []
    start: float | None = None
    for low, high in ranges:
        if start is None or low > start:
            parts.append((start, low))
        start = high if start is None else max(start, high)
    return [*parts, (start, None)]


@dataclass(frozen=True)
class ProposedEffect:
    """An effect that a diagnosis found, such as ``load_friction:2``.

    It is listed under ``joint``, from 0, of ``joints``, from 1 (none: on the whole arm), whose
    unseen error is ``before`` and ``after``, N·m. ``rivals`` have a label and a kind, ``exact`` or
    ``data``; ``group`` is that of the same effect on several joints, from 1.
    """

    label: str
    effect: str
    joints: tuple[int, ...]
    joint: int
    before: float | None
    after: float | None
    rivals: tuple[tuple[str, str], ...] = ()
    value: str = ""
    status: str = "named"
    sentence: str = ""
    group: int = 0


@dataclass(frozen=True)
class FoundEffects:
    """Result of a diagnosis of a model with ``effects``."""

    verdict: str
    sentence: str
    proposed: tuple[ProposedEffect, ...]
    effects: tuple[str, ...]
    unexplained: tuple[str, ...] = ()  # sentences on the residual
    model: tuple[str, ...] = ()  # effects of the final model
    path: tuple[Numbers, ...] = ()  # unseen error of every joint after each step, N·m
    summary: str = ""  # by how much the error falls with all of them

    @property
    def groups(self) -> dict[int, list[ProposedEffect]]:
        """The proposals of each group with several of them."""
        found: dict[int, list[ProposedEffect]] = {}
        for each in self.proposed:
            found.setdefault(each.group, []).append(each)
        return {k: several for k, several in found.items() if k and len(several) > 1}


@dataclass(frozen=True)
class StepErrors:
    """Errors of one step per joint, N·m, in motion; None where unknown.

    ``shown`` is of the test recordings, or held out by cross-validation without a test;
    ``spread`` is the standard deviation of the measured torque in motion.
    """

    train: Numbers
    shown: Numbers
    noise_floor: Numbers
    spread: Numbers = ()

    def fit_percent(self, joint: int) -> float | None:
        """Return 100 (1 − error / spread): 100 for a perfect model, 0 for a constant torque."""
        spread = self.spread[joint] if self.spread else None
        error = self.shown[joint]
        return None if error is None or not spread else 100.0 * (1.0 - error / spread)


@dataclass(frozen=True)
class ModelStep:
    """One entry of the history: a model, and what is left out of the recordings."""

    title: str
    effects: tuple[str, ...]  # labels of all placements, such as stribeck:4
    excluded: tuple[ExcludedRange, ...] = ()
    errors: StepErrors | None = None  # until they are computed

    @property
    def key(self) -> tuple[object, ...]:
        """What its torque depends on besides the inputs."""
        return self.effects, self.excluded


@dataclass(frozen=True)
class Session:
    """What a page shows, as it is saved; steps after ``position`` can be restored.

    ``found`` is the last diagnosis, ``joint`` and ``recording`` are selected, from 0.
    """

    inputs: WorkbenchInputs = field(default_factory=WorkbenchInputs)
    history: tuple[ModelStep, ...] = ()
    position: int = 0
    found: FoundEffects | None = None
    joint: int = 0
    recording: int = 0

    @property
    def step(self) -> ModelStep | None:
        """The step that is shown."""
        return self.history[self.position] if self.history else None

    @property
    def can_undo(self) -> bool:
        """Whether there is an earlier step."""
        return self.position > 0

    @property
    def can_redo(self) -> bool:
        """Whether there is a step that was undone."""
        return self.position + 1 < len(self.history)

    @property
    def error_name(self) -> str:
        """Of what the error is that the page shows: ``test`` or ``held out``."""
        return "test" if self.inputs.paths("test") else "held out"

    def opened(self, inputs: WorkbenchInputs, effects: Sequence[str]) -> Session:
        """Return the session of new inputs, with the first model's effects as its only step."""
        tested = [k for k, r in enumerate(inputs.recordings) if r.role == "test"]
        return Session(
            inputs=inputs,
            history=(ModelStep(START, tuple(effects)),),
            recording=tested[0] if tested else 0,
        )

    def with_effects(self, title: str, effects: Sequence[str]) -> Session:
        """Return the session with a further step of other effects; unchanged if it has these."""
        assert self.step is not None
        if self.step.effects == tuple(effects):
            return self
        return self._then(replace(self.step, title=title, effects=tuple(effects), errors=None))

    def with_added(self, *labels: str) -> Session:
        """Return the session with those effects added that the model does not have."""
        assert self.step is not None
        new = [label for label in labels if label not in self.step.effects]
        kinds, places = ({label.partition(":")[k] for label in new} for k in (0, 2))
        title = f"+ {len(new)} effects: {', '.join(new)}"
        if len(kinds) == 1:  # as in `--effects`
            title = f"+ {':'.join([*kinds, '+'.join(sorted(places))]).rstrip(':')}"
        return self.with_effects(title, (*self.step.effects, *new))

    def without_effect(self, label: str) -> Session:
        """Return the session with an effect removed; unchanged if the model lacks it."""
        assert self.step is not None
        return self.with_effects(f"− {label}", [e for e in self.step.effects if e != label])

    def excluding(self, start: float, end: float) -> Session:
        """Return the session without a stretch of the recording that is shown, s."""
        assert self.step is not None
        stretch = ExcludedRange(self.recording, start, end)
        title = f"without {start:.4g} to {end:.4g} s of recording {self.recording + 1}"
        return self._then(
            replace(self.step, title=title, excluded=(*self.step.excluded, stretch), errors=None)
        )

    def with_errors(self, step: ModelStep, errors: StepErrors) -> Session:
        """Return the session with the errors of every step that has the same fit as ``step``."""
        history = tuple(
            replace(each, errors=errors) if each.key == step.key else each for each in self.history
        )
        return replace(self, history=history)

    def at_worst_joint(self) -> Session:
        """Return the session with the joint selected whose error is most above its noise floor."""
        errors = None if self.step is None else self.step.errors
        if errors is None:
            return self
        both = zip(errors.shown, errors.noise_floor, strict=True)
        ratios = [error / floor if error and floor else 0.0 for error, floor in both]
        if not any(ratios):  # no noise floor so far
            ratios = [-(errors.fit_percent(j) or 100.0) for j in range(len(ratios))]
        return replace(self, joint=ratios.index(max(ratios)))

    def at(self, position: int) -> Session:
        """Return the session at the nearest step of its history."""
        return replace(self, position=min(max(position, 0), max(len(self.history) - 1, 0)))

    def _then(self, step: ModelStep) -> Session:
        history = (*self.history[: self.position + 1], step)
        return replace(self, history=history, position=len(history) - 1)


class SessionFileError(LieidError):
    """A saved session that cannot be read."""


class SessionContent(msgspec.Struct, forbid_unknown_fields=True):
    """Content of a file."""

    schema: int
    session: Session


def session_folder() -> Path:
    """Return the folder of saved sessions."""
    stated = os.environ.get("LIEID_WORKBENCH_DIR")
    if stated:
        return Path(stated).absolute()
    state = Path(os.environ.get("XDG_STATE_HOME", ""))
    base = state if state.is_absolute() else Path.home() / ".local" / "state"
    return base / "lieid-casadi" / "workbench"


def page_token() -> str:
    """Return the token of this user's pages: an open page stays valid when its server starts again.

    It is kept for a month in a file that its owner alone can read.
    """
    file = session_folder() / "token"
    with contextlib.suppress(OSError, UnicodeError):
        facts, known = file.lstat(), file.read_text("ascii")
        own = stat.S_ISREG(facts.st_mode) and facts.st_uid == os.getuid()
        new = time.time() - facts.st_mtime < KEPT_DAYS * 86400.0
        if own and new and not facts.st_mode & 0o077 and _TOKEN.fullmatch(known):
            return known
    made = secrets.token_urlsafe(24)
    with contextlib.suppress(LieidError), atomic_binary(file, private=True) as written:
        written.write(made.encode())
    return made


def upload_file(session: str, name: str) -> Path:
    """Return the file of an upload, which exists and can be read by its owner alone."""
    file = session_folder() / session / name
    file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    file.unlink(missing_ok=True)
    os.close(os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600))
    return file


def is_name(text: str) -> bool:
    """Return whether a text can be the name of a session."""
    return _NAME.fullmatch(text) is not None


def save_session(name: str, session: Session) -> None:
    """Write a session; raises OutputError if the folder cannot be written."""
    content = msgspec.to_builtins(SessionContent(SCHEMA, session))
    with atomic_binary(_file(name), private=True) as file:
        file.write(msgspec.json.encode(content))


def load_session(name: str) -> Session | None:
    """Return a saved session, None if there is none."""
    file = _file(name)
    if not is_name(name) or not file.is_file():
        return None
    try:
        content = msgspec.json.decode(file.read_bytes(), type=SessionContent)
    except (msgspec.MsgspecError, ValueError, OSError) as error:
        raise SessionFileError(f"{file}: not a saved session ({error})") from error
    if content.schema != SCHEMA:
        raise SessionFileError(f"{file}: schema {content.schema}; expected {SCHEMA}")
    session = content.session
    if not 0 <= session.position < max(len(session.history), 1):
        raise SessionFileError(f"{file}: step {session.position} is not in its history")
    return session


def remove_old_sessions() -> None:
    """Delete sessions, and the files that were given to them, that are older than a month."""
    for file in session_folder().glob("*.json"):
        old = file.is_file() and time.time() - file.stat().st_mtime > KEPT_DAYS * 86400.0
        if old and is_name(file.stem):
            file.unlink(missing_ok=True)
            shutil.rmtree(file.with_suffix(""), ignore_errors=True)


def _file(name: str) -> Path:
    return session_folder() / f"{name}.json"
