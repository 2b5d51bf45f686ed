"""Methods that find arms in depth images, by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any, Final, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError, one_of
from mocapella.kinematics.gestures import GestureSettings
from mocapella.model.arms import ArmMethod, SeenArms
from mocapella.model.camera import Camera
from mocapella.settings import parse
from mocapella.tracker.arm_gestures import ArmGestures

Make = Callable[[Camera, Mapping[str, Any]], ArmMethod]
"""How to make a method for a camera, with its settings by name."""


@runtime_checkable
class HasStages(Protocol):
    """A method whose stages can be looked at."""

    def stages(self, depth: NDArray[np.float32]) -> Mapping[str, NDArray[np.uint8]]:
        """Pictures of what the method makes of an image, by stage in their order, which changes nothing in it.

        Args:
            depth: (height, width) [m]; 0 where nothing was measured.

        Returns:
            (height, width) gray or (height, width, 3) blue, green, red.
        """
        ...


def _of(module: str, name: str) -> Make:
    """A method of a class and, in the same module, its settings, called the same with ``Settings`` after it.

    The module is imported when a method is made: some compile kernels.
    """

    def make(camera: Camera, settings: Mapping[str, Any]) -> ArmMethod:
        found = import_module(module)
        cls = getattr(found, name)
        values = parse(getattr(found, f"{name}Settings"), settings, where=f"settings of {cls.name}")
        method: ArmMethod = cls(camera, values)
        return method

    return make


ARM_METHODS: Final[dict[str, Make]] = {
    "default": _of("mocapella.tracker.depth_arms", "DepthArms"),
    "line-skeleton": _of("mocapella.sensing.line_skeleton", "LineSkeleton"),
}


class WithGestures:
    """A method, and what the hands do that it finds.

    Attributes:
        name: the method's.
        method: that finds arms.
        gestures: that are told of them.
    """

    def __init__(self, method: ArmMethod, settings: GestureSettings | None = None) -> None:
        self.name, self.method, self.gestures = method.name, method, ArmGestures(settings)

    def update(self, depth: NDArray[np.float32], at_s: float) -> SeenArms:
        """As `ArmMethod.update` says."""
        seen = self.method.update(depth, at_s)
        return SeenArms(self.gestures.update(seen.arms, at_s), seen.reason)

    def reset(self) -> None:
        """Forget all earlier images."""
        self.method.reset()
        self.gestures.reset()


class _WithStages(WithGestures):
    """Of a method whose stages can be looked at."""

    def stages(self, depth: NDArray[np.float32]) -> Mapping[str, NDArray[np.uint8]]:
        """As `HasStages.stages` says."""
        assert isinstance(self.method, HasStages)
        return self.method.stages(depth)


def arm_method(name: str, camera: Camera, settings: Mapping[str, Any] | None = None) -> ArmMethod:
    """A new method for images of one camera, which tells gestures, too.

    Args:
        name: key of `ARM_METHODS`.
        camera: its size and lens.
        settings: the method's own, by name, and ``gestures``, those of `GestureSettings`; the rest are its defaults.

    Raises:
        SettingsError: no such method, an unknown setting, or one out of range; says what would work.
    """
    if name not in ARM_METHODS:
        raise SettingsError(f"unknown arm method {name!r}; known: {one_of(name, ARM_METHODS)}")
    own = dict(settings or {})
    gestures = parse(GestureSettings, own.pop("gestures", {}), where=f"settings of {name}, gestures")
    method = ARM_METHODS[name](camera, own)
    return (_WithStages if isinstance(method, HasStages) else WithGestures)(method, gestures)
