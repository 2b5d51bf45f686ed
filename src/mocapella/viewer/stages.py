"""The stages that ship with Mocapella, and the choice among a method's stages.

Methods refer to them as ``mocapella.viewer.stages:ROOM``, ``:ARMS`` and ``:HANDS``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Final

from mocapella.errors import PluginError
from mocapella.model.scene import Scene
from mocapella.registry import load
from mocapella.viewer.plugin_errors import PluginErrors
from mocapella.viewer.stage import Stage, StageMemory
from mocapella.viewer.stage_arms import ARMS
from mocapella.viewer.stage_hands import HANDS
from mocapella.viewer.stage_room import ROOM

__all__ = ["ARMS", "HANDS", "ROOM", "Prop", "StageChoice"]

Prop = str | Callable[[], Any]
"""A function without arguments that creates an object to be shown beside a scene, or its reference ``module:name``."""

_ROOM_REFERENCE: Final = "mocapella.viewer.stages:ROOM"


class StageChoice:
    """Chooses the stage for each scene, and keeps the memory of all stages of one view.

    Args:
        methods: references ``module:name`` to the stages of each tracking method, by the method's name; other methods
            have the stage ROOM only.
        props: functions by name that create objects that stages may show beside a scene, such as a cloth.
        troubles: receives the error of a stage that cannot be used; that stage is skipped.

    Raises:
        PluginError: a prop's reference cannot be imported.
    """

    def __init__(self, methods: Mapping[str, Sequence[str]], props: Mapping[str, Prop], troubles: PluginErrors) -> None:
        self._methods, self._troubles = methods, troubles
        self._props: dict[str, Callable[[], Any]] = {
            name: load(prop) if isinstance(prop, str) else prop for name, prop in props.items()
        }
        self._memories: dict[str, StageMemory] = {}

    def update(self, scene: Scene | None, method: str) -> tuple[Stage, Any]:
        """Return the stage for the newest scene, and the value of the stage's `StageMemory.update`.

        It is the method's first stage with content, or else its last one. All its stages are updated with the scene.
        The same scene can be given again.

        Args:
            scene: the newest scene; None before the first.
            method: name of the tracking method.
        """
        chosen: tuple[Stage, Any] = ROOM, scene
        found = False
        stages = self._stages(method)
        for reference, stage in stages:  # all memories are updated, also of stages that are not shown
            remember = partial(self._remember, reference, stage, scene)
            shown = self._troubles.attempt(f"stage {stage.name}", remember, None)
            if not found and (shown is not None or reference == stages[-1][0]):
                chosen, found = (stage, shown), True
        return chosen

    def _remember(self, reference: str, stage: Stage, scene: Scene | None) -> Any:
        if reference not in self._memories:
            self._memories[reference] = stage.memory(self._props)
        return self._memories[reference].update(scene)

    def _stages(self, method: str) -> list[tuple[str, Stage]]:
        found = []
        for reference in self._methods.get(method, (_ROOM_REFERENCE,)):
            try:
                stage = load(reference)
                if not isinstance(stage, Stage):
                    raise PluginError(f"{reference} is a {type(stage).__name__}, and a Stage is wanted")
            except PluginError as error:
                self._troubles.tell(f"stage {reference}", error)
                continue
            found.append((reference, stage))
        return found or [(_ROOM_REFERENCE, ROOM)]
