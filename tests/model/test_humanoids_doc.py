"""The table of docs/humanoids.md is that of the program."""

from __future__ import annotations

from pathlib import Path

from mocapella.model.humanoid_bones import BONES, HUMANOIDS

DOC = Path(__file__).resolve().parents[2] / "docs" / "humanoids.md"


def test_the_names_of_the_document_are_those_of_the_program() -> None:
    lines = DOC.read_text(encoding="utf-8").splitlines()
    rows = [[cell.strip(" `") for cell in line.strip("|").split("|")] for line in lines if line.startswith("|")]
    parts = [part for part in BONES if not part.startswith("right")]
    found = {row[0]: row[1:6] for row in rows if len(row) == 8 and row[0] in parts}
    wanted = {
        part: [
            HUMANOIDS[name].get(part, "–").replace("mixamorig:", "")
            for name in ("vrm", "unity", "mixamo", "kinect", "smpl")
        ]
        for part in parts
    }
    assert found == wanted
