"""Publishes a robot's pose to fleet managers by VDA 5050, and accepts their relocations."""
