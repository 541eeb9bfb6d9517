"""Keeps the map true (paper, section 8): changes that robots see in several visits become a new version."""
