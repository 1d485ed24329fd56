"""The folder of an experiment: what every round used and found, complete after each of them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from lieid_casadi.atomic_file import atomic_binary, check_parent
from lieid_casadi.diagnosis import Diagnosis
from lieid_casadi.errors import OutputError
from lieid_casadi.excitation.trajectory import MotionSamples
from lieid_casadi.experiments.motion import PlannedMotion
from lieid_casadi.experiments.result import Round
from lieid_casadi.recording import Recording
from lieid_casadi.robot import Robot

STATE = "experiment.json"
SCHEMA = 1


@dataclass(frozen=True)
class ExperimentFolder:
    """``experiment.json`` and ``round-N`` with trajectory, recording, diagnosis and fit.

    ``identity`` is what must be the same in a second call with the same folder.
    """

    path: Path
    identity: Mapping[str, Any]

    @classmethod
    def of(cls, path: str | Path, identity: Mapping[str, Any]) -> ExperimentFolder:
        """Return the folder, made if it does not exist, if it holds this experiment or nothing."""
        folder = cls(Path(path), identity)
        state = folder.state()
        if state is not None and state.get("identity") != dict(identity):
            other = [k for k, v in identity.items() if state.get("identity", {}).get(k) != v]
            raise OutputError(
                f"{path}: holds an experiment with another {', '.join(other) or 'setting'}; "
                "expected a new folder, or the same arguments to resume"
            )
        if state is None:
            folder.path.mkdir(parents=True, exist_ok=True)
            folder.keep({"rounds": []})
        return folder

    def state(self) -> dict[str, Any] | None:
        """Return the content of ``experiment.json``; None in a new folder."""
        file = self.path / STATE
        if not file.exists():
            if self.path.exists() and (not self.path.is_dir() or any(self.path.iterdir())):
                raise OutputError(
                    f"{self.path}: not empty and without {STATE}; expected a new or empty folder"
                )
            check_parent(self.path)
            return None
        try:
            content = json.loads(file.read_text("utf-8"))
            if content["schema"] != SCHEMA:
                raise ValueError(f"schema {content['schema']}")
            return dict(content)
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise OutputError(f"{file}: cannot be resumed: {error}") from None

    def rounds(self) -> list[Round]:
        """Return the rounds so far."""
        state = self.state()
        try:
            return msgspec.convert([] if state is None else state["rounds"], list[Round])
        except (msgspec.ValidationError, KeyError) as error:
            raise OutputError(f"{self.path / STATE}: cannot be resumed: {error}") from None

    def round(self, number: int) -> Path:
        """Return the folder of a round, made if it does not exist."""
        folder = self.path / f"round-{number}"
        folder.mkdir(exist_ok=True)
        return folder

    def recording(self, number: int, load: Callable[[Path], Recording]) -> Recording:
        """Return the recording of a round."""
        return load(self.path / f"round-{number}" / "recording.csv")

    def keep_motion(self, motion: PlannedMotion) -> None:
        """Write the trajectory of a round."""
        with atomic_binary(self.round(motion.number) / "trajectory.csv") as file:
            file.write(motion.csv().encode())

    def keep_recording(self, motion: PlannedMotion, recording: Recording) -> None:
        """Write a recording that a function returned; that of a command is there already."""
        file = self.round(motion.number) / "recording.csv"
        if not file.exists():
            recording.save(file)

    def keep_diagnosis(self, number: int, diagnosis: Diagnosis) -> None:
        """Write diagnosis and fit of a round."""
        folder = self.round(number)
        self._write(folder / "diagnosis.json", diagnosis.to_dict())
        diagnosis.fit.save(folder / "fit.json")

    def keep(self, content: Mapping[str, Any]) -> None:
        """Write ``experiment.json``."""
        self._write(self.path / STATE, {"identity": dict(self.identity), **content})

    def probe(self, design: Callable[[], MotionSamples]) -> MotionSamples:
        """Return the probe motion of an earlier call, or a new one."""
        file = self.path / "probe.npz"
        if not file.exists():
            probe = design()
            with atomic_binary(file) as written:
                np.savez(written, t=probe.t, q=probe.q, dq=probe.dq, ddq=probe.ddq)
        try:
            with np.load(file) as arrays:
                return MotionSamples(*(arrays[name] for name in ("t", "q", "dq", "ddq")))
        except (OSError, ValueError, KeyError) as error:
            raise OutputError(f"{file}: cannot be resumed: {error}") from None

    def _write(self, path: Path, content: Mapping[str, Any]) -> None:
        text = json.dumps(
            {"schema": SCHEMA, **content}, indent=1, ensure_ascii=False, allow_nan=False
        )
        with atomic_binary(path) as file:
            file.write(text.encode(errors="backslashreplace"))


def identity_of(
    robot: Robot, given: Sequence[Recording], probe: float, seed: int
) -> dict[str, Any]:
    """Return what must be the same when an experiment is resumed."""
    numbers = [robot.link_parameters, robot.limit("velocity"), robot.limit("position_upper")]
    return {
        "robot": robot.name,
        "numbers": hashlib.sha256(np.concatenate(numbers).tobytes()).hexdigest()[:16],
        "given": [{"name": r.name, "sha256": r.source_hash} for r in given],
        "probe": probe,
        "seed": seed,
    }
