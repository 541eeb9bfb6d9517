"""Many robots on one site: certificates, configuration, and how they all are.

\b
Examples:
  eigenscan fleet certify --site hospital --address 10.0.0.5 --robot r17 -o fleet
  eigenscan fleet status
  eigenscan fleet fetch r17 --from 15m
"""  # noqa: D301 - \b keeps the lines apart in --help

COMMANDS = {
    "status": ("eigenscan.cli.fleet.status:status", "a live table of all robots of a site"),
    "relocate": (
        "eigenscan.cli.fleet.relocate:relocate",
        "tell a robot where it is, or to search anew",
    ),
    "fetch": (
        "eigenscan.cli.fleet.fetch:fetch",
        "bring a robot's recordings of some time here",
    ),
    "metrics": ("eigenscan.cli.fleet.metrics:metrics", "all of that for Prometheus, from one place"),
    "certify": (
        "eigenscan.cli.fleet.certify:certify",
        "make a site's certificates and configuration, or add robots",
    ),
    "configure": (
        "eigenscan.cli.fleet.configure:configure",
        "write the configuration anew after a change of fleet.toml",
    ),
    "revoke": ("eigenscan.cli.fleet.revoke:revoke", "shut out a robot whose certificate is in wrong hands"),
}
"""As in `eigenscan.cli.main`."""
