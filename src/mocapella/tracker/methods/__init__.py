"""The tracking methods that ship with Mocapella, one descriptor a module."""
