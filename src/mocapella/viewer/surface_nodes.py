"""Scene nodes of a stage's surfaces by name: created when they first appear, and hidden while not drawn."""

from __future__ import annotations

from collections.abc import Mapping

import viser

from mocapella.viewer.drawing import SurfaceNode
from mocapella.viewer.stage import Surface


class SurfaceNodes:
    """Scene nodes of a stage's surfaces.

    Args:
        scene: viser's 3D scene of the browser.
        name: path of the nodes' parent.
    """

    def __init__(self, scene: viser.SceneApi, name: str) -> None:
        self._scene, self._name = scene, name
        self._nodes: dict[str, SurfaceNode] = {}

    def draw(self, surfaces: Mapping[str, Surface]) -> None:
        """Show exactly these surfaces, by name, in place of the earlier ones; others are hidden, not removed."""
        for name, surface in surfaces.items():
            if name not in self._nodes:
                self._nodes[name] = SurfaceNode(self._scene, f"{self._name}/{len(self._nodes)}")
            self._nodes[name].draw(surface.mesh, surface.colour, surface.opacity)
        for name, node in self._nodes.items():
            if name not in surfaces:
                node.hide()
