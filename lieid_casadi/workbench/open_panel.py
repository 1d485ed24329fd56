"""What is open: robot or fit, recordings with their roles, torque constants and units."""

from __future__ import annotations

import contextlib
import gzip
import itertools
import re
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path, PurePath

import numpy as np
from nicegui import ui
from nicegui.events import UploadEventArguments

from lieid_casadi.recording.conversion import ANGLE_UNITS
from lieid_casadi.recording.readers.columns import TIMES, prefix_of
from lieid_casadi.recording.sample_timing import TIME_UNITS
from lieid_casadi.workbench.elements import View, button, icon_button, named, text
from lieid_casadi.workbench.session import RecordingInput, Role, WorkbenchInputs, upload_file
from lieid_casadi.workbench.workbench import Workbench

ROBOT_FILES = (".urdf", ".xml", ".yaml", ".yml", ".json")
LARGEST_UPLOAD = 4 << 30  # bytes
#: Options of the command line that are fields of the form.
OPTIONS = {
    "tip": "last link (URDF)",
    "lock": "joints to lock (URDF)",
    "torque-constants": "torque constants [N·m/A]",
    "units": "units: deg, ms; empty: SI",
    "stiffness": "stiffness K1,…,Kn [N·m/rad], or unknown",
    "damping": "damping D1,…,Dn [N·m·s/rad]",
    "servo": "servo, such as sts3215",
    "episodes": "episodes A:B (LeRobot)",
    "calibration": "calibration file, or limits (LeRobot)",
    "columns": "columns NAME=COLUMN,…, such as q=pos_*",
}
#: Signals that the dialog of columns assigns, with their meaning.
SIGNALS = {
    "t": "time [s]",
    "q": "joint positions [rad]",
    "dq": "joint velocities [rad/s]",
    "tau": "joint torques [N·m]",
    "i": "motor currents [A]",
    "qcmd": "commanded positions [rad]",
}
DEGREES = {"deg", "degree", "degrees"}  # in names of columns
IN_SIGHT = 4  # of these options; the others are folded
MOST_VALUES = 8  # of a signal in the preview
HEADER_LINES, HEADER_LENGTH = 1000, 1 << 16


class OpenPanel(View):
    """A form for the inputs, with the error of the last opening."""

    def __init__(self, workbench: Workbench) -> None:
        super().__init__(workbench)
        self._recordings: list[RecordingInput] = []
        with ui.column().classes("panel open-panel") as self._panel:
            with ui.element("div").classes("open-columns"):
                with ui.column().classes("gap-1 w-full"):
                    self._robot_fields()
                with ui.column().classes("gap-1 w-full"):
                    self._recording_fields()
            with ui.row().classes("items-center"):
                button("Open these", "open", self._open, "unelevated")
                button("Close", "close-form", self.toggle)
            self._error = named(ui.label(""), "open-error").classes("error-line")
        self._panel.set_visibility(False)
        self._error.set_visibility(False)

    def toggle(self) -> None:
        """Show or hide the form."""
        self._panel.set_visibility(not self._panel.visible)
        if self._panel.visible:
            self._fill()

    def update(self) -> None:
        """Show the form where nothing is open, and why the last opening failed."""
        workbench = self.workbench
        failure = workbench.failure
        nothing_open = workbench.opened is None and not workbench.computing
        if self.is_new(failure, nothing_open) and (failure or nothing_open):
            if not self._panel.visible:
                self._fill()
            self._panel.set_visibility(True)
        self._error.text = failure
        self._error.set_visibility(bool(failure))

    def _robot_fields(self) -> None:
        ui.label("Robot or fit").classes("panel-title")
        self._robot = _field("URDF, MJCF, YAML or fit file, or a bundled name", "open-robot")
        effects = "effects; empty: coulomb, viscous, offset, or the fit's"
        self._effects = _field(effects, "open-effects")
        fields = list(OPTIONS.items())
        with ui.element("div").classes("field-grid"):
            self._options = {name: _option_field(name, text) for name, text in fields[:IN_SIGHT]}
        with ui.expansion("commanded positions, datasets").props("dense").classes("w-full"):
            self._options |= {name: _option_field(name, text) for name, text in fields[IN_SIGHT:]}

    def _recording_fields(self) -> None:
        ui.label("Recordings").classes("panel-title")
        with ui.row().classes("w-full no-wrap items-center gap-2"):
            self._path = ui.input("path, or FILE@T0:T1").props("dense").classes("grow")
            named(self._path, "open-recording").on("keydown.enter", self._add_path)
            button("Add", "add-recording", self._add_path)
            columns = _ColumnsDialog(self._set_columns)
            units = self._options["units"]
            button(
                "Columns", "map-columns", lambda: columns.show(self._recordings, units.value or "")
            )
        upload = ui.upload(
            multiple=True, auto_upload=True, max_file_size=LARGEST_UPLOAD,
            label="or drop files of the robot and of recordings here", on_upload=self._uploaded,
        )  # fmt: skip
        ui.add_body_html(f"<script>acceptDrops({upload.id})</script>")
        named(upload.props("flat bordered dense"), "open-files").classes("w-full upload")
        self._list = ui.column().classes("gap-0 w-full")

    def _fill(self) -> None:
        """Show what is open."""
        inputs = self.workbench.session.inputs
        self._recordings = list(inputs.recordings)
        self._robot.value = inputs.fit or inputs.robot
        self._effects.value = ",".join(inputs.effects)
        for name, field in self._options.items():
            field.value = " ".join(dict(inputs.options).get(name, ()))
        self._list_recordings()

    def _list_recordings(self) -> None:
        self._list.clear()
        opened = self.workbench.opened
        paths = [r.path for r in self.workbench.session.inputs.recordings]
        read = [] if opened is None else opened.recordings
        known = dict(zip(paths, read, strict=False))  # none is read before the first opening
        with self._list:
            for k, recording in enumerate(self._recordings):
                with ui.row().classes("w-full no-wrap items-center gap-1"):
                    name = text(PurePath(recording.path).name, "grow ellipsis")
                    name.props["title"] = recording.path
                    role = ui.toggle(
                        {"train": "fit", "test": "test"},
                        value=recording.role,
                        on_change=lambda event, k=k: self._set_role(k, event.value),
                    )
                    named(role.props("dense no-caps size=sm"), f"role-{k + 1}")
                    remove = icon_button("close", f"remove-recording-{k + 1}", "remove")
                    remove.on_click(lambda k=k: self._remove(k))
                if recording.path in known:
                    for warning in known[recording.path].warnings:
                        ui.label(warning).classes("warning small")

    def _add_path(self) -> None:
        path = (self._path.value or "").strip()
        if path:
            self._add(path)
            self._path.value = ""

    def _add(self, path: str) -> None:
        """Add a recording: the first is fitted, later ones are tests."""
        role: Role = "test" if any(r.role == "train" for r in self._recordings) else "train"
        self._recordings.append(RecordingInput(path, role))
        self._list_recordings()

    def _set_columns(self, columns: str, units: str) -> None:
        self._options["columns"].value, self._options["units"].value = columns, units

    def _set_role(self, k: int, role: Role) -> None:
        self._recordings[k] = replace(self._recordings[k], role=role)

    def _remove(self, k: int) -> None:
        del self._recordings[k]
        self._list_recordings()

    async def _uploaded(self, event: UploadEventArguments) -> None:
        name = PurePath(event.file.name.replace("\\", "/")).name
        if name in ("", ".", ".."):
            return
        target = upload_file(self.workbench.name, name)
        await event.file.save(target)
        if not self._panel.visible:  # they were dropped elsewhere on the page
            self.toggle()
        if target.suffix.lower() in ROBOT_FILES:
            self._robot.value = str(target)
        else:
            self._add(str(target))

    async def _open(self) -> None:
        source = (self._robot.value or "").strip()
        is_fit = Path(source).suffix.lower() == ".json"
        # options of the command line that the form does not show stay
        options = [o for o in self.workbench.session.inputs.options if o[0] not in OPTIONS]
        given = {name: (field.value or "").strip() for name, field in self._options.items()}
        options += [
            (name, tuple(text.split()) if name == "lock" else (text,))
            for name, text in given.items()
            if text
        ]
        inputs = WorkbenchInputs(
            robot="" if is_fit else source,
            fit=source if is_fit else "",
            recordings=tuple(self._recordings),
            effects=tuple(e for e in (self._effects.value or "").split(",") if e.strip()),
            options=tuple(options),
        )
        if await self.workbench.open(inputs) and self.workbench.opened is not None:
            if any(r.warnings for r in self.workbench.opened.recordings):
                self._list_recordings()
            else:
                self._panel.set_visibility(False)


def _field(label: str, test_id: str) -> ui.input:
    return named(ui.input(label).props("dense").classes("w-full"), test_id)


def _option_field(name: str, label: str) -> ui.input:
    return _field(label, f"open-{name.removeprefix('torque-')}")


class _ColumnsDialog:
    """Assigns the columns of the first recording to signals, and states their units."""

    def __init__(self, done: Callable[[str, str], None]) -> None:
        self._values: dict[str, list[str]] = {}
        with ui.dialog().props("transition-duration=0") as self._dialog, ui.card():
            self._title = ui.label("").classes("panel-title")
            with ui.element("div").classes("field-grid"):
                self._chosen = {
                    name: self._select(f"column-{name}", meaning).props("clearable")
                    for name, meaning in SIGNALS.items()
                }
                self._angle = self._select("unit-angle", "unit of angles", ANGLE_UNITS)
                self._time = self._select("unit-time", "unit of time", TIME_UNITS)
            self._text = named(ui.label("").classes("code"), "columns-text")
            with ui.row():
                button("Use", "use-columns", lambda: self._use(done), "unelevated")
                button("Close", "close-columns", self._dialog.close)

    def _select(self, test_id: str, label: str, units: Iterable[str] = ()) -> ui.select:
        made = ui.select(list(units), label=label, value=next(iter(units), None))
        made.props("dense options-dense")
        return named(made, test_id).classes("column-choice").on_value_change(self._preview)

    def show(self, recordings: list[RecordingInput], units: str) -> None:
        """Show the columns of the first recording, and propose their meaning and units."""
        path = recordings[0].path.rpartition("@")[0] or recordings[0].path if recordings else ""
        self._values = first_values(path)
        patterns = list(self._values)
        name = PurePath(path).name or "no recording"
        what = "columns (* is the number of the joint)" if patterns else "its columns are not known"
        self._title.text = f"{name}: {what}"
        proposed = proposed_columns(patterns)
        for signal, choice in self._chosen.items():
            choice.set_options(patterns, value=proposed.get(signal))
        stated = units.split(",") if units else proposed_units(proposed, self._values)
        self._angle.value = next((u for u in ANGLE_UNITS if u in stated), "rad")
        self._time.value = next((u for u in TIME_UNITS if u in stated), "s")
        self._preview()
        self._dialog.open()

    def _stated(self) -> tuple[str, str]:
        columns = [
            f"{name}={choice.value}" for name, choice in self._chosen.items() if choice.value
        ]
        units = [u for u in (self._angle.value, self._time.value) if u not in ("rad", "s")]
        return ",".join(columns), ",".join(units)

    def _preview(self) -> None:
        """Show the options, and the first row in SI units."""
        columns, units = self._stated()
        shown = [f"--columns {columns}{' --units ' * bool(units)}{units}", "", "first row"]
        factors = dict.fromkeys(("q", "dq", "qcmd"), ANGLE_UNITS.get(self._angle.value, 1.0))
        factors["t"] = TIME_UNITS.get(self._time.value, 1.0)
        for name, choice in self._chosen.items():
            values = self._values.get(choice.value or "", [])[:MOST_VALUES]
            if choice.value:
                more = " …" if len(self._values.get(choice.value, [])) > MOST_VALUES else ""
                converted = (_converted(value, factors.get(name, 1.0)) for value in values)
                unit = SIGNALS[name].rpartition("[")[2].rstrip("]")
                shown.append(f"{name}: {'  '.join(converted)}{more} {unit}")
        self._text.text = "\n".join(shown)

    def _use(self, done: Callable[[str, str], None]) -> None:
        done(*self._stated())
        self._dialog.close()


def _converted(text: str, factor: float) -> str:
    """Return a number of a file in SI units; text that is none as it is."""
    with contextlib.suppress(ValueError):
        return text if factor == 1.0 else f"{factor * float(text):.6g}"
    return text


def first_values(path: str) -> dict[str, list[str]]:
    """Return the columns of a CSV or NPZ with ``*`` for numbers, and the values of the first row.

    None of other files.
    """
    row: list[tuple[str, str]] = []
    with contextlib.suppress(OSError, ValueError, EOFError, IndexError):
        if path.lower().endswith(".npz"):
            with np.load(path, allow_pickle=False) as arrays:
                for name in arrays.files:
                    row += [(name, f"{x}") for x in np.ravel(np.atleast_1d(arrays[name])[:1])]
        elif path.lower().endswith((".csv", ".csv.gz")) and Path(path).is_file():
            opened = gzip.open if path.lower().endswith(".gz") else open
            with opened(path, "rt", encoding="utf-8", errors="replace") as file:
                read = (file.readline(HEADER_LENGTH) for _ in range(HEADER_LINES))
                lines = (line for line in read if not line.startswith("#"))
                header, values = (next(lines, "").strip().split(",") for _ in range(2))
                row = [
                    (n.strip(), v) for n, v in itertools.zip_longest(header, values, fillvalue="")
                ]
    found: dict[str, list[str]] = {}
    for name, value in row:
        if name:
            found.setdefault(re.sub(r"\d+", "*", name, count=1), []).append(value.strip()[:9])
    return found


def proposed_columns(patterns: list[str]) -> dict[str, str]:
    """Return the pattern of each signal whose name states its meaning.

    Examples
    --------
    >>> proposed_columns(["stamp", "pos_*", "vel_*", "target_pos_*", "effort_*", "effort_error_*"])
    {'t': 'stamp', 'q': 'pos_*', 'dq': 'vel_*', 'qcmd': 'target_pos_*', 'tau': 'effort_*'}
    """
    found: dict[str, str] = {}
    for pattern in patterns:
        name = prefix_of(_words(pattern) - DEGREES)
        if "_".join(w for w in pattern.lower().split("_") if w not in TIME_UNITS) in TIMES:
            found.setdefault("t", pattern)
        elif name in SIGNALS:
            found.setdefault(name, pattern)
    return found


def proposed_units(columns: dict[str, str], values: dict[str, list[str]]) -> list[str]:
    """Return units other than SI that names of columns state, or angles beyond two turns.

    Examples
    --------
    >>> proposed_units({"t": "time_ms", "q": "pos_*"}, {"pos_*": ["-90", "10"]})
    ['deg', 'ms']
    """
    angles = columns.get("q", "")
    large = False
    with contextlib.suppress(ValueError):
        large = any(abs(float(x)) > 4.0 * np.pi for x in values.get(angles, ()))
    found = ["deg"] if _words(angles) & DEGREES or large else []
    return found + [unit for unit in TIME_UNITS if unit in _words(columns.get("t", "")) - {"s"}]


def _words(pattern: str) -> set[str]:
    return set(re.findall("[a-z]+", pattern.lower()))
