"""`eigenscan fleet metrics`: serves the site's health and poses to Prometheus."""

from __future__ import annotations

import time
from contextlib import closing
from pathlib import Path
from typing import Annotated

import typer
from eigenscan.cli.names import Site
from eigenscan.schemas.channels import DEFAULT_SITE

UPDATE_S = 0.2
SILENT_S = 10.0
"""After which a site without any service is stated: its name may be wrong."""


def metrics(
    site: Site = DEFAULT_SITE,
    zenoh: Annotated[Path | None, typer.Option(help="Zenoh configuration, JSON5")] = None,
    port: Annotated[int, typer.Option(min=0, max=65535, help="serve /metrics here; 0 chooses one")] = 9200,
    host: Annotated[str, typer.Option(help="address to serve on")] = "127.0.0.1",
) -> None:
    """Serve the state of all robots and services of a site to Prometheus. Ctrl-C ends it.

    Robots need no open port, and nothing more crosses the air: poses and health leave the robots anyway.
    deploy/prometheus and deploy/grafana have alerts and a dashboard.

    \b
    Examples:
      eigenscan fleet metrics --site hospital --zenoh deploy/site.json5
      eigenscan fleet metrics --site hospital --port 9300 --host 0.0.0.0
    """  # noqa: D301 - \b keeps the lines apart in --help
    from eigenscan.fleet.collector import SiteCollector
    from eigenscan.fleet.configuration import robots_in
    from eigenscan.fleet.view import FleetView, connect, no_service
    from eigenscan.runtime.errors import UsageError
    from eigenscan.runtime.printable import in_link
    from eigenscan.runtime.stop_event import StopEvent
    from prometheus_client import CollectorRegistry, start_http_server

    with (
        closing(StopEvent()) as stop,
        stop.on_signals(),
        FleetView(connect(zenoh), site, robots_in(zenoh)) as view,
    ):
        registry = CollectorRegistry()
        collector = SiteCollector(view)
        registry.register(collector)
        try:
            server, _ = start_http_server(port, host, registry)
        except OSError as error:
            raise UsageError(
                f"--port {port}: cannot listen on {host}: {error.strerror}: choose another, or another --host"
            ) from error
        typer.echo(f"http://{in_link(host)}:{server.server_port}/metrics")
        silent_since: float | None = time.monotonic()
        while not stop.stopping:
            stop.wait(UPDATE_S)
            collector.update()
            if not view.is_silent:
                silent_since = None
            elif silent_since is not None and time.monotonic() - silent_since > SILENT_S:
                silent_since = None
                typer.echo(f"eigenscan fleet metrics: {no_service(site)}", err=True)
        server.shutdown()
        server.server_close()
