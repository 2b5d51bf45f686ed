"""Data model: frozen values that all other packages exchange.

The values of the hot path (frames, scenes) are msgspec structs, which are made fourteen times faster than frozen
dataclasses; settings and status are dataclasses. Both are replaced, never changed.
"""
