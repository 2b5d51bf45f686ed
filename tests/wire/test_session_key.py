"""Keys as files and as text: private, whole, or refused in one line that says what to do."""

from __future__ import annotations

import os
import threading
from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.errors import KeyFileError, MocapellaError, SettingsError
from mocapella.wire.certificates import Certified
from mocapella.wire.key_folder import key_folder
from mocapella.wire.role_key import PREFIX, RoleKey, fingerprint, read_code, write_code
from mocapella.wire.roles import EVERYTHING, READERS, SENSOR, check_user, users_of
from mocapella.wire.session_key import MOST_SENSORS, SessionKey, session_file, session_key, session_name

KEY = RoleKey("lab", SENSOR, "tls/192.0.2.1:7447", b"authority", Certified(b"certificate", b"private"))


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("MOCAPELLA_SESSIONS", str(tmp_path / "sessions"))
    return tmp_path / "sessions"


@given(name=st.sampled_from([SENSOR, "sensor.front", *READERS]), private=st.binary(max_size=300))
def test_a_pairing_code_is_one_line_and_reads_back(name: str, private: bytes) -> None:
    key = msgspec.structs.replace(KEY, user=name, own=Certified(b"c", private))
    code = write_code(key)
    assert len(code.split()) == 1
    assert read_code(f" {code}\n") == key


@given(st.data())
def test_a_code_that_was_not_copied_whole_is_refused_in_one_line(data: st.DataObject) -> None:
    code = write_code(KEY)
    cut = data.draw(st.integers(0, len(code) - 1))
    text = data.draw(st.sampled_from([code[:cut], PREFIX + "A" * cut, code[:cut] + "é" + code[cut:], "x" * 9000]))
    with pytest.raises(KeyFileError) as refused:
        read_code(text)
    assert "\n" not in str(refused.value)
    assert KEY.own.private_key.decode() not in str(refused.value)


@pytest.mark.parametrize("change", [{"user": "root"}, {"user": "sensor.a/b"}, {"address": "tls/x:0"}, {"user": ""}])
def test_a_code_of_no_role_or_address_is_refused(change: dict[str, str]) -> None:
    with pytest.raises(KeyFileError, match="is damaged; copy the whole line"):
        read_code(write_code(msgspec.structs.replace(KEY, **change)))


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="Windows has no file modes")
@pytest.mark.parametrize(("what", "mode", "remedy"), [("file", 0o640, "chmod 600"), ("file", 0o604, "chmod 600")])
def test_a_key_that_others_can_read_is_refused(what: str, mode: int, remedy: str) -> None:
    session_key("lab")
    session_file("lab").chmod(mode)
    with pytest.raises(KeyFileError, match=f"type: {remedy} .*lab.json"):
        session_key("lab")


def test_a_code_beyond_all_measure_is_not_read() -> None:
    with pytest.raises(KeyFileError, match="is no key"):
        read_code(write_code(msgspec.structs.replace(KEY, own=Certified(b"c", b"x" * 9000))))


@pytest.mark.parametrize(("length", "said"), [(8192, "is damaged"), (8193, "is no key")])
def test_a_code_is_decoded_up_to_its_longest_length(length: int, said: str) -> None:
    with pytest.raises(KeyFileError, match=said):
        read_code(write_code(KEY).ljust(length, "A"))


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="Windows has no file modes")
def test_a_key_of_another_user_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    session_key("lab")
    mine = os.getuid()
    monkeypatch.setattr(os, "getuid", lambda: mine + 1)
    with pytest.raises(KeyFileError, match="belongs to another user"):
        session_key("lab")


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="Windows has no file modes")
def test_no_key_is_kept_in_a_folder_that_others_can_open(folder: Path) -> None:
    folder.mkdir(mode=0o750)
    folder.chmod(0o750)
    with pytest.raises(KeyFileError, match=f"type: chmod 700 {folder}"):
        session_key("lab")
    assert list(folder.iterdir()) == []


@pytest.mark.parametrize("text", ["", "{}", "[" * 4000, '{"session": "lab"}', "é"])
def test_a_damaged_key_is_refused_and_not_replaced(text: str) -> None:
    session_key("lab")
    session_file("lab").write_text(text)
    with pytest.raises(KeyFileError, match=r"lab\.json: is no.* key"):
        session_key("lab")
    assert session_file("lab").read_text() == text


def test_a_key_copied_from_another_session_is_refused() -> None:
    session_key("lab")
    session_file("lab").rename(session_file("other"))
    with pytest.raises(KeyFileError, match="not the whole key of the session other"):
        session_key("other")


def test_programs_that_start_together_have_one_key() -> None:
    made: list[SessionKey] = []
    threads = [threading.Thread(target=lambda: made.append(session_key("lab"))) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len({fingerprint(key.authority.certificate) for key in made}) == 1
    assert [file.name for file in key_folder().iterdir()] == ["lab.json"]


def test_a_sensor_gets_a_key_of_its_own_once() -> None:
    key = session_key("lab")
    with pytest.raises(SettingsError, match="no key of the sensor front alone"):
        key.role_key("sensor.front", "tls/127.0.0.1:7447")
    front = key.with_sensor("front")
    assert front.with_sensor("front") is front
    assert session_key("lab") == front
    assert front.role_key("sensor.front", "tls/127.0.0.1:7447").own != front.issued[SENSOR]
    full = msgspec.structs.replace(front, sensors=tuple(map(str, range(MOST_SENSORS))))
    with pytest.raises(KeyFileError, match="session renew"):
        full.with_sensor("one-more")


def test_a_sensors_name_that_is_too_long_for_a_certificate_is_refused_in_words() -> None:
    key = session_key("lab").with_sensor("x" * 57)
    assert key.sensors == ("x" * 57,)
    with pytest.raises(SettingsError, match="at most 57 letters"):
        key.with_sensor("x" * 58)


@pytest.mark.parametrize("name", ["../x", "a/b", "a b", "-a", "a" * 41, "ä", "a.b"])
def test_a_session_name_that_could_be_a_path_is_refused(name: str) -> None:
    with pytest.raises(SettingsError, match="session name"):
        session_name(name)


def test_the_session_is_named_by_the_address_or_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MOCAPELLA_SESSION", raising=False)
    assert session_name() == "default"
    monkeypatch.setenv("MOCAPELLA_SESSION", "lab-2")
    assert (session_name(), session_name("lab-3")) == ("lab-2", "lab-3")


def test_keys_are_in_the_users_configuration_unless_told_otherwise(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.delenv("MOCAPELLA_SESSIONS")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    assert key_folder() == tmp_path / "mocapella" / "sessions"
    monkeypatch.delenv("XDG_CONFIG_HOME")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert key_folder() == tmp_path / "home" / ".config" / "mocapella" / "sessions"


@pytest.mark.parametrize("name", ["server", "root", "sensor.", "sensor.-x", "reader.front", "Reader", ""])
def test_what_is_no_role_is_refused(name: str) -> None:
    with pytest.raises(MocapellaError):
        check_user(name)
    assert name not in users_of(["front"])
    assert EVERYTHING in users_of([])
