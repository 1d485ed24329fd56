"""Whether a fleet file is plausible: its entries, its recordings, and the premises of every arm."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Any

import numpy as np

from lieid_casadi.errors import LieidError
from lieid_casadi.fleet.arm_night import load_night
from lieid_casadi.fleet.config import Dated, Fleet, FleetArm
from lieid_casadi.fleet.night_result import ArmNight
from lieid_casadi.fleet.recordings import is_local, local_copy
from lieid_casadi.fleet.run import LoadedFit, fits_of, recordings_of
from lieid_casadi.premises import check_where_possible
from lieid_casadi.tables import Table, make_table

LARGEST_CONSTANT = 1000.0  # N·m/A at the joint: gear ratio 500 and a motor of 2 N·m/A
LARGEST_PAYLOAD = 1000.0  # kg, of robots that do not state the masses of their links
FARTHEST_COM = 2.0  # m from the tool

#: Locations that a worker cannot see, by the worker's address.
Unseen = Mapping[str, Sequence[str]]


@dataclass(frozen=True)
class ArmCheck:
    """What was found about one arm: sentences of what is certainly wrong, and of what may be."""

    serial: str
    recordings: int = 0
    newest: date | None = None  # night of the newest recording
    recording: str | None = None  # that was tested
    wrong: tuple[str, ...] = ()
    doubtful: tuple[str, ...] = ()
    premises: tuple[dict[str, Any], ...] = ()  # findings about the premises, which are in these too

    @property
    def verdict(self) -> str:
        """``wrong``, ``doubtful`` or ``sound``."""
        return "wrong" if self.wrong else "doubtful" if self.doubtful else "sound"

    @property
    def sentences(self) -> list[str]:
        """What was found, what is wrong first."""
        return [*(f"!! {text}" for text in self.wrong), *(f"! {text}" for text in self.doubtful)]

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of the JSON's ``arms``."""
        newest = None if self.newest is None else self.newest.isoformat()
        return vars(self) | {"verdict": self.verdict, "newest": newest}


def check_fleet(
    fleet: Fleet,
    *,
    unseen: Callable[[Sequence[str]], Unseen] | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> list[ArmCheck]:
    """Check the entries of a fleet file, and the newest recording of every arm by its premises."""
    report = progress or (lambda stage, fraction: None)
    checks, owners = [], defaultdict[str, list[str]](list)
    for k, arm in enumerate(fleet.arms):
        report(arm.serial, k / len(fleet.arms))
        found, locations = _check_arm(arm, fleet)
        checks.append(found)
        for location in locations:
            owners[location].append(arm.serial)
    shared = defaultdict[str, list[str]](list)
    for location, serials in owners.items():
        for serial in serials if len(serials) > 1 else ():
            others = ", ".join(other for other in serials if other != serial)
            shared[serial].append(f"{location} is a recording of {others} as well")
    paths = [check.recording for check in checks if check.recording and is_local(check.recording)]
    lost = unseen(paths) if unseen is not None else {}
    for worker, missing in lost.items():
        for check in checks:
            if check.recording in missing:
                text = f"worker {worker} cannot see {check.recording}; mount it there, or use a URL"
                shared[check.serial].append(text)
    return [replace(c, wrong=(*c.wrong, *shared[c.serial][:3])) for c in checks]


def _check_arm(arm: FleetArm, fleet: Fleet) -> tuple[ArmCheck, list[str]]:
    """Return what is found about an arm alone, and the places of its recordings."""
    check = ArmCheck(arm.serial)
    try:
        fits = fits_of(arm)
    except LieidError as error:
        return replace(check, wrong=(str(error),)), []
    wrong = implausible_entries(arm, fits)
    empty = ArmNight(arm.serial, datetime.now(UTC).date().isoformat(), "", "", "")
    found = list(recordings_of(arm, fleet, fits, empty))
    wrong += [reason for _, reason in found if reason][:3]
    nights = sorted((night for night, reason in found if not reason), key=lambda n: n.date)
    doubtful = list[str]()
    if not nights and not wrong:
        wrong.append(f"{', '.join(arm.recordings)}: no recording to judge; expected at least one")
    check = replace(check, recordings=len(nights))
    if nights:
        newest = nights[-1]
        check = replace(check, newest=date.fromisoformat(newest.date), recording=newest.recording)
        content = {each.value.sha256: each.value.content for each in fits}[newest.fit_sha256]
        try:
            with local_copy(newest.recording) as path:
                fit, recording = load_night(newest, content, path)
            premises = check_where_possible(fit, [recording])
            check = replace(check, premises=tuple(premises.to_dict()["findings"]))
            for finding in premises.findings:
                (wrong if finding.certain else doubtful).append(finding.sentence)
        except LieidError as error:
            wrong.append(str(error))
    locations = [night.recording for night, _ in found if night.recording]
    return replace(check, wrong=tuple(wrong), doubtful=tuple(doubtful)), locations


def implausible_entries(arm: FleetArm, fits: Sequence[Dated[LoadedFit]]) -> list[str]:
    """Return what is wrong with payloads and torque constants of an arm: their units, mostly."""
    found = []
    robot = fits[-1].value.fit.model.robot
    masses = [joint.link[0] for joint in robot.joints if joint.link is not None]
    own = float(np.sum(masses)) if len(masses) == robot.n else LARGEST_PAYLOAD
    for payload in (entry.value for entry in arm.payloads):
        mass, *moment = payload.parameters[:4]
        if mass > own:
            all_known = len(masses) == robot.n
            of = f"the arm itself has {own:.3g} kg" if all_known else "no arm carries that"
            found.append(f"payload of {mass:g} kg; {of}: expected kg")
        elif mass > 0.0 and (distance := float(np.linalg.norm(moment)) / mass) > FARTHEST_COM:
            found.append(f"payload with com at {distance:.3g} m from the tool: expected m")
    for entry in arm.torque_constants:
        size = float(np.abs(entry.value).max())
        stated = np.nanmax(np.append(np.abs(robot.torque_constants), 0.0))
        if size > LARGEST_CONSTANT or (stated > 0.0 and size > 100.0 * stated):
            found.append(f"torque constant of {size:g} N·m/A: expected N·m per A at the joint")
    return found


def missing_files(paths: Sequence[str]) -> list[str]:
    """Return which paths do not exist on the machine of this process."""
    return [path for path in paths if not Path(path).exists()]


def check_table(checks: Sequence[ArmCheck]) -> Table:
    """Return one row per arm, those with findings first."""
    order = {"wrong": 0, "doubtful": 1, "sound": 2}
    rows = [
        (c.serial, c.recordings, c.newest, c.verdict)
        for c in sorted(checks, key=lambda c: (order[c.verdict], c.serial))
    ]
    return make_table("Arms of the fleet file", ("serial", "recordings", "newest", "verdict"), rows)
