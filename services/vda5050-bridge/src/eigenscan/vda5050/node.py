"""vda5050-bridge as a process."""

from __future__ import annotations

from eigenscan.schemas.extra import needs
from eigenscan.vda5050.core import Vda5050Core

with needs("eigenscan-vda5050-bridge[node]", SystemExit):
    from eigenscan.runtime.node import Service
    from eigenscan.runtime.node import main as run
    from eigenscan.vda5050.options import Vda5050Options
    from eigenscan.vda5050.port import MqttPort


def _make_core(options: Vda5050Options) -> Vda5050Core:
    return Vda5050Core(options, options.site, options.robot)


SERVICE = Service("vda5050-bridge", Vda5050Options, _make_core, make_port=MqttPort)


def main() -> None:
    """Entry point of `eigenscan-vda5050-bridge`."""
    run(SERVICE)


if __name__ == "__main__":
    main()
