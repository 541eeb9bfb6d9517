"""The demo: a show with a judgement at its end."""
