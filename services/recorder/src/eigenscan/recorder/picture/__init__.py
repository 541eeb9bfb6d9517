"""What the traffic looks like, drawn into a Rerun recording."""
