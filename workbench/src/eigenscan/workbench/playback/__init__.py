"""Playback: a recording published again on Zenoh, with pause and seek, under other names and stamps."""
