"""The bus: keys, sessions, and the links of nodes, servers and readers."""
