"""Playback: a recording said again on Zenoh, with pause and seek, under other names and stamps."""
