"""Many robots on one site: certificates, configuration, state.

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
        "set a robot's pose, or restart its search",
    ),
    "fetch": (
        "eigenscan.cli.fleet.fetch:fetch",
        "fetch a robot's recordings of a period",
    ),
    "metrics": ("eigenscan.cli.fleet.metrics:metrics", "serve the state of all robots to Prometheus"),
    "certify": (
        "eigenscan.cli.fleet.certify:certify",
        "make a site's certificates and configuration, or add robots",
    ),
    "configure": (
        "eigenscan.cli.fleet.configure:configure",
        "write the configuration again after a change of fleet.toml",
    ),
    "revoke": ("eigenscan.cli.fleet.revoke:revoke", "revoke the certificate of a stolen robot"),
}
"""As in `eigenscan.cli.main`."""
