"""What cannot be recorded is refused before anything is created."""

import os
import shutil
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.take_making import info, small_take, unclosed_take

from mocapella.errors import DiskFullError, RecordingError, TakeExistsError
from mocapella.recording import disk
from mocapella.recording.take_writer import TakeWriter


@pytest.mark.parametrize("name", ["walk", "walk.mcap", "WALK.MCAP", "participant 7", "p7.take-2_b", "Prüfling"])
def test_good_names(tmp_path: Path, name: str) -> None:
    path = disk.take_path(tmp_path, name)
    assert path.parent == tmp_path
    assert path.suffix == ".mcap"
    assert path.stem == name.removesuffix(".mcap").removesuffix(".MCAP")


@pytest.mark.parametrize(
    ("take", "following"),
    [("take-1", "take-2"), ("walk-009", "walk-010"), ("p7", "p8"), ("square", "square-2"), ("v1.2", "v1.3")],
)
def test_the_next_take_has_the_next_number(take: str, following: str) -> None:
    assert disk.next_name(take) == following


@given(st.from_regex(r"[a-z]{1,5}[0-9]{0,4}", fullmatch=True))
def test_no_take_proposes_its_own_name(take: str) -> None:
    assert disk.next_name(take) != take


def test_a_free_name_is_one_that_can_be_recorded_to(tmp_path: Path) -> None:
    assert disk.free_name(tmp_path / "not made yet", "take-1") == "take-1"
    assert disk.free_name(tmp_path, "take-1") == "take-1"
    for name in ("take-1.mcap", "take-2.part2.mcap", "TAKE-3.MCAP", "take-4.merging.mcap", "notes.txt"):
        (tmp_path / name).touch()
    assert disk.free_name(tmp_path, "take-1") == "take-5"
    disk.check_can_record(tmp_path / "take-5.mcap", reserve_bytes=0)
    assert disk.free_name(tmp_path, "notes") == "notes"


BAD = ["", "  ", ".mcap", "..", "../x", "a/b", "a\\b", "/etc/x", "a\0b", "a\nb", ".hidden", "a..b", "a.", " a", "C:x",
       "-rf", "CON", "nul.mcap", "com1", "a\x9b2Jb", "a\u202eb", "a\u2066b", "a ", "a\u200fb"]  # fmt: skip


@pytest.mark.parametrize("name", [*BAD, "x" * 201, "ü" * 101, "walk.part2", "walk.merging.mcap", "<script>"])
def test_bad_names_say_what_would_work(tmp_path: Path, name: str) -> None:
    with pytest.raises(RecordingError, match="such as participant-7-walk") as caught:
        disk.take_path(tmp_path, name)
    assert "\n" not in str(caught.value)


@given(st.text(max_size=260))
def test_no_name_leads_out_of_the_folder(name: str) -> None:
    folder = Path("/takes")
    try:
        path = disk.take_path(folder, name)
    except RecordingError:
        return
    assert Path(os.path.normpath(path)).parent == folder
    assert len(disk.merging_path(path).name.encode()) <= 255


def test_folders_that_cannot_be_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    for folder, why in (("missing", "does not exist"), ("file", "is no folder")):
        with pytest.raises(RecordingError, match=f"{folder}: it {why}; make the folder"):
            TakeWriter.create(tmp_path / folder / "a.mcap", info=info())
    monkeypatch.setattr(os, "access", lambda *_: False)  # the superuser may write anywhere
    with pytest.raises(RecordingError, match="cannot be written to"):
        TakeWriter.create(tmp_path / "a.mcap", info=info(), reserve_bytes=0)
    assert [entry.name for entry in tmp_path.iterdir()] == ["file"]


def test_a_folder_that_can_be_made_and_written_to_has_no_problem(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    assert disk.folder_problem(tmp_path) == disk.folder_problem(tmp_path / "study" / "takes") == ""
    for path in ("file", "file/takes", "link/takes"):
        assert disk.folder_problem(tmp_path / path) == f"{tmp_path / path.partition('/')[0]} is no folder"
    monkeypatch.setattr(os, "access", lambda *_: False)  # the superuser may write anywhere
    assert disk.folder_problem(tmp_path / "study" / "takes") == f"{tmp_path} cannot be written to"
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["file", "link"]


def test_too_little_room_is_refused_with_both_numbers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=disk.GIB // 2))
    with pytest.raises(DiskFullError, match=r"0\.50 GiB are free and 1\.00 GiB are needed"):
        TakeWriter.create(tmp_path / "a.mcap", info=info())
    with pytest.raises(DiskFullError):
        TakeWriter.resume_or_create(tmp_path / "a.mcap", info=info())
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    path = small_take(tmp_path / "walk.mcap")
    before = path.read_bytes()
    for begin in (TakeWriter.create, TakeWriter.resume_or_create):
        with pytest.raises(TakeExistsError, match=r"walk\.mcap: it exists.*choose another name"):
            begin(path, info=info(), reserve_bytes=0)
    assert path.read_bytes() == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["walk.mcap"]


def test_other_peoples_files_and_dangling_links_are_names_in_use(tmp_path: Path) -> None:
    (tmp_path / "notes.mcap").write_text("do not lose this")
    (tmp_path / "folder.mcap").mkdir()
    (tmp_path / "link.mcap").symlink_to(tmp_path / "nowhere")
    for name in ("notes", "folder", "link"):
        for begin in (TakeWriter.create, TakeWriter.resume_or_create):
            with pytest.raises(TakeExistsError):
                begin(tmp_path / f"{name}.mcap", info=info(), reserve_bytes=0)
    assert (tmp_path / "notes.mcap").read_text() == "do not lose this"
    assert len(list(tmp_path.iterdir())) == 3


def test_a_leftover_part_alone_is_a_name_in_use(tmp_path: Path) -> None:
    (tmp_path / "walk.part2.mcap").write_bytes(b"")
    with pytest.raises(TakeExistsError, match=r"walk\.part2\.mcap"):
        TakeWriter.resume_or_create(tmp_path / "walk.mcap", info=info(), reserve_bytes=0)


def test_a_take_that_is_being_recorded_is_not_gone_on_with(tmp_path: Path) -> None:
    path = tmp_path / "walk.mcap"
    writer = TakeWriter.create(path, info=info(), reserve_bytes=0)
    with pytest.raises(TakeExistsError, match="another program is recording it"):
        TakeWriter.resume_or_create(path, info=info(), reserve_bytes=0)
    writer.close()
    torn = unclosed_take(tmp_path / "torn.mcap")
    resumed = TakeWriter.resume_or_create(torn, info=info(), reserve_bytes=0)
    with pytest.raises(TakeExistsError, match="another program is recording it"):
        TakeWriter.resume_or_create(torn, info=info(), reserve_bytes=0)
    resumed.close()


def test_a_file_that_appears_at_the_last_moment_is_not_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "walk.mcap"
    path.write_text("mine")
    with pytest.raises(TakeExistsError, match=r"walk\.mcap: it exists, and nothing is overwritten"):
        disk.create_new(path)
    assert path.read_text() == "mine"


@pytest.mark.skipif(os.name == "nt", reason="Windows has no modes of files")
def test_takes_and_their_folders_are_for_this_user_only(tmp_path: Path) -> None:
    folder = tmp_path / "study" / "takes"
    umask = os.umask(0)
    try:
        disk.ensure_folder(folder)
        TakeWriter.create(folder / "walk.mcap", info=info(), reserve_bytes=0).close()
    finally:
        os.umask(umask)
    assert [path.stat().st_mode & 0o777 for path in (folder.parent, folder, folder / "walk.mcap")] == [
        0o700,
        0o700,
        0o600,
    ]
    tmp_path.chmod(0o755)
    disk.ensure_folder(tmp_path)
    assert tmp_path.stat().st_mode & 0o777 == 0o755  # one that is there is not changed
    with pytest.raises(RecordingError, match="cannot be the folder"):
        disk.ensure_folder(folder / "walk.mcap")


@pytest.mark.skipif(os.name == "nt", reason="folders cannot be opened there")
def test_a_new_names_folder_is_flushed_to_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    flushed: list[int] = []
    monkeypatch.setattr(os, "fsync", lambda fd: flushed.append(os.fstat(fd).st_ino))
    disk.sync_folder(tmp_path)
    assert flushed == [tmp_path.stat().st_ino]
