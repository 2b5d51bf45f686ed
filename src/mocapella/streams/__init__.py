"""Streams: results of a running server as datagrams for other programs, while people move."""
