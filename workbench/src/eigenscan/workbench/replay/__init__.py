"""Process replay: the real cores hear what was recorded, and must say what was recorded."""
