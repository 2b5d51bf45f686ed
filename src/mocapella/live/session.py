"""A session: the setup, the tracker, and the commands that change them; without threads.

A replay passes a take's recorded commands to the same `Session`, so it repeats the live run.
"""

from __future__ import annotations

import base64
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final, cast

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.sensor_layout import SensorLayout, decode_layout, encode_layout
from mocapella.decoding import FAULTS
from mocapella.errors import InputError, NotNowError, SettingsError, WireError, one_of
from mocapella.model.camera_rig_file import decode_camera_rig
from mocapella.model.observations import Arrival
from mocapella.model.scene import Phase, Scene, TrackerState
from mocapella.model.session import STUDY_EVENT, PersonName, Setup
from mocapella.settings import parse
from mocapella.tracker import METHODS, Tracker, make_tracker
from mocapella.tracker.protocol import ExpectsPeople, KeepsLayout

Float32 = NDArray[np.float32]

_LAYOUT: Final = "rig"
"""Key of the sensor layout among the arguments of ``restore``, as stored in takes."""


@dataclass(frozen=True)
class _UseRig:
    rig: str
    method: str = ""


def _stopped(reason: str = "") -> TrackerState:
    return TrackerState(Phase.STOPPED, reason=reason)


def _waiting(setup: Setup) -> TrackerState:
    return TrackerState(Phase.WAITING_FOR_SENSORS, setup.sensors_expected)


class Session:
    """A tracker with its setup, controlled by commands: frames in, scenes out, without threads and clocks.

    Args:
        setup: the first setup.
        method_settings: settings of its method, by name.
        running: whether tracking begins at once.
        layout: the sensors' last known poses; None if unknown.
        waiting_for: if tracking cannot begin yet, the reason, as in ``state`` until `ready`; ``start`` is refused.

    Attributes:
        setup: the present setup. Each method keeps its own settings while another method is set up.
        layout: the sensors' last known poses; every new tracker starts from them, until a recalibration.
        running: whether frames are tracked.
        next_step: number of the next scene; starts at 0 with every tracker.
        names: people's names by id. A new tracker assigns new ids, and starts without names.
        state: phase of the tracker, with the reason and progress.
        problem: why the tracker could not use the last frame; empty if it could.
        trackers: number of trackers made so far. Other labels of the setup make no new one.

    Raises:
        SettingsError: the setup or the method's settings are invalid.
    """

    def __init__(
        self,
        setup: Setup,
        method_settings: Mapping[str, Any] | None = None,
        *,
        running: bool = True,
        layout: SensorLayout | None = None,
        waiting_for: str = "",
    ) -> None:
        self._settings_of = {setup.method: dict(method_settings or {})}
        self.layout = layout
        self.setup = setup
        self.running = running
        self.next_step = 0
        self.names: dict[int, str] = {}
        self.problem = ""
        self.trackers = 0
        self._waiting_for = waiting_for
        self._tracker = self._make_tracker(setup, self.method_settings)
        self.state = (
            TrackerState(Phase.WAITING_FOR_SENSORS, setup.sensors_expected) if running else _stopped(waiting_for)
        )
        self._verbs: dict[str, Callable[[Mapping[str, Any]], str]] = {
            "start": self._start,
            "stop": self._stop,
            "recalibrate": self._recalibrate,
            "setup": self._set_up,
            "use-rig": self._use_rig,
            "name": self._name,
            "restore": self._restore,
            STUDY_EVENT: lambda _: "",
        }

    @property
    def method_settings(self) -> dict[str, Any]:
        """Settings of the present method, by name."""
        return self._settings_of.get(self.setup.method, {})

    def wait_for(self, reason: str) -> None:
        """Give another reason of the wait before the first start, such as its progress; no effect after `ready`."""
        if self._waiting_for and reason:
            self._waiting_for = reason
            if not self.running:
                self.state = _stopped(reason)

    def ready(self) -> None:
        """End the wait before the first start: the command ``start`` is accepted from now on."""
        if self._waiting_for:
            self._waiting_for = ""
            self.state = _stopped()

    def memory(self) -> dict[str, Any]:
        """Return the arguments of a command ``restore`` that lets another session continue like this one."""
        memory: dict[str, Any] = {
            "tracker": base64.b64encode(self._tracker.snapshot()).decode("ascii"),
            "names": {str(person): name for person, name in self.names.items()},
        }
        return memory if self.layout is None else {**memory, _LAYOUT: encode_layout(self.layout).decode()}

    def layout_now(self) -> SensorLayout | None:
        """Return the tracker's present sensor poses; None if it has none yet, or its method keeps none."""
        return _keeper(self._tracker).layout() if METHODS[self.setup.method].keeps_layout else None

    @property
    def verbs(self) -> tuple[str, ...]:
        """Names of the commands for users, without the entries that only takes have."""
        return tuple(verb for verb in self._verbs if verb not in ("restore", STUDY_EVENT))

    @property
    def unusable(self) -> Mapping[str, int]:
        """Number of frames that the tracker could not use, by reason."""
        return self._tracker.report.rejected

    def step(self, arrival: Arrival) -> Scene | None:
        """Track a frame, and update ``state``, ``problem`` and ``next_step``.

        Args:
            arrival: the frame, and its time on the server's clock.

        Returns:
            The scene, with the names of its people; None while stopped.
        """
        if not self.running:
            return None
        before = self.unusable
        scene = self._named(self._tracker.update(arrival))
        self.next_step = scene.step + 1
        self.state = scene.state
        self.problem = next((why for why, count in self.unusable.items() if count > before.get(why, 0)), "")
        return scene

    def expected(self, sensor: str) -> Float32 | None:
        """Return the boxes (people, 4) where people are expected in a sensor's next image [px].

        None while stopped, and for a method that does not know.
        """
        tracker = self._tracker
        return tracker.expected_regions(sensor) if self.running and isinstance(tracker, ExpectsPeople) else None

    def carry_out(self, verb: str, arguments: Mapping[str, Any]) -> str:
        """Carry out a command; return a message about its effect.

        Args:
            verb: one of `verbs`, or ``restore``.
            arguments: its arguments by name: for ``setup`` the fields of `Setup`; for ``use-rig`` the file's text as
                ``rig``, and ``method``; for ``name`` the fields of `PersonName`; for ``restore`` what `memory` returns.

        Raises:
            SettingsError: the verb or an argument is unknown or invalid.
            InputError: the rig of ``use-rig`` is invalid.
            NotNowError: the command is impossible in the present state; names the command to use first, or the reason.
            WireError: the tracker's snapshot, an argument of ``restore``, is invalid.
        """
        if verb not in self._verbs:
            raise SettingsError(f"unknown command {verb!r}; known: {one_of(verb, self._verbs)}")
        return self._verbs[verb](arguments)

    def _start(self, _: Mapping[str, Any]) -> str:
        if self.running:
            raise NotNowError("already running; stop first")
        if self._waiting_for:
            raise NotNowError(f"getting ready: {self._waiting_for}")
        self._tracker = self._make_tracker(self.setup, self.method_settings)
        self.running = True
        self.next_step = 0
        self.names = {}
        self.state = _waiting(self.setup)
        return "started"

    def _stop(self, _: Mapping[str, Any]) -> str:
        self._check_running()
        self.running = False
        self.state = _stopped()
        return "stopped"

    def _check_running(self) -> None:
        if not self.running:
            raise NotNowError(
                f"getting ready: {self._waiting_for}" if self._waiting_for else "not running; start first"
            )

    def _recalibrate(self, _: Mapping[str, Any]) -> str:
        self._check_running()
        self.layout = None
        self._tracker.recalibrate("asked for")
        return "recalibrating"

    def _set_up(self, arguments: Mapping[str, Any]) -> str:
        setup = parse(Setup, arguments, where="setup")
        if (setup.placement, setup.scenario) != (self.setup.placement, self.setup.scenario):
            setup.check_usual_labels()
        return self.set_up(setup)

    def set_up(self, setup: Setup) -> str:
        """Take a setup; return a message. The tracker goes on if only labels differ, else a new one is made.

        Raises:
            SettingsError: the method is unknown, or keeps no sensor layout.
        """
        if setup.labelled_as(self.setup) == self.setup:
            self.setup = setup
            return f"labelled: {setup.labels_in_words()}"
        self._begin_anew(setup)
        return f"set up {self.setup.method}"

    def _use_rig(self, arguments: Mapping[str, Any]) -> str:
        """Track with the cameras of a rig, given as text; it becomes a setting of the method, which a take stores.

        The method is the given one, or the present one if it takes a rig, or else the first that requires one.
        """
        use = parse(_UseRig, arguments, where="use-rig")
        takes = [name for name, method in METHODS.items() if method.camera_rig != "none"]
        needs = [name for name in takes if METHODS[name].camera_rig == "required"]
        method = use.method or (self.setup.method if self.setup.method in takes else needs[0])
        if method not in takes:
            raise SettingsError(f"use-rig: method is {method!r}; methods that take a rig: {one_of(method, takes)}")
        cameras = decode_camera_rig(use.rig).cameras
        setup = replace(self.setup, method=method, sensors_expected=max(len(cameras), 2))
        self._begin_anew(setup, {**self._settings_of.get(method, {}), "rig": use.rig})
        return f"tracking {METHODS[method].parts[0]} with {', '.join(cameras)}"

    def _begin_anew(self, setup: Setup, settings: dict[str, Any] | None = None) -> None:
        kept = self._settings_of.get(setup.method, {}) if settings is None else settings
        self._tracker = self._make_tracker(setup, kept)
        self._settings_of[setup.method] = kept
        self.setup = setup
        self.next_step = 0
        self.names = {}

    def _restore(self, arguments: Mapping[str, Any]) -> str:
        try:
            layout = decode_layout(arguments[_LAYOUT].encode()) if _LAYOUT in arguments else None
            names = {int(person): str(name) for person, name in arguments.get("names", {}).items()}
            self._tracker.restore(base64.b64decode(arguments["tracker"], validate=True))
        except (*FAULTS, InputError) as error:
            raise WireError(f"no state that the tracker can go on from ({error!r})") from error
        self.layout, self.names = layout, names
        return "restored"

    def _name(self, arguments: Mapping[str, Any]) -> str:
        given = parse(PersonName, arguments, where="name")
        if not self.running:
            raise NotNowError("people have no ids while tracking is stopped; start first")
        if given.name:
            self.names[given.person] = given.name
            return f"person {given.person} is called {given.name}"
        self.names.pop(given.person, None)
        return f"person {given.person} has no name"

    def _named(self, scene: Scene) -> Scene:
        """Return the scene with the names of its people."""
        if not any(person.id in self.names for person in scene.people):
            return scene
        people = (msgspec.structs.replace(person, name=self.names.get(person.id, "")) for person in scene.people)
        return scene.with_parts(people=tuple(people))

    def _make_tracker(self, setup: Setup, settings: Mapping[str, Any]) -> Tracker:
        self.trackers += 1
        tracker = make_tracker(
            setup.method,
            sensors_expected=setup.sensors_expected,
            settings=settings,
            sensors=setup.sensors,
        )
        if self.layout is not None:
            if not METHODS[setup.method].keeps_layout:
                able = [name for name, method in METHODS.items() if method.keeps_layout]
                raise SettingsError(
                    f"method {setup.method!r} keeps no sensor layout; methods that do: {', '.join(able)}"
                )
            _keeper(tracker).use_layout(self.layout)
        return tracker


def _keeper(tracker: Tracker) -> KeepsLayout:
    """Narrow the type of a tracker whose method has ``keeps_layout``: the descriptor decides, not the class."""
    return cast(KeepsLayout, tracker)
