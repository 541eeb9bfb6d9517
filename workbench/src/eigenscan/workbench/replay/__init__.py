"""Process replay: the real cores receive what was recorded, and must publish what was recorded."""
