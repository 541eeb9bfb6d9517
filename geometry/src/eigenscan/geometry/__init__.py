"""Poses on the plane, maps and rays."""
