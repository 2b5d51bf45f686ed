"""Measures of a study beside the differences: each finds figures in a task (docs/studies-methods.md)."""

from mocapella.studies.measures.measure import MEASURES, Measure

__all__ = ["MEASURES", "Measure"]
