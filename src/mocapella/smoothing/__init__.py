"""Smoothing filters of joints and other points, which use past frames only."""
