"""Settings of commands: parsed once from a TOML file and ``--set`` pairs, with ranges, types and suggestions."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import pytest

from mocapella.cli.command_settings import KeySpec, read_keys, read_settings, rows_of_keys
from mocapella.errors import InputError, SettingsError


@dataclass(frozen=True)
class Keys:
    """Settings of a command."""

    reserve_gib: Annotated[float, KeySpec("Free space.", "GiB", least=0)] = 1.0
    every: Annotated[int | None, KeySpec("Every n-th frame.", least=1, most=9)] = None
    wait: Annotated[bool, KeySpec("Begin stopped.")] = False
    takes: Annotated[Path, KeySpec("Folder.", "folder")] = Path("takes")
    model: Annotated[tuple[str, ...], KeySpec("Models.", "[PERSON=]NAME")] = ()
    size: Annotated[str | None, KeySpec("How to fit.", choices=("crop", "scale"))] = None
    seconds: Annotated[float | None, KeySpec("How long.", "s", above=0)] = None


def test_pairs_become_typed_values() -> None:
    pairs = ["reserve_gib=2", "every=3", "wait=true", "takes=x/y", "model=anna=legs", "model=male", "size=crop"]
    assert read_keys(Keys, None, pairs) == Keys(2.0, 3, True, Path("x/y"), ("anna=legs", "male"), "crop")
    assert read_keys(Keys, None, None) == Keys()


def test_a_file_says_the_same_and_a_pair_overrides_it(tmp_path: Path) -> None:
    file = tmp_path / "site.toml"
    file.write_text(
        'reserve_gib = 2\nevery = 3\nwait = true\ntakes = "x"\nmodel = ["male"]\n[people]\nsmoothing = "kalman"'
    )
    keys, rest = read_settings(Keys, file, ["every=4", "people.frames=60"], ["people"])
    assert keys == Keys(2.0, 4, True, Path("x"), ("male",))
    assert rest == {"people": {"smoothing": "kalman", "frames": 60}}


@pytest.mark.parametrize(
    ("pair", "words"),
    [
        ("reserve_gib=-1", "setting reserve_gib is -1.0; it must be a number [GiB], at least 0"),
        ("reserve_gib=nan", "setting reserve_gib is nan"),
        ("reserve_gib=much", "setting reserve_gib is 'much'; it must be a number [GiB]"),
        ("every=10", "setting every is 10; it must be a whole number, at least 1, at most 9"),
        ("every=1.5", "setting every is '1.5'"),
        ("seconds=0", "setting seconds is 0.0; it must be a number [s], above 0"),
        ("wait=maybe", "it must be true or false"),
        ("size=corp", "setting size is 'corp'; it must be one of crop, scale (did you mean crop?)"),
        ("resrve_gib=1", "unknown setting 'resrve_gib'; did you mean reserve_gib?"),
        ("colour=1", "unknown setting 'colour'; known: reserve_gib, every"),
        ("every", "write it as NAME=VALUE"),
    ],
)
def test_a_wrong_pair_is_refused_with_what_would_work(pair: str, words: str) -> None:
    with pytest.raises(SettingsError) as refused:
        read_keys(Keys, None, [pair])
    assert words in str(refused.value)


def test_one_value_given_twice_is_refused() -> None:
    with pytest.raises(SettingsError, match="every is given twice: 1 and 2"):
        read_keys(Keys, None, ["every=1", "every=2"])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("every = 1.5", "setting every is 1.5"),
        ("wait = 1", "setting wait is 1"),
        ("takes = 3", "setting takes is 3"),
        ("model = [1]", "setting model is 1"),
        ("reserve_gib = -1", "at least 0"),
        ("colour = 1", "unknown setting 'colour'"),
    ],
)
def test_a_wrong_file_is_refused(text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text(text)
    with pytest.raises(SettingsError) as refused:
        read_keys(Keys, tmp_path / "s.toml", None)
    assert words in str(refused.value)


def test_a_file_that_is_missing_or_no_toml_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"s\.toml: cannot be read"):
        read_keys(Keys, tmp_path / "s.toml", None)
    (tmp_path / "s.toml").write_text("every: 1")
    with pytest.raises(InputError, match="is no TOML"):
        read_keys(Keys, tmp_path / "s.toml", None)


def test_a_key_of_the_method_is_not_taken_for_a_misspelt_one() -> None:
    assert read_settings(Keys, None, ["takess=1"], ["takess"]) == (Keys(), {"takess": 1})
    with pytest.raises(SettingsError, match="did you mean takes"):
        read_settings(Keys, None, ["takess=1"], ["frames"])


def test_rows_have_unit_default_and_meaning() -> None:
    rows = {row.name: (row.unit, row.default, row.meaning) for row in rows_of_keys(Keys)}
    assert rows["reserve_gib"] == ("GiB", "1.0", "Free space.")
    assert rows["size"] == ("crop|scale", "", "How to fit.")
    assert rows["wait"] == ("", "false", "Begin stopped.")
