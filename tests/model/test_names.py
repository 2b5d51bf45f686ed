"""Names that become files, cells or terminal text."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.errors import SettingsError, visible
from mocapella.model.names import as_cell, is_device, of_cell
from mocapella.model.observations import check_sensor_name


@pytest.mark.parametrize("name", ["CON", "nul", "Aux.txt", "COM1", "lpt9.mcap", "com¹", "PRN .x", "CONIN$"])
def test_devices_of_windows(name: str) -> None:
    assert is_device(name)


@pytest.mark.parametrize("name", ["console", "com", "com10", "front", "aux-1", "x.nul", ""])
def test_other_names_are_files(name: str) -> None:
    assert not is_device(name)


@pytest.mark.parametrize(
    "name", ["CON", "nul", "aux.left", "COM1", "front.", "front ", "-front", "fr\u202eont", "a\x9bb"]
)
def test_a_sensors_name_can_be_a_file_everywhere(name: str) -> None:
    with pytest.raises(SettingsError, match="such as front"):
        check_sensor_name(name)


def test_a_recorded_sensor_may_be_called_like_a_device() -> None:
    assert check_sensor_name("aux", recorded=True) == "aux"
    with pytest.raises(SettingsError):
        check_sensor_name("fr\u202eont", recorded=True)


@given(st.text())
def test_a_visible_text_is_printable_and_a_printable_one_is_unchanged(text: str) -> None:
    assert visible(text).isprintable()
    assert (visible(text) == text) == text.isprintable()
    assert visible(visible(text)) == visible(text)


def test_escapes_of_a_terminal_are_shown() -> None:
    assert visible("a\x1b[2Jb\x9b1m\u202ec\n") == "a\\x1b[2Jb\\x9b1m\\u202ec\\n"
    assert visible("a\n\x1bb", keep="\n") == "a\n\\x1bb"


@given(st.text(alphabet="=+-@'ab1 ") | st.text())
def test_a_cell_is_no_formula_and_gives_its_text_back(text: str) -> None:
    assert as_cell(text)[:1] not in ("=", "+", "-", "@")
    assert of_cell(as_cell(text)) == text
