"""The folder "People" in one browser's panel: the tracked people and their names."""

from __future__ import annotations

from typing import Any

import viser

from mocapella.model.scene import Person
from mocapella.viewer import readout
from mocapella.viewer.inputs import set_value
from mocapella.viewer.part_panel import PanelPlace, PanelState

NOBODY = "–"
"""The dropdown's text while no person is tracked."""


class PeoplePanel:
    """The folder "People" of one browser's panel: it lists the people, and sends a name that the user enters.

    Args:
        place: the browser's controls, the folder's position, and the function that sends the command ``name``; if that
            is None, the inputs for a name are hidden.
    """

    def __init__(self, place: PanelPlace) -> None:
        gui, self._send = place.gui, place.send
        self._chosen: int | None = None
        self._people: dict[int, str] = {}
        with gui.add_folder("People", order=place.order) as self._folder:
            self._list = gui.add_html(readout.people_html(()))
            self._who = gui.add_dropdown("Who", (NOBODY,), disabled=True, hint="The person to name")
            self._text = gui.add_text("Name", "", disabled=True, hint="Shown in all browsers; empty removes the name")
            self._button = gui.add_button("Set name", disabled=True, icon=viser.Icon.TAG)

        @self._who.on_update
        async def _(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:
                self._choose(next((who for who in self._people if self._option(who) == self._who.value), None))

        @self._button.on_click
        async def _(_: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            if self._chosen is not None and self._send is not None:
                self._send("name", {"person": self._chosen, "name": self._text.value.strip()})

        for handle in (self._who, self._text, self._button):
            handle.visible = self._send is not None

    def show(self, state: PanelState) -> None:
        """Show the people of the scene, ``state.parts``, if ``state.changed``.

        A person chosen by the user stays chosen while no sensor sees them.
        """
        if not state.changed:
            return
        people: tuple[Person, ...] = state.parts
        self._folder.visible = state.visible
        self._list.content = readout.people_html(people)
        chosen, called = self._chosen, self._people.get(self._chosen, "") if self._chosen is not None else ""
        now = {person.id: person.name for person in people}
        if chosen is not None and chosen not in now:
            now[chosen] = called
        if now != self._people:
            self._people = dict(sorted(now.items()))
            self._who.options = [self._option(who) for who in self._people] or [NOBODY]
        if chosen is None and now:
            self._choose(min(now))
        elif chosen is not None:
            set_value(self._who, self._option(chosen))
            if now[chosen] != called and self._text.value.strip() == called:
                set_value(self._text, now[chosen])
        self._who.disabled = self._text.disabled = self._button.disabled = not (
            state.can_name and self._chosen is not None
        )

    def _choose(self, who: int | None) -> None:
        self._chosen = who
        if who is not None:
            set_value(self._who, self._option(who))
            set_value(self._text, self._people[who])

    def _option(self, who: int) -> str:
        name = self._people[who]
        return f"{name} (person {who})" if name else f"Person {who}"
