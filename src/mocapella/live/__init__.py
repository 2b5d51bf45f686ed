"""The loops that own threads and wall clocks: a node (one sensor), the server, the view's process, a replay.

Loops move values; what is computed is computed elsewhere.
"""
