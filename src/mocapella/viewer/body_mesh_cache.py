"""Cache of the meshes of fitted bodies, built on a separate thread from the bodies' descriptions."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Final

from mocapella.errors import MocapellaError
from mocapella.model.body_builds import mesh_of_build
from mocapella.model.rigged_mesh import RiggedMesh, posed, rest

MOST: Final = 64
"""Largest number of cached meshes; the earliest stored are dropped."""


class BodyMeshCache:
    """Cache of body meshes by their JSON description (`mocapella.model.scene.TrackedBody.build`), for any thread.

    It has at most `MOST` meshes. One that was dropped is built again when it is requested.
    """

    def __init__(self) -> None:
        self._meshes: dict[str, RiggedMesh | None] = {}
        self._lock = threading.Lock()
        self._worker: ThreadPoolExecutor | None = None

    def mesh(self, build: str) -> RiggedMesh | None:
        """Return the mesh without waiting; None while it is being built, or if it cannot be built.

        ``build`` is the JSON description; a new one starts the building on the cache's thread, an empty one gives None.
        """
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
        """Store a mesh that is already built, such as one read from a file, for the JSON description ``build``."""
        with self._lock:
            self._keep(build, mesh)

    def _make(self, build: str) -> None:
        try:
            mesh = mesh_of_build(build)
        except MocapellaError:
            return  # lines between landmarks are drawn
        posed(mesh, rest(mesh))  # compiles the kernels that drawing needs
        self.put(build, mesh)

    def _keep(self, build: str, mesh: RiggedMesh | None) -> None:
        self._meshes[build] = mesh
        while len(self._meshes) > MOST:
            del self._meshes[next(iter(self._meshes))]


SHELF: Final = BodyMeshCache()
"""Cache of this process, shared by all views, because a description determines its mesh."""
