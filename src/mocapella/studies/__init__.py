"""Studies with participants: the protocol, the session, its log, the analysis, its pictures and report."""
