"""Hypotheses and odometry in, one honest pose out."""
