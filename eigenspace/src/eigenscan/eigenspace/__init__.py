"""Panoramas, their principal components, and the model that carries them."""
