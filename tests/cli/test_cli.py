"""The command line: every verb teaches, every bad input is one line, and what a program reads is JSON."""

from __future__ import annotations

import gzip
import json
import re
from pathlib import Path

import pytest
from support.commands import import_commands
from support.programs import result, result_here, run, run_here
from typer.testing import CliRunner

from mocapella import __version__
from mocapella.cli.app import app
from mocapella.schema import SCHEMA_VERSION
from mocapella.sources.simulate import scene_summaries

import_commands()
VERBS = [
    ["demo"],
    ["serve"],
    ["status"],
    ["take", "info"],
    ["take", "check"],
    ["take", "recover"],
    ["take", "merge"],
    ["node", "simulate"],
    ["node", "markers"],
    ["node", "keypoints"],
    ["node", "replay"],
    ["node", "bridge"],
    ["node", "datagrams"],
    ["node", "osc"],
    ["node", "openvr"],
    ["node", "azure-kinect"],
    ["node", "arm"],
    ["node", "camera"],
    ["node", "rgbd"],
    ["calibrate", "space"],
    ["track", "arm"],
    ["triangulate"],
    ["replay"],
    ["people"],
    ["compare"],
    ["record"],
    ["stream", "osc"],
    ["export", "angles-plot"],
    ["stream", "vmc"],
    ["export", "study-log"],
    ["export", "csv"],
    ["export", "csv-wide"],
    ["export", "parquet"],
    ["export", "npz"],
    ["export", "netcdf"],
    ["export", "trc"],
    ["export", "c3d"],
    ["export", "bvh"],
    ["export", "glb"],
    ["export", "usd"],
    ["export", "html"],
    ["export", "angles"],
    ["export", "mot"],
    ["export", "sto"],
    ["export", "opensim"],
    ["export", "rosbag2"],
    ["export", "arms"],
    ["export", "json"],
    ["status"],
    ["view"],
    ["doctor"],
    ["plan"],
    ["study", "analyze"],
    ["study", "new"],
    ["study", "check"],
    ["study", "tasks"],
    ["study", "verify"],
    ["study", "consent"],
    ["study", "due"],
    ["study", "purge"],
    ["study", "logs"],
    ["study", "run"],
    ["lab", "evaluate", "kinectmultitrack"],
    ["lab", "evaluate", "simulation"],
    ["lab", "evaluate", "founding"],
    ["lab", "evaluate", "charuco"],
    ["lab", "evaluate", "hands"],
    ["lab", "evaluate", "hand-solvers"],
    ["lab", "evaluate", "marker-windows"],
    ["lab", "evaluate", "marker-kinds"],
    ["lab", "evaluate", "marker-thresholds"],
    ["lab", "evaluate", "marker-jitter"],
    ["lab", "evaluate", "line-skeleton-grid"],
    ["lab", "evaluate", "silhouettes-knee-bend"],
    ["lab", "evaluate", "silhouettes-runner"],
    ["lab", "evaluate", "silhouettes-acrobatics"],
    ["lab", "evaluate", "silhouettes-weight"],
    ["lab", "evaluate", "silhouettes-loss"],
    ["lab", "evaluate", "silhouettes-one-camera"],
    ["lab", "evaluate", "silhouettes-wrong-frame"],
    ["lab", "evaluate", "silhouettes-keypoints"],
    ["lab", "evaluate", "silhouettes-jitter-limit"],
    ["lab", "evaluate", "webcam-hands"],
    ["lab", "evaluate", "webcams"],
    ["lab", "evaluate", "rgbd"],
    ["calibrate", "cameras"],
    ["calibrate", "colours", "learn"],
    ["calibrate", "colours", "check"],
    ["calibrate", "board"],
    ["calibrate", "people"],
    ["lab", "evaluate", "rig-from-people"],
    ["lab", "train", "bias"],
    ["lab", "train", "facing"],
    ["lab", "train", "sensor-errors"],
    ["lab", "train", "keypoint-errors"],
    ["track", "points"],
    ["track", "silhouettes"],
    ["lab", "depth", "fit"],
    ["lab", "depth", "lines"],
    ["lab", "tune", "one-euro"],
    ["calibrate", "hand"],
]
HIDDEN = {"lab", "plan", "people", "triangulate"}
"""Of these, what `mocapella --help` does not list: documents name the first, and its introduction the others."""
READ_BY_PROGRAMS = [verb for verb in VERBS if verb != ["view"]]
SCREEN = re.compile(r"\x1b\[[0-9;?]*[a-zA-Z]")


@pytest.mark.parametrize("verb", VERBS, ids=" ".join)
def test_help_teaches_with_an_example(verb: list[str]) -> None:
    shown = help_of(*verb)
    assert f"Example:  mocapella {' '.join(verb)}" in shown
    assert ("--json" in shown) == (verb in READ_BY_PROGRAMS)


def help_of(*verb: str) -> str:
    """What a person sees; in this process, for each of many verbs."""
    done = CliRunner().invoke(app, [*verb, "--help"], env={"COLUMNS": "120", "TERMINAL_WIDTH": "120"})
    assert done.exit_code == 0
    return done.output


def test_every_verb_is_in_this_list() -> None:
    groups: dict[str, set[str]] = {}
    for verb in VERBS:
        for length, name in enumerate(verb):
            groups.setdefault(" ".join(verb[:length]), set()).add(name)
    for group, names in groups.items():
        shown, unlisted = help_of(*group.split()), set() if group else HIDDEN
        assert set(re.findall(r"^│ ([a-z][a-z0-9-]*) ", shown, flags=re.MULTILINE)) == names - unlisted


def test_the_version_is_ours_and_the_schemas(tmp_path: Path) -> None:
    assert run(tmp_path, "--version").stdout.strip() == f"mocapella {__version__} (schema {SCHEMA_VERSION})"


def test_the_doctor_says_what_it_found(tmp_path: Path) -> None:
    findings = result(tmp_path, "doctor")
    assert {"Python", "core packages", "disk for takes", "cameras"} <= {finding["what"] for finding in findings}
    assert all(finding["advice"] for finding in findings if finding["verdict"] != "ok")
    extras = {f["what"]: f["advice"] for f in findings if f["what"].startswith("extra ") and f["verdict"] == "note"}
    assert all(f"[{name.removeprefix('extra ')}]" in advice for name, advice in extras.items())


def test_the_doctor_names_a_port_in_use(tmp_path: Path) -> None:
    import socket

    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        (finding,) = [
            f for f in result_here(tmp_path, "doctor", "--port", str(port)) if f["what"] == f"bus port {port}"
        ]
    assert finding["verdict"] == "note"
    assert "--port" in finding["advice"]


@pytest.mark.parametrize("verb", [["demo"], ["node", "simulate"]], ids=" ".join)
def test_scenes_are_listed_where_asked_for_and_where_none_has_the_name(verb: list[str], tmp_path: Path) -> None:
    listed = run_here(tmp_path, *verb, "--scene", "help")
    assert listed.returncode == 0
    rows = [line.split(maxsplit=1) for line in listed.stdout.splitlines()]
    assert dict(rows) == scene_summaries()
    unknown = run_here(tmp_path, *verb, "--scene", "obstacel")
    assert unknown.returncode == 1
    (line,) = SCREEN.sub("", unknown.stderr).splitlines()
    assert line.startswith(f"mocapella: unknown scene 'obstacel'; known: {', '.join(scene_summaries())} (did you mean")
    assert line.endswith("obstacle?); `--scene help` describes them")


@pytest.mark.parametrize("seconds", ["0", "-1", "nan", "inf"])
@pytest.mark.parametrize("verb", [["demo"], ["node", "simulate"], ["record", "walk"]], ids=" ".join)
def test_a_duration_is_above_zero(verb: list[str], seconds: str, tmp_path: Path) -> None:
    refused = run_here(tmp_path, *verb, "--seconds", seconds)
    assert refused.returncode == 1
    words = f"mocapella: --seconds is {float(seconds)}; it must be a number of seconds above 0, such as 30\n"
    assert SCREEN.sub("", refused.stderr) == words


@pytest.mark.parametrize("verb", [["demo"], ["serve"], ["node", "simulate"], ["record", "walk"], ["doctor"]])
def test_a_result_file_that_cannot_be_written_is_refused_before_the_run(verb: list[str], tmp_path: Path) -> None:
    refused = run_here(tmp_path, *verb, "--json", "no/such/folder.json")
    assert refused.returncode == 1
    assert SCREEN.sub("", refused.stderr).startswith("mocapella: --json no/such/folder.json: ")
    assert refused.stdout == ""


def broken(folder: Path, source: Path, what: str) -> list[str]:
    """A real log with something wrong with it, and the words that replay it."""
    lines = gzip.decompress(source.read_bytes()).decode().splitlines()[:400]
    path = folder / "log.csv"
    cells = lines[5].split(", ")
    match what:
        case "missing file":
            return [str(path)]
        case "empty file":
            path.write_text("")
            return [str(path)]
        case "header only":
            lines = lines[:1]
        case "column missing":
            lines[0] = lines[0].replace(", Head_X", "")
        case "another table":
            lines[0] = "LFHD (x);LFHD (y);LFHD (z)"
        case "text for a number":
            cells[20] = "abc"
        case "NaN":
            cells[20] = "NaN"
        case "time goes backwards":
            cells[6] = str(int(cells[6]) - 20_000_000)
        case "no such placement":
            path.write_text("\n".join(lines))
            return [str(path), "--placement", "parallel"]
        case "truncated take":
            path = folder / "take.mcap"
            path.write_bytes(b"\x89MCAP0\r\n\x01\x05")
            return [str(path)]
        case "no take":
            path = folder / "take.mcap"
            path.write_bytes(b"hello")
            return [str(path)]
    lines[5:6] = [", ".join(cells)] if len(lines) > 5 else []
    path.write_text("\n".join(lines))
    return [str(path)]


@pytest.mark.parametrize(
    ("what", "words"),
    [
        ("missing file", ["log.csv", "no such file"]),
        ("empty file", ["log.csv", "empty"]),
        ("header only", ["log.csv", "no rows"]),
        ("column missing", ["log.csv", "Head_X"]),
        ("another table", ["log.csv", "row 1", "LFHD (x)", "study log", "docs/sensors.md"]),
        ("text for a number", ["log.csv", "row 6", "abc"]),
        ("NaN", ["log.csv", "row 6", "NaN"]),
        ("time goes backwards", ["log.csv", "row", "Skeleton_Time"]),
        ("no such placement", ["log.csv", "Kinect_Config"]),
        ("truncated take", ["take.mcap", "ends early"]),
        ("no take", ["take.mcap", "no MCAP file"]),
    ],
)
def test_bad_input_is_one_line_that_says_where_and_what(
    what: str, words: list[str], study_logs: Path, tmp_path: Path
) -> None:
    arguments = broken(tmp_path, study_logs / "Study_7_Kinect_2_Time_3_11_06_PM.csv.gz", what)
    before = sorted(tmp_path.iterdir())
    done = run_here(tmp_path, "replay", *arguments, "--json", "out.json")
    assert done.returncode == 1, done.stdout
    message = SCREEN.sub("", done.stderr).strip()
    assert message.startswith("mocapella: ")
    assert len(message.splitlines()) == 1
    assert all(word in message for word in words), message
    assert sorted(tmp_path.iterdir()) == before


def test_a_kind_of_sensor_that_cannot_be_simulated_is_named(tmp_path: Path) -> None:
    for name, words in (
        ("nite", "take one of kinect_v2, kinect_v1, azure_kinect"),
        ("azure_kinct", "mean azure_kinect?"),
    ):
        done = run_here(tmp_path, "node", "simulate", "--topology", name)
        assert done.returncode == 1
        assert words in done.stderr


def test_an_unknown_sensor_is_named_with_those_there_are(study_logs: Path, tmp_path: Path) -> None:
    log = study_logs / "Study_7_Kinect_2_Time_3_11_06_PM.csv.gz"
    done = run_here(tmp_path, "node", "replay", str(log), "--sensor", "frnt")
    assert done.returncode == 1
    assert "front" in done.stderr
    assert "side" in done.stderr


@pytest.mark.slow
def test_a_real_log_is_replayed_and_the_results_are_json(study_logs: Path, tmp_path: Path) -> None:
    (row,) = result_here(tmp_path, "replay", str(study_logs / "Study_7_Kinect_2_Time_3_11_06_PM.csv.gz"))
    assert row["sensors"] == ["front", "side"]
    assert row["frames_in"] == row["frames_out"] > 3000
    assert row["most_people"] == 1
    assert row["state_changes"][-1]["phase"] == "tracking"
    assert row["placement"] == "right-90"
    assert row["unusable"] == {}
    assert row["log"]["rows"] - row["log"]["duplicates_dropped"] == row["frames_in"]
    assert row["problems"][0].startswith(f"{row['log']['duplicates_dropped']} rows repeat a person")


def test_options_that_would_do_nothing_are_refused(study_logs: Path, tmp_path: Path) -> None:
    log = str(study_logs / "Study_7_Kinect_2_Time_3_11_06_PM.csv.gz")
    (tmp_path / "walk.mcap").touch()
    for arguments, words in (
        (["replay", log, log, "--record", "copy"], "--record wants one file"),
        (["replay", log, log, "--live", "--record", "copy"], "--record wants one file"),
        (["replay", log, "--set", "layout=gone.json"], "gone.json"),
        (["node", "replay", "walk.mcap", "--sensor", "front", "--placement", "parallel"], "leave --placement out"),
    ):
        refused = run_here(tmp_path, *arguments)
        assert refused.returncode == 1
        assert words in SCREEN.sub("", refused.stderr)
    assert [path.name for path in tmp_path.iterdir() if path.is_file()] == ["walk.mcap"]


def test_json_goes_to_a_file_too(tmp_path: Path) -> None:
    assert run_here(tmp_path, "doctor", "--json", "found.json").returncode == 0
    assert json.loads((tmp_path / "found.json").read_text())


def test_a_replay_that_never_tracks_says_why(study_logs: Path, tmp_path: Path) -> None:
    source = study_logs / "Study_7_Kinect_2_Time_3_11_06_PM.csv.gz"
    (tmp_path / "short.csv").write_text("\n".join(gzip.decompress(source.read_bytes()).decode().splitlines()[:61]))
    done = run_here(tmp_path, "replay", "short.csv", "--method", "stand-still", "--json", "out.json")
    (row,) = json.loads((tmp_path / "out.json").read_text())
    assert "calibration never succeeded" in row["never_tracked"]
    assert f"short.csv: nobody was tracked: {row['never_tracked']}\n" in done.stderr
    assert run_here(tmp_path, "replay", "short.csv", "--json", "out.json").returncode == 0
    (row,) = json.loads((tmp_path / "out.json").read_text())
    assert [place["sensor"] for place in row["sensor_places"]] == ["front", "side"]
    assert row["phase"] == "calibrating"
    assert set(row["reason"].split("; ")) <= {said["condition"] for said in row["conditions"]}
    assert row["reason"]


@pytest.mark.slow
def test_settings_of_the_method_are_checked_by_name_and_range(study_logs: Path, tmp_path: Path) -> None:
    log = str(study_logs / "Study_7_Kinect_2_Time_3_11_06_PM.csv.gz")
    verb = ["replay", log, "--method", "stand-still"]
    (sooner,) = result_here(tmp_path, *verb, "--set", "frames=30", "--set", "compare_with=first")
    (later,) = result_here(tmp_path, *verb)
    assert sooner["state_changes"][-1]["at_s"] < later["state_changes"][-1]["at_s"]
    for wrong, words in {"framse=3": "did you mean frames", "frames=0": "from 1 to", "frames": "NAME=VALUE"}.items():
        refused = run_here(tmp_path, *verb, "--set", wrong)
        assert refused.returncode == 1
        assert words in SCREEN.sub("", refused.stderr)
