"""`eigenscan fleet`: one module for each of its commands."""

COMMANDS = {
    "status": ("eigenscan.cli.fleet.status:status", "a live table of all robots of a site"),
}
"""As in `eigenscan.cli.main`."""
