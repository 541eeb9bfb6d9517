"""Draws the traffic into a Rerun recording."""
