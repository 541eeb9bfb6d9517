"""A whole log of scans becomes one map: registration, closures, pose graph, carving."""
