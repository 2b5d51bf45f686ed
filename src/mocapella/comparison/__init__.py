"""Comparison of a recording with a reference: clocks, rigid motion, and agreement of joints and angles."""
