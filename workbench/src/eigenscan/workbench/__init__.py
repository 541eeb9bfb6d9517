"""Tools for logs and recordings, without a robot."""
