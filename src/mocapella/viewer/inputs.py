"""Set the values of viser's inputs."""

from __future__ import annotations

from typing import Protocol, TypeVar

_T = TypeVar("_T")
_T_co = TypeVar("_T_co", covariant=True)


class Input(Protocol[_T_co]):
    """Interface for `set_value` of viser's inputs and progress bars: a readable ``value`` of the type parameter."""

    @property
    def value(self) -> _T_co:
        """Value that the input shows."""


def set_value(handle: Input[_T], value: _T) -> None:
    """Set the value that an input shows; viser's types declare ``value`` as read-only."""
    handle.value = value  # type: ignore[misc]  # viser types the property as read-only and writes it by `__setattr__`
