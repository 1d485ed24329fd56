"""The folder of an experiment: what every round used and found, complete after each of them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

from lieid_casadi.arrays import Array
from lieid_casadi.atomic_file import atomic_binary
from lieid_casadi.errors import OutputError
from lieid_casadi.excitation.trajectory import MotionSamples
from lieid_casadi.experiments.result import Round
from lieid_casadi.output_folder import check_folder
from lieid_casadi.recording import Recording
from lieid_casadi.robot import Robot

STATE = "experiment.json"
SCHEMA = 1


class _State(msgspec.Struct):
    schema: Literal[1]
    identity: dict[str, Any]
    rounds: list[Round]


@dataclass(frozen=True)
class ExperimentFolder:
    """``experiment.json``, and ``round-N`` with what belongs to each recording.

    ``identity`` is what must be the same in a second call with the same folder.
    """

    path: Path
    identity: Mapping[str, Any]

    @classmethod
    def of(cls, path: str | Path, identity: Mapping[str, Any]) -> ExperimentFolder:
        """Return the folder, made if it does not exist, if it holds this experiment or nothing."""
        folder = cls(Path(path), identity)
        state = folder._state()
        if state is None:
            check_folder(path)
            folder.path.mkdir(parents=True, exist_ok=True)
            folder.write(STATE, {"rounds": []})
        elif state.identity != identity:
            other = [name for name in identity if state.identity.get(name) != identity[name]]
            raise OutputError(
                f"{path}: holds an experiment with another {', '.join(other)}; "
                "expected a new folder, or the same arguments to resume"
            )
        return folder

    def rounds(self) -> tuple[Round, ...]:
        """Return the rounds so far."""
        state = self._state()
        return () if state is None else tuple(state.rounds)

    def round(self, number: int) -> Path:
        """Return the folder of a round, made if it does not exist."""
        folder = self.path / f"round-{number}"
        folder.mkdir(exist_ok=True)
        return folder

    def write(self, name: str, content: Mapping[str, Any]) -> None:
        """Write a JSON file, atomically."""
        identity = {"identity": dict(self.identity)} if name == STATE else {}
        text = json.dumps(
            {"schema": SCHEMA, **identity, **content}, indent=1, ensure_ascii=False, allow_nan=False
        )
        with atomic_binary(self.path / name) as file:
            file.write(text.encode(errors="backslashreplace"))

    def _state(self) -> _State | None:
        file = self.path / STATE
        try:
            return msgspec.json.decode(file.read_bytes(), type=_State)
        except (FileNotFoundError, NotADirectoryError):
            return None
        except (OSError, msgspec.MsgspecError) as error:
            raise OutputError(f"{file}: cannot be resumed: {error}") from None


def identity_of(robot: Robot, given: Sequence[Recording], probe: MotionSamples) -> dict[str, Any]:
    """Return what must be the same when an experiment is resumed."""
    return {
        "robot": robot.name,
        "parameters": _hash(robot.link_parameters),
        "given": [{"name": r.name, "sha256": r.source_hash} for r in given],
        "probe": _hash(np.hstack([probe.t[:, None], probe.q])),
    }


def _hash(values: Array) -> str:
    """Return a hash of numbers that rounding does not change."""
    return hashlib.sha256(np.round(values, 6).tobytes()).hexdigest()[:16]
