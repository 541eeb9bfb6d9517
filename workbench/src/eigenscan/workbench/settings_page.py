"""The page of all settings, made from the types that hold them."""

from __future__ import annotations

import argparse
import json
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

from eigenscan.runtime.settings import ServiceSettings
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

KINDS = {
    "scan-ingest": "eigenscan.ingest.options:ScanIngestOptions",
    "projector": "eigenscan.projector.options:ProjectorOptions",
    "tracker": "eigenscan.tracker.options:TrackerOptions",
    "mapbuilder": "eigenscan.mapbuilder.options:MapbuilderOptions",
    "recorder": "eigenscan.recorder.options:RecorderOptions",
    "ros-bridge": "eigenscan.ros_bridge.options:RosBridgeOptions",
    "vda5050-bridge": "eigenscan.vda5050.options:Vda5050Options",
    "router": "eigenscan.runtime.router:RouterSettings",
}
"""The module with each service's settings."""

MARK = "<!-- what follows is made from the settings' types by python -m eigenscan.workbench.settings_page -->"


def settings_of(service: str) -> type[ServiceSettings]:
    """The type that holds a service's settings."""
    module, _, kind = KINDS[service].partition(":")
    found: type[ServiceSettings] = getattr(import_module(module), kind)
    return found


def page() -> str:
    """The part of the page that is made, Markdown."""
    parts = [MARK, "\n## Every service\n", _table(ServiceSettings, frozenset())]
    for service in KINDS:
        parts += [f"## {service}\n", _table(settings_of(service), frozenset(ServiceSettings.model_fields))]
    return "\n".join(parts)


def _table(kind: type[ServiceSettings], known: frozenset[str]) -> str:
    rows = [
        f"| `{name}` | {_default(field)} | {_words(field)} |"
        for name, field in kind.model_fields.items()
        if name not in known
    ]
    if not rows:
        return "None of its own.\n"
    return "\n".join(["| setting | default | |", "|---|---|---|", *rows, ""])


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "must be given"
    if field.default is None or field.default is PydanticUndefined or field.default == "":
        return ""
    value: Any = field.default
    text = value if isinstance(value, str) else json.dumps(value, default=str)
    return f"`{text}`"


def _words(field: FieldInfo) -> str:
    return " ".join((field.description or "").split()).replace("|", "\\|")


def main() -> None:
    """Writes the page; with --check, fails if the page is not up to date."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("--check", action="store_true")
    arguments = parser.parse_args()
    before = arguments.file.read_text(encoding="utf-8")
    text = before.partition(MARK)[0] + page()
    if not arguments.check:
        arguments.file.write_text(text, encoding="utf-8")
    elif before != text:
        again = f".venv/bin/python -m eigenscan.workbench.settings_page {arguments.file}"
        sys.exit(f"{arguments.file}: is not current: run {again}")


if __name__ == "__main__":
    main()
