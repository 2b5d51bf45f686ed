"""Scoring of tracking methods and detectors, on recordings and in simulation (docs/evaluation.md)."""
