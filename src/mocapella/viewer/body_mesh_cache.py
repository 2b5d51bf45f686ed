"""Meshes of fitted bodies, made again from their builds on a thread of their own, each once."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Final

from mocapella.errors import MocapellaError
from mocapella.model.body_builds import mesh_of_build
from mocapella.model.rigged_mesh import RiggedMesh, posed, rest

MOST: Final = 64
"""So many meshes are kept; the oldest are let go."""


class BodyMeshCache:
    """Cache of body meshes, by the JSON description of the mesh (`TrackedBody.build`)."""

    def __init__(self) -> None:
        self._meshes: dict[str, RiggedMesh | None] = {}
        self._lock = threading.Lock()
        self._worker: ThreadPoolExecutor | None = None

    def mesh(self, build: str) -> RiggedMesh | None:
        """Return the mesh at once; None while it is being built, or if it cannot be built."""
        if not build:
            return None
        with self._lock:
            if build in self._meshes:
                return self._meshes[build]
            self._keep(build, None)
            if self._worker is None:
                self._worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="view-bodies")
            self._worker.submit(self._make, build)
        return None

    def put(self, build: str, mesh: RiggedMesh) -> None:
        """Store a mesh that is already built, such as one read from a file."""
        with self._lock:
            self._keep(build, mesh)

    def _make(self, build: str) -> None:
        try:
            mesh = mesh_of_build(build)
        except MocapellaError:
            return  # lines between landmarks are drawn
        posed(mesh, rest(mesh))  # compiles what drawing needs
        self.put(build, mesh)

    def _keep(self, build: str, mesh: RiggedMesh | None) -> None:
        self._meshes[build] = mesh
        while len(self._meshes) > MOST:
            del self._meshes[next(iter(self._meshes))]


SHELF: Final = BodyMeshCache()
"""Of this process: a build says all that its mesh is."""
