"""Write and read takes, which survive a kill of the recording process, and files such as the study log."""
