"""Settings of the silhouettes' fit that the commands `track silhouettes` and `demo silhouettes` have in common."""

from __future__ import annotations

from typing import Any, Final, Protocol

from mocapella.cli.command_settings import KeySpec

REJECTIONS: Final = ("adaptive", "none")
"""As `mocapella.tracker.silhouette_settings.REJECTIONS`, whose import would take long."""
REJECTION: Final = KeySpec("Leave out wrong images; none uses all, to see the penalty's effect alone.", "", None, None,
                           REJECTIONS)  # fmt: skip


class FitKeys(Protocol):
    """Keys of a command that change the fit."""

    @property
    def steadiness(self) -> bool:
        """Whether jitter is penalised."""

    @property
    def rejection(self) -> str:
        """One of `REJECTIONS`."""


def fit_settings(keys: FitKeys) -> dict[str, Any]:
    """Return the fields of `SilhouetteSettings` that differ from the defaults, as plain settings of a take."""
    return {
        **({} if keys.steadiness else {"steadiness": None}),
        **({} if keys.rejection == REJECTIONS[0] else {"rejection": keys.rejection}),
    }
