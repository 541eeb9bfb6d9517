"""A map in, eigenspace models out."""
