"""Processes and loops with threads and wall clocks: a sensor's node, the server, the view, a replay.

Loops only pass values on; the computation is in the other packages.
"""
