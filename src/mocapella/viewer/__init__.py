"""The live view: a 3D display with controls, in any browser.

Its coordinate system, the *view's space*, is in metres with y up and x to the left of the screen (see `layout`).
"""

from mocapella.viewer.viewer import Viewer

__all__ = ["Viewer"]
