"""What Mocapella costs, measured: `python -m benchmarks`.

A module in this folder that has ``run(quick: bool = False) -> list[Row]`` is a group; nothing registers it.
"""
