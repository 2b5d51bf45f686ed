"""The live 3D view and its controls, in any browser."""

from mocapella.viewer.viewer import Viewer

__all__ = ["Viewer"]
