"""Any lidar frame in, one canonical scan out."""
