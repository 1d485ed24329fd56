"""The arm in three dimensions: it replays a motion; on the page coloured by error over noise."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import isfinite

import numpy as np
from nicegui import ui
from nicegui.elements.scene.scene_object3d import Object3D
from nicegui.events import SceneClickEventArguments

from lieid_casadi.workbench import elements
from lieid_casadi.workbench.arm import ArmMesh, ArmMotion
from lieid_casadi.workbench.workbench import Workbench

FRAME = 0.1  # s between poses of the replay
BASE, SELECTED = "#d3d9de", "#10243a"


class ArmScene:
    """The arm, with a slider for the instant that it shows; ``moved`` is called with it, s."""

    def __init__(
        self,
        *,
        moved: Callable[[float], None] = lambda time: None,
        clicked: Callable[[int], None] = lambda link: None,
    ) -> None:
        self._moved, self._clicked = moved, clicked
        self._links: list[Object3D] = []
        self._meshes: list[tuple[ArmMesh, Object3D]] = []
        self._motion: ArmMotion | None = None
        self._frame = -1
        self._timer = ui.timer(FRAME, self._advance, active=False)
        self._scene = ui.scene(
            width=300, height=250, grid=(2, 10), background_color="#f7f9fa", fps=10,
            on_click=self._hit,
        )  # fmt: skip
        elements.named(self._scene, "arm-view").classes("arm-view")
        elements.call("drawChanges", self._scene)
        with ui.row().classes("w-full items-center gap-2 no-wrap"):
            self._play = elements.icon_button("play_arrow", "play", "replay the motion")
            self._play.on_click(lambda: self.play(not self._timer.active))
            self._slider = ui.slider(
                min=0.0, max=1.0, value=0.0, step=0.01, on_change=lambda: self.show()
            )
            elements.named(self._slider.classes("grow"), "scrubber")
            self._time = elements.named(ui.label(""), "instant").classes("number small muted")

    def build(self, meshes: Sequence[ArmMesh], address: str) -> None:
        """Make the surfaces of the links, which the server has at ``address/NUMBER.stl``."""
        self._scene.delete_objects()
        self._links, self._meshes, self._motion = [], [], None
        with self._scene as scene:
            for link in range(max((mesh.link for mesh in meshes), default=-1) + 1):
                with scene.group() as group:
                    self._links.append(group)
                    for k, mesh in enumerate(meshes):
                        if mesh.link == link:
                            made = scene.stl(f"{address}/{k}.stl")
                            name = f"joint{link}" if link else "base"
                            self._meshes.append((mesh, made.with_name(name)))

    def colour(self, colours: Sequence[str], joint: int | None) -> None:
        """Colour the base and the links, and mark a joint, from 0."""
        for mesh, part in self._meshes:
            part.material(SELECTED if mesh.drum else colours[mesh.link])
            part.visible(not mesh.drum or mesh.link - 1 == joint)

    def show_motion(self, motion: ArmMotion | None) -> None:
        """Let the camera see a whole motion."""
        if motion is None or motion is self._motion:
            return
        self._motion, self._frame = motion, -1
        x, y, z = motion.centre.tolist()
        far = 1.3 * max(motion.radius, 0.2)
        self._scene.move_camera(
            x + 0.5 * far, y - 0.75 * far, z + 0.45 * far, x, y, z, duration=0.0
        )
        self.show()

    def limit(self, low: float, high: float) -> None:
        """Let the slider span a range of time, s."""
        if (self._slider.props["min"], self._slider.props["max"]) == (low, high):
            return
        self._slider.props["min"], self._slider.props["max"] = low, high
        self._slider.value = min(max(float(self._slider.value or 0.0), low), high)
        self._slider.update()

    def play(self, on: bool) -> None:
        """Replay the motion, or stop."""
        self._timer.active = on
        self._play.props["icon"] = "pause" if on else "play_arrow"
        self._play.update()

    def show(self, time: float | None = None) -> None:
        """Show the pose at a time, or that of the slider."""
        if time is not None and time != self._slider.value:
            self._slider.value = time  # calls this again
            return
        time = float(self._slider.value or 0.0)
        self._time.text = f"{time:.2f} s"
        if self._motion is None or not self._links:
            return
        times, frames = self._motion.times, self._motion.poses
        frame = int(np.searchsorted(times, time).clip(0, len(times) - 1))
        if frame != self._frame and frames.shape[1] == len(self._links):
            self._frame = frame
            for link, pose in zip(self._links, frames[frame].tolist(), strict=True):
                link.move(pose[0][3], pose[1][3], pose[2][3])
                link.rotate_R([row[:3] for row in pose[:3]])
        self._moved(time)

    def _advance(self) -> None:
        low, high = self._slider.props["min"], self._slider.props["max"]
        following = float(self._slider.value or 0.0) + FRAME
        self._slider.value = low if following > high else following

    def _hit(self, event: SceneClickEventArguments) -> None:
        names = [hit.object_name for hit in event.hits if hit.object_name.startswith("joint")]
        if names:
            self._clicked(int(names[0].removeprefix("joint")))


class ArmView(elements.View):
    """The arm along the recording; ``moved`` is called with the instant that it shows, s."""

    def __init__(self, workbench: Workbench, moved: Callable[[float], None]) -> None:
        super().__init__(workbench)
        self._opened: object = None
        self._colours: list[str] = []
        self._instant: float | None = None
        with ui.column().classes("panel w-full"):
            with ui.row().classes("w-full items-center gap-1 no-wrap") as legend:
                ui.label("Arm").classes("panel-title grow")
                for most, colour in elements.SCALE:
                    ui.element("span").classes("swatch").style(f"background: {colour}")
                    ui.label(f"≤ {most:g} ×" if isfinite(most) else "more").classes("small muted")
            legend.props["title"] = "error over noise floor"
            self._arm = ArmScene(moved=moved, clicked=self._select)

    def _select(self, link: int) -> None:
        self.workbench.show(replace(self.workbench.session, joint=link - 1))

    def update(self) -> None:
        """Show the arm of the open robot, its errors, and the visible range of time."""
        workbench, opened = self.workbench, self.workbench.opened
        if opened is None:
            return
        if opened is not self._opened:
            self._opened = opened
            self._arm.build(opened.meshes, f"/mesh/{workbench.name}")
            self._colours = [BASE, *(elements.ratio_colour(None) for _ in opened.joint_names)]
        session, view = workbench.session, workbench.view
        errors = None if session.step is None else session.step.errors
        if errors is not None:  # while a model is fitted the colours of the last one stay
            multiples = map(elements.ratio, errors.shown, errors.noise_floor)
            self._colours = [BASE, *map(elements.ratio_colour, multiples)]
        if self.is_new(opened, session.joint, self._colours):
            self._arm.colour(self._colours, session.joint)
        if opened.recordings:
            recording = opened.recordings[session.recording]
            self._arm.limit(*(view.selection or view.window or (recording.start, recording.end)))
        self._arm.show_motion(workbench.motion)
        if view.instant not in (None, self._instant):
            self._arm.show(view.instant)
        self._instant = view.instant
