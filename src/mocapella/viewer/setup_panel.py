"""The folder with the form of the session's setup, in one browser's panel."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import viser

from mocapella.errors import SettingsError
from mocapella.model.session import PLACEMENTS, SCENARIOS, SessionStatus, Setup
from mocapella.viewer.inputs import set_value
from mocapella.viewer.setup_form import (
    HEIGHT_M,
    NONE,
    TILT_DEG,
    PoseField,
    SetupFields,
    fields_of,
    merge,
    setup_arguments,
)

TILT_LABEL = f"Tilt (±{TILT_DEG[1]:g}°)"
HEIGHT_LABEL = f"Height ({HEIGHT_M[0]:g}–{HEIGHT_M[1]:g} m)"


class PoseInputs:
    """Inputs of a sensor's pose, in a folder with the sensor's name. `PoseField.check` checks the values later.

    Args:
        gui: controls of the browser.
        sensor: name of the sensor.
        pose: initial values.
    """

    def __init__(self, gui: viser.GuiApi, sensor: str, pose: PoseField) -> None:
        with gui.add_folder(f"Sensor {sensor}") as self._folder:
            self._tilt = gui.add_number(
                TILT_LABEL, pose.tilt_deg, step=0.01, hint="How far the sensor looks up; downwards is negative"
            )
            self._height = gui.add_number(
                HEIGHT_LABEL, pose.height_m, step=0.01, hint="Of the sensor over the floor; 0 where it is not known"
            )

    @property
    def value(self) -> PoseField:
        """Present values of the inputs; they can be assigned."""
        return PoseField(self._tilt.value, self._height.value)

    @value.setter
    def value(self, pose: PoseField) -> None:
        set_value(self._tilt, pose.tilt_deg)
        set_value(self._height, pose.height_m)

    def enable(self, enabled: bool) -> None:
        """Enable or disable the inputs."""
        self._tilt.disabled = self._height.disabled = not enabled

    def remove(self) -> None:
        """Remove the folder."""
        self._folder.remove()


class SetupPanel:
    """The folder "Setup": it shows the server's setup, and keeps edited values until they are applied or reverted.

    Args:
        gui: controls of the browser.
        methods: names of the tracking methods to offer.
        apply: is called with the arguments of the server's command ``setup`` when the user applies the form.
        refuse: is called with a message if the form has an invalid value.
        visible: whether the folder is visible.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        methods: Sequence[str],
        apply: Callable[[dict[str, Any]], None],
        refuse: Callable[[str], None],
        *,
        visible: bool = True,
    ) -> None:
        self._gui, self._apply, self._refuse = gui, apply, refuse
        self._applied = SetupFields()
        self._setup: Setup | None = None
        self._poses: dict[str, PoseInputs] = {}
        with gui.add_folder("Setup", expand_by_default=False, visible=visible) as self._folder:
            self._method = gui.add_dropdown("Method", tuple(methods), hint="How skeletons become people")
            self._expected = gui.add_number("Wait for", 1, step=1, hint="How many sensors to wait for; 1 or more")
            self._participant = gui.add_text("Participant", "", hint="The study's whole number of the person, or empty")
            self._placement = gui.add_dropdown("Placement", (NONE, *PLACEMENTS))
            self._scenario = gui.add_dropdown("Scenario", (NONE, *SCENARIOS))
            self._apply_button = gui.add_button("Apply setup", disabled=True, order=1e9, icon=viser.Icon.CHECK)
            self._revert_button = gui.add_button(
                "Revert edits", disabled=True, order=1e9 + 1, color="gray", icon=viser.Icon.ARROW_BACK_UP
            )

        @self._apply_button.on_click
        async def _(_: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            self._send()

        @self._revert_button.on_click
        async def _(_: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            self._write(self._applied)

    def show(self, status: SessionStatus | None, *, enabled: bool) -> None:
        """Show the server's setup, except in edited fields, and enable the controls; call it in every update.

        Args:
            status: newest status of the session; None without a server.
            enabled: whether the setup can be changed now.
        """
        if status is not None and status.setup is not self._setup:
            self._take_up(status)
        edited = self._setup is not None and self._read() != self._applied
        self._apply_button.disabled = not (enabled and edited)
        self._revert_button.disabled = not edited
        for handle in (self._method, self._expected, self._participant, self._placement, self._scenario):
            handle.disabled = not enabled
        for pose in self._poses.values():
            pose.enable(enabled)

    def _take_up(self, status: SessionStatus) -> None:
        now = fields_of(status)
        before = self._applied if self._setup is not None else self._read()
        self._make_pose_fields(now)
        self._write(merge(self._read(), before, now))
        self._applied, self._setup = now, status.setup

    def _make_pose_fields(self, now: SetupFields) -> None:
        for name in self._poses.keys() - now.poses.keys():
            self._poses.pop(name).remove()
        for name, pose in now.poses.items():
            if name not in self._poses:
                with self._folder:
                    self._poses[name] = PoseInputs(self._gui, name, pose)

    def _read(self) -> SetupFields:
        return SetupFields(
            method=self._method.value,
            sensors_expected=int(self._expected.value),
            participant=self._participant.value,
            placement=self._placement.value,
            scenario=self._scenario.value,
            poses={name: inputs.value for name, inputs in self._poses.items()},
        )

    def _write(self, fields: SetupFields) -> None:
        for menu, name in (
            (self._method, fields.method), (self._placement, fields.placement), (self._scenario, fields.scenario)
        ):  # fmt: skip
            if name not in menu.options:  # of a plug-in, or of a study's protocol
                menu.options = (*menu.options, name)
        set_value(self._method, fields.method)
        set_value(self._expected, fields.sensors_expected)
        set_value(self._participant, fields.participant)
        set_value(self._placement, fields.placement)
        set_value(self._scenario, fields.scenario)
        for name, pose in fields.poses.items():
            self._poses[name].value = pose

    def _send(self) -> None:
        assert self._setup is not None, "the button is disabled until there is a setup"
        try:
            arguments = setup_arguments(self._read(), self._applied, self._setup)
        except SettingsError as error:
            self._refuse(str(error))
            return
        self._apply(arguments)
