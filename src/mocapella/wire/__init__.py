"""The bus, a zenoh network: its keys, sessions and TLS, and the links of nodes, servers and readers to it."""
