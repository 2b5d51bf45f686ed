"""What docs/bodies.md shows runs, and its extras are read."""

from __future__ import annotations

import json
import re
from pathlib import Path

import msgspec
import numpy as np
import pytest

from mocapella.model.rigged_mesh import landmarks_at, rigid_mesh
from mocapella.model.rigged_mesh_file import _OfMesh, _OfNode

TEXT = (Path(__file__).resolve().parent.parent / "docs" / "bodies.md").read_text(encoding="utf-8")


def blocks(kind: str) -> list[str]:
    return re.findall(rf"```{kind}\n(.*?)```", TEXT, flags=re.DOTALL)


def test_the_example_runs_and_gives_what_it_says() -> None:
    (code,) = blocks("python")
    names: dict[str, object] = {}
    exec(code, names)
    measured, again = names["measured"], names["again"]
    there = dict(zip(measured.landmarks, landmarks_at(measured, again), strict=True))  # type: ignore[attr-defined, arg-type]
    for name, point in names["joints"].items():  # type: ignore[attr-defined]
        np.testing.assert_allclose(there[name], point, atol=0.01)


def test_degrees_of_freedom_are_those_of_the_table() -> None:
    from mocapella.model.body_meshes import body_mesh, legs_mesh
    from mocapella.model.hand import hand_model
    from mocapella.model.hand_mesh import hand_mesh

    rows = dict(re.findall(r"^\| `(\w+)\(.*?\| (\d+) \|", TEXT, flags=re.MULTILINE))
    made = {
        "body_mesh": body_mesh(),
        "legs_mesh": legs_mesh(),
        "hand_mesh": hand_mesh(hand_model("full").shape("left")),
        "rigid_mesh": rigid_mesh("thing", np.eye(3), [[0, 1, 2]]),
    }
    assert {name: int(dofs) for name, dofs in rows.items()} == {name: mesh.tree.dofs for name, mesh in made.items()}


@pytest.mark.parametrize(("block", "kind"), list(zip(blocks("json"), (_OfNode, _OfMesh), strict=True)))
def test_the_extras_are_as_they_are_read(block: str, kind: type) -> None:
    assert isinstance(msgspec.convert(json.loads(block)["mocapella"], kind), kind)
