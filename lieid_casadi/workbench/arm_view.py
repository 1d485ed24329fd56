"""The arm in three dimensions: it replays the recording, coloured by error over noise floor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from nicegui import ui
from nicegui.elements.scene.scene_object3d import Object3D
from nicegui.events import SceneClickEventArguments, ValueChangeEventArguments

from lieid_casadi.workbench.arm import ArmMesh
from lieid_casadi.workbench.elements import SCALE, View, icon_button, named, ratio, ratio_colour
from lieid_casadi.workbench.workbench import Workbench

FRAME = 0.1  # s between poses of the replay
CLASSES = ("noise", "≤ 2 ×", "≤ 5 ×", "more")
BASE, SELECTED = "#d3d9de", "#10243a"


class ArmView(View):
    """The arm, with a slider for the instant that it shows; ``moved`` is called with it, s."""

    def __init__(self, workbench: Workbench, moved: Callable[[float], None]) -> None:
        super().__init__(workbench)
        self._moved = moved
        self._opened: object = None
        self._links: list[Object3D] = []
        self._meshes: list[tuple[ArmMesh, Object3D]] = []
        self._frame = -1
        self._colours: list[str] = []
        self._drawn: tuple[int, list[str]] | None = None
        self._seen: object = None
        self._instant: float | None = None
        with ui.column().classes("panel w-full h-full"):
            with ui.row().classes("w-full items-center gap-2 no-wrap"):
                ui.label("Arm").classes("panel-title grow")
                for text, colour in zip(CLASSES, [c for _, c in SCALE], strict=True):
                    ui.element("span").classes("swatch").style(f"background: {colour}")
                    ui.label(text).classes("small muted")
            self._scene = ui.scene(
                width=300,
                height=250,
                grid=(2, 10),
                background_color="#f7f9fa",
                fps=10,
                on_click=self._clicked,
            )
            named(self._scene, "arm-view").classes("arm-view")
            with ui.row().classes("w-full items-center gap-2 no-wrap"):
                self._play = icon_button("play_arrow", "play", "replay the recording")
                self._play.on_click(self._toggle)
                self._slider = ui.slider(
                    min=0.0, max=1.0, value=0.0, step=0.01, on_change=self._scrubbed
                )
                named(self._slider.classes("grow"), "scrubber")
                self._time = named(ui.label(""), "instant").classes("number small muted")
        self._timer = ui.timer(FRAME, self._advance, active=False)

    def update(self) -> None:
        """Show the arm of the open robot, its errors, and the visible range of time."""
        workbench = self.workbench
        if workbench.opened is not self._opened:
            self._opened = workbench.opened
            self._build()
        if workbench.opened is None:
            return
        self._colour()
        self._look()
        self._set_range()
        if workbench.view.instant not in (None, self._instant):
            self._slider.value = workbench.view.instant
        self._instant = workbench.view.instant
        if self._frame < 0:
            self._show(float(self._slider.value or 0.0))

    def _build(self) -> None:
        """Make the surfaces of the links."""
        self._scene.delete_objects()
        self._links, self._meshes, self._frame = [], [], -1
        self._drawn = None
        opened = self.workbench.opened
        if opened is None:
            return
        self._colours = [BASE, *(ratio_colour(None) for _ in opened.joint_names)]
        with self._scene as scene:
            for link in range(len(opened.joint_names) + 1):
                with scene.group() as group:
                    self._links.append(group)
                    for k, mesh in enumerate(opened.meshes):
                        if mesh.link == link:
                            made = scene.stl(f"/mesh/{self.workbench.name}/{k}.stl")
                            name = f"joint{link}" if link else "base"
                            self._meshes.append((mesh, made.with_name(name)))

    def _look(self) -> None:
        """Let the camera see the whole motion."""
        motion = self.workbench.motion
        if motion is None or motion is self._seen:
            return
        self._seen, self._frame = motion, -1
        x, y, z = motion.centre.tolist()
        far = 1.3 * max(motion.radius, 0.2)
        self._scene.move_camera(
            x + 0.5 * far, y - 0.75 * far, z + 0.45 * far, x, y, z, duration=0.0
        )

    def _colour(self) -> None:
        """Colour the links; while a model is fitted those of the last one stay."""
        session = self.workbench.session
        errors = None if session.step is None else session.step.errors
        if errors is not None:
            multiples = map(ratio, errors.shown, errors.noise_floor)
            self._colours = [BASE, *map(ratio_colour, multiples)]
        if (session.joint, self._colours) == self._drawn:
            return
        self._drawn = session.joint, self._colours
        for mesh, part in self._meshes:
            part.material(SELECTED if mesh.drum else self._colours[mesh.link])
            part.visible(not mesh.drum or mesh.link - 1 == session.joint)

    def _set_range(self) -> None:
        """Let the slider span the range of time that the torque plot shows."""
        workbench = self.workbench
        assert workbench.opened is not None
        if not workbench.opened.recordings:
            return
        recording = workbench.opened.recordings[workbench.session.recording]
        view = workbench.view
        low, high = view.selection or view.window or (recording.start, recording.end)
        if (self._slider.props["min"], self._slider.props["max"]) == (low, high):
            return
        self._slider.props["min"], self._slider.props["max"] = low, high
        self._slider.value = min(max(float(self._slider.value or 0.0), low), high)
        self._slider.update()

    def _toggle(self) -> None:
        self._timer.active = not self._timer.active
        self._play.props["icon"] = "pause" if self._timer.active else "play_arrow"
        self._play.update()

    def _advance(self) -> None:
        low, high = self._slider.props["min"], self._slider.props["max"]
        following = float(self._slider.value or 0.0) + FRAME
        self._slider.value = low if following > high else following

    def _scrubbed(self, event: ValueChangeEventArguments[float | None]) -> None:
        self._show(float(event.value or 0.0))

    def _show(self, time: float) -> None:
        """Show the pose at a time."""
        motion = self.workbench.motion
        self._time.text = f"{time:.2f} s"
        if motion is None or not self._links:
            return
        times, frames = motion.times, motion.poses
        frame = int(np.searchsorted(times, time).clip(0, len(times) - 1))
        if frame != self._frame and frames.shape[1] == len(self._links):
            self._frame = frame
            for link, pose in zip(self._links, frames[frame].tolist(), strict=True):
                link.move(pose[0][3], pose[1][3], pose[2][3])
                link.rotate_R([row[:3] for row in pose[:3]])
        self._moved(time)

    def _clicked(self, event: SceneClickEventArguments) -> None:
        names = [hit.object_name for hit in event.hits if hit.object_name.startswith("joint")]
        if names:
            workbench = self.workbench
            workbench.show(
                replace(workbench.session, joint=int(names[0].removeprefix("joint")) - 1)
            )
