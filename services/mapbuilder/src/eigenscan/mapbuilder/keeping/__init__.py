"""Keeping the map true (paper, section 8): what robots see, visit after visit, becomes a new version."""
