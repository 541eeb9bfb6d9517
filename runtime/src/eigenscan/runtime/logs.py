"""Structured logs: JSON lines for machines, colours for a terminal."""

from __future__ import annotations

import logging
import sys
from typing import Any

import structlog


def configure(level: str, style: str, **context: Any) -> structlog.stdlib.BoundLogger:
    """Logger on standard error with `context` bound. `style`: json, console or auto."""
    console = style == "console" or (style == "auto" and sys.stderr.isatty())
    rendering: list[Any] = (
        [structlog.dev.ConsoleRenderer()]
        if console
        else [structlog.processors.format_exc_info, structlog.processors.JSONRenderer()]
    )
    structlog.configure(
        processors=[
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso"),
            *rendering,
        ],
        wrapper_class=structlog.make_filtering_bound_logger(getattr(logging, level.upper())),
        # in one write: threads log at the same time
        logger_factory=structlog.WriteLoggerFactory(file=sys.stderr),
        cache_logger_on_first_use=True,
    )
    logger: structlog.stdlib.BoundLogger = structlog.get_logger(**context)
    return logger
