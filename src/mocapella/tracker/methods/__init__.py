"""The tracking methods that ship with Mocapella, one descriptor per module."""
