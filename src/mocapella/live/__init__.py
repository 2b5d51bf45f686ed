"""The loops that own threads and wall clocks: a node (one sensor), the server, the view's process, a replay.

Loops only pass values on; the computation is in the other packages.
"""
