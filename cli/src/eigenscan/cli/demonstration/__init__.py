"""The demo, and the judgement at its end."""
