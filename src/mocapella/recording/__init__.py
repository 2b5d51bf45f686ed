"""Takes on disk that survive a kill, and the study log of 2015."""
