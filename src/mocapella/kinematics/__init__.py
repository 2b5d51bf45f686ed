"""Steady points → a body in a pose: a chain of twists with bone lengths, joint limits and a prediction."""
