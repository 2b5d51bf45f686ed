"""Many views of one person make one person."""
