"""Methods that find arms in depth images, by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any, Final, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError, one_of
from mocapella.model.arms import ArmMethod
from mocapella.model.camera import Camera
from mocapella.settings import parse

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


def arm_method(name: str, camera: Camera, settings: Mapping[str, Any] | None = None) -> ArmMethod:
    """A new method for images of one camera.

    Args:
        name: key of `ARM_METHODS`.
        camera: its size and lens.
        settings: the method's own, by name; the rest are its defaults.

    Raises:
        SettingsError: no such method, an unknown setting, or one out of range; says what would work.
    """
    if name not in ARM_METHODS:
        raise SettingsError(f"unknown arm method {name!r}; known: {one_of(name, ARM_METHODS)}")
    return ARM_METHODS[name](camera, settings or {})
