"""Hot spots on the floor, from heat cameras at the ceiling."""
