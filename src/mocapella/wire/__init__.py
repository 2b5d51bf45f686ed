"""The bus: keys, sessions, and what a node, a server and a reader of results each do on it."""
