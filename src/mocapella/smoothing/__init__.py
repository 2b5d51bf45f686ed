"""Noisy joints → steady joints. One filter for all joints of all people at once; past frames only."""
