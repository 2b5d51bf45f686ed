"""A camera's controls while its node runs: describe them, set them, and compare them with the saved ones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from mocapella.errors import NotNowError
from mocapella.model.camera_controls import ControlDescription
from mocapella.sensing.colour_profile import CameraControls
from mocapella.sources.acquisition import Acquisition
from mocapella.sources.picture_source import ControlledSource, controls_of


class LiveControls:
    """The controls of an acquisition's source; use it from one thread.

    Args:
        acquisition: source of the images; its state has the newest values after each `set`.

    Attributes:
        saved: the values of the start, or those last saved.
    """

    def __init__(self, acquisition: Acquisition) -> None:
        self._acquisition, self.saved = acquisition, acquisition.state.controls

    def descriptions(self) -> tuple[ControlDescription, ...]:
        """Return the controls with ranges and present values; empty if none can be set now."""
        source = self._acquisition.source
        return source.controls() if isinstance(source, ControlledSource) else ()

    def present(self) -> CameraControls:
        """Return the present values; the start's, if none can be set now."""
        found = self.descriptions()
        return _of(found, self._acquisition.state.controls) if found else self._acquisition.state.controls

    def set(self, values: Mapping[str, float], automatic: Mapping[str, bool]) -> tuple[str, ...]:
        """Switch automatic modes and set values; return a sentence for each that the camera did not accept.

        Raises:
            NotNowError: the source has no controls.
            SettingsError: the request is invalid; nothing is set.
        """
        acquisition, source = self._acquisition, self._acquisition.source
        if not isinstance(source, ControlledSource):
            raise NotNowError(f"{source.name} has no controls that can be set; cameras and rendered scenes have")
        problems = source.set_controls(values, automatic)
        state = acquisition.state
        over = (
            *(f"{name.replace('_', ' ')} cannot" for name in values),
            *(f"automatic {mode.replace('_', ' ')} " for mode in automatic),
        )
        old = tuple(problem for problem in state.problems if not problem.startswith(over))
        acquisition.state = replace(state, controls=self.present(), problems=old + problems)
        return problems

    @property
    def unsaved(self) -> bool:
        """Whether an automatic mode, or a value that none sets, differs from the saved one."""
        found = self.descriptions()
        if not found:
            return False
        if set(_of(found, self.saved).automatic) != set(self.saved.automatic):
            return True
        saved = self.saved.values
        return any(
            control.name in saved and abs(control.value - saved[control.name]) > 0.5 * control.step + 1e-9
            for control in found
            if not control.automatic
        )


def _of(found: tuple[ControlDescription, ...], before: CameraControls) -> CameraControls:
    """Return described values, and the former modes that no control describes (focus)."""
    now = controls_of(found)
    other = tuple(mode for mode in before.automatic if mode not in {control.mode for control in found})
    return replace(now, automatic=now.automatic + other)
