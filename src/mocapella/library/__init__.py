"""Mocapella as a Python library: what ``import mocapella`` offers."""
