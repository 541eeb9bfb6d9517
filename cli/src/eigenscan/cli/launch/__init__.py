"""Starts the services as child processes of this command, watches them, and ends them."""
