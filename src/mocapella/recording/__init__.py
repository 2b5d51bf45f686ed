"""Write and read takes, which survive a kill of the recording process, the study log, and files of other programs."""
