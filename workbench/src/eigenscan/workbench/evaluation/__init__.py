"""How good the pipeline is on a log, a map and a reference trajectory."""
