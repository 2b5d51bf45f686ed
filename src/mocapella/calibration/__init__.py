"""From observations to where each body or sensor stands: methods side by side, chosen by name."""
