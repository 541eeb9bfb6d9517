"""What one does with logs and recordings, away from a robot."""
