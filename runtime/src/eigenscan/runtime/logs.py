"""Structured logs on standard error: JSON lines for machines, coloured text for a terminal.

It uses Python's own logging, because structlog takes an eighth of a second to import, which delays every
restart.
"""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import MutableMapping
from datetime import UTC, datetime
from typing import Any

from eigenscan.runtime.printable import printable

NAME = "eigenscan"
_COLOURS = {"DEBUG": "\x1b[2m", "INFO": "\x1b[32m", "WARNING": "\x1b[33m", "ERROR": "\x1b[31m"}
_PLAIN = "\x1b[0m"


class Logger(logging.LoggerAdapter[logging.Logger]):
    """Python's logger, whose calls take context by name: `log.info("ready", site="office")`."""

    def process(self, msg: str, kwargs: MutableMapping[str, Any]) -> tuple[str, MutableMapping[str, Any]]:
        """Adds the context to the record. `exc_info`: an exception."""
        error = kwargs.pop("exc_info", None)
        return msg, {"extra": {"context": {**(self.extra or {}), **kwargs}}, "exc_info": error}

    def bound(self, **context: Any) -> Logger:
        """A logger that adds `context` to each record, for one of several services of a process."""
        return Logger(self.logger, context)


class _Lines(logging.Formatter):
    """Formats a record with `context` in one line; on a terminal, a trace follows on further lines."""

    def __init__(self, console: bool, context: dict[str, Any]) -> None:
        super().__init__()
        self._console, self._context = console, context

    def format(self, record: logging.LogRecord) -> str:
        context = self._context | vars(record).get("context", {})
        trace = self.formatException(record.exc_info) if record.exc_info else ""
        stamp = datetime.fromtimestamp(record.created, UTC).isoformat().replace("+00:00", "Z")
        event, level = record.getMessage(), record.levelname
        if self._console:
            words = " ".join(f"{name}={printable(str(value))}" for name, value in context.items())
            line = f"{stamp} {_COLOURS.get(level, '')}{level.lower():8}{_PLAIN}{event:24} {words}"
            return f"{line}\n{trace}" if trace else line
        context |= {"exception": trace} if trace else {}
        context |= {"event": event, "level": level.lower(), "timestamp": stamp}
        return json.dumps(context, default=repr)


def configure(level: str, style: str, **context: Any) -> Logger:
    """Configures this process's logger, with `context` in each record. `style`: json, console or auto."""
    handler = logging.StreamHandler(sys.stderr)
    console = style == "console" or (style == "auto" and sys.stderr.isatty())
    handler.setFormatter(_Lines(console, context))
    own = logging.getLogger(NAME)
    own.handlers, own.propagate = [handler], False
    own.setLevel(level.upper())
    return logger()


def logger() -> Logger:
    """This process's logger."""
    return Logger(logging.getLogger(NAME))
