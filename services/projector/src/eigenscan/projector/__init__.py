"""One scan and a model in, candidate poses and obstacles out."""
