"""``python -m mocapella`` is ``mocapella``."""

from mocapella.cli import main

main()
