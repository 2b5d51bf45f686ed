"""The documentation's table of channels is that of the code, and its code runs."""

import re
from pathlib import Path

import pytest
from support.take_making import frame_bytes, info, scene_bytes, small_take

from mocapella.recording import take
from mocapella.recording.take_file import channel_format

ROOT = Path(__file__).resolve().parents[2]

PAGE = (ROOT / "docs" / "takes.md").read_text(encoding="utf-8")


def test_the_table_names_every_channel_and_its_encoding() -> None:
    rows = dict(re.findall(r"^\| `(/[a-z]+)(?:/<sensor>)?` \| (\w+)", PAGE, re.MULTILINE))
    topics = [take.FRAMES, take.SCENES, take.TRUTH, take.COMMANDS, take.STATUS, take.CLOCK, take.NODES, take.EARLIER]
    topics.append(take.RUNS)
    assert rows == {
        topic.rstrip("/"): {"json": "JSON"}.get(e := channel_format(topic, frame_bytes("front", 0)).encoding, e)
        for topic in topics
    }


def test_the_code_of_the_page_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    reading, writing = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    monkeypatch.chdir(tmp_path)
    small_take(tmp_path / "walk.mcap")
    exec(reading, {})
    (tmp_path / "takes").mkdir()
    names = {"info": info(), "data": frame_bytes("front", 0), "now": 1, "scene": scene_bytes(0, "front", 0)}
    exec(writing.replace("info=info", "info=info, reserve_bytes=0"), names)
    assert names["report"].clean
    assert (tmp_path / "takes" / "walk.mcap").exists()
