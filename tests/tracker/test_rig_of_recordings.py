"""A rig that is given for a recording is used with its clocks, where the method can."""

from __future__ import annotations

from mocapella.tracker.method_files import settings_of_rig_for_recording


def test_a_rig_for_a_recording_is_used_with_its_clocks() -> None:
    assert settings_of_rig_for_recording("webcams", {"rig": "text"}) == {"rig": "text", "rig_clocks": True}


def test_a_stated_setting_stays_and_without_a_rig_there_is_none() -> None:
    stated = {"rig": "text", "rig_clocks": False}
    assert settings_of_rig_for_recording("webcams", stated) == stated
    assert settings_of_rig_for_recording("webcams", {"unseen_s": 1.0}) == {"unseen_s": 1.0}


def test_methods_without_the_setting_get_none() -> None:
    assert settings_of_rig_for_recording("one-webcam", {"rig": "text"}) == {"rig": "text"}
