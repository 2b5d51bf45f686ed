"""How good a tracking method is, by a scoring that cannot be flattered (docs/evaluation.md)."""
