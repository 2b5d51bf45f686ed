"""Mocapella tracks people, live, with several cheap depth sensors, and sees around occlusion."""

from pathlib import Path

from mocapella.kernel_cache import discard_stale

__version__ = "0.1.0"

discard_stale(Path(__file__).parent)
