"""The command group: subcommands that load when they are called, and errors in one line."""

from __future__ import annotations

import errno
import importlib
import os
import typing
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import typer
from eigenscan.cli import paths
from eigenscan.cli.entry import EXIT_STOPPED, EXIT_UNREAD, STDOUT
from eigenscan.cli.former import current
from eigenscan.runtime.errors import FailedError, by_users, one_line, signal_within
from eigenscan.runtime.settings import nearest, plain
from typer.core import TyperCommand, TyperGroup

EXIT_FAILED = 1
"""It ran, and failed."""

EXIT_USAGE = 2
"""Wrong usage, or bad input."""

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)

_MISTYPED: Any = typer.BadParameter.__mro__[1]
"""Typer's error for a mistake in the command line, which it does not export."""


def _typed_wrongly(error: Exception) -> str:
    """One line on a mistake in the command line; empty for other errors."""
    if not isinstance(error, _MISTYPED) or type(error).__name__ == "NoArgsIsHelpError":
        return ""
    text = plain(" ".join(str(error.format_message()).split()).rstrip("."))
    if (typed := getattr(error, "option_name", None)) and hasattr(error, "possibilities"):
        text = f"no such option: {typed}{nearest(typed, error.possibilities or ())}"
    return text[:1].lower() + text[1:]


def _described(error: Exception, command: str, is_known: bool) -> tuple[str, int] | None:
    """The line for an error of `command`, and the exit code; None for Typer's own exit, abort and help."""
    if type(error).__module__.startswith("typer."):
        mistake = _typed_wrongly(error)
        place = command if is_known else command.rpartition(" ")[0]
        return (f"{place}: {mistake}: see {place} --help", EXIT_USAGE) if mistake else None
    if isinstance(error, FailedError):
        return f"{command}: {error}", EXIT_FAILED
    if "cannot cache function" in str(error):
        line = f"{command}: compiled code cannot be kept: set NUMBA_CACHE_DIR to a writable folder"
        return line, EXIT_USAGE
    if isinstance(error, FileNotFoundError) and error.filename is None:  # of where we are
        folder = os.environ.get("PWD", "the working folder")
        return f"{command}: {folder}: this folder is gone: change to another", EXIT_USAGE
    if by_users(error):
        return f"{command}: {one_line(error)}", EXIT_USAGE
    line = f"{command}: {type(error).__name__}: {one_line(error)}"
    return f"{line} (a fault of ours; eigenscan --debug shows the trace)", EXIT_FAILED


@contextmanager
def _signals_of_compiled_code() -> Iterator[None]:
    """Raises what a signal raised there."""
    try:
        yield
    except SystemError as error:
        if signalled := signal_within(error):
            raise signalled from None
        raise


WIDEST = 120
"""Columns that help takes of a wider terminal."""

_VALUES = {float: "NUMBER", int: "N", Path: "PATH", str: "TEXT"}
"""Help's names for the values of options."""


class ShortHelp(TyperCommand):
    """A command whose --help lists the main options, and --help-all all of them by group."""

    shows_all = False

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """As usual, with --help-all."""
        own = args[: args.index("--")] if "--" in args else args
        if "--help-all" in own:
            self.shows_all, args = True, ["--help"]
        return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """As usual, with paths that can be meant; a disk that is full is named by what is written."""
        paths.check(self.params, ctx.params)
        try:
            return super().invoke(ctx)
        except OSError as error:
            if error.filename is None and error.errno in _FULL:
                error.filename = paths.written_ones(self.params, ctx.params) or None
            raise

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """Such as [OPTIONS] LOG [MAP]: Typer would write {LOG}."""
        named = [name for each in self.get_params(ctx) if (name := _argument(each))]
        return [self.options_metavar or "", *named]

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Arguments, options, and with --help-all the groups of the other options."""
        groups: dict[str, list[tuple[str, str]]] = {"Arguments": [], "Options": []}
        for parameter in self.get_params(ctx):
            if record := parameter.get_help_record(ctx):
                if is_argument := _is_argument(parameter):
                    record = parameter.metavar or parameter.name.upper(), record[1]
                panel = getattr(parameter, "rich_help_panel", None) or "Options"
                groups.setdefault("Arguments" if is_argument else panel, []).append(record)
        for heading, records in groups.items():
            if records and (self.shows_all or heading in ("Arguments", "Options")):
                with formatter.section(heading):
                    formatter.write_dl(records)
        hidden = sum(len(records) for heading, records in groups.items()) - sum(
            len(groups[heading]) for heading in ("Arguments", "Options")
        )
        if hidden and not self.shows_all:
            formatter.write_paragraph()
            formatter.write_text(f"{hidden} more options: {ctx.command_path} --help-all")


def _is_argument(parameter: Any) -> bool:
    return bool(parameter.param_type_name == "argument")


def _argument(parameter: Any) -> str:
    """An argument as the usage line shows it; empty for an option or a hidden argument."""
    if not _is_argument(parameter) or getattr(parameter, "hidden", False):
        return ""
    name = parameter.metavar or parameter.name.upper()
    return name if parameter.required else f"[{name}]"


def _load(name: str, place: str) -> Any:
    """The command or group `name` at `module:function` or `module:table`."""
    module, _, function = place.partition(":")
    source = importlib.import_module(module)
    target = getattr(source, function)
    if isinstance(target, Mapping):
        group = typer.Typer(
            name=name,
            cls=lazy_group(target),
            help=source.__doc__,
            no_args_is_help=True,
            add_completion=False,
            rich_markup_mode=None,
        )
        group.callback()(lambda: None)
        return typer.main.get_command(group)
    single = typer.Typer(rich_markup_mode=None, add_completion=False)
    single.command(name, cls=ShortHelp, context_settings={"max_content_width": WIDEST})(target)
    command = typer.main.get_command(single)
    for parameter in command.params:
        _name_value(parameter)
    return command


def _name_value(parameter: Any) -> None:
    """Names an option's value for people, where Typer shows the Python type."""
    described = getattr(parameter, "type_descriptor", None)
    named = [_VALUES[kind] for kind in _plain(getattr(described, "annotation", None)) if kind in _VALUES]
    if named and parameter.metavar is None and hasattr(parameter, "is_flag"):  # an argument has a name
        parameter.metavar = named[0]


def _plain(annotation: Any) -> list[Any]:
    """The types in `list[str] | None` and the like."""
    inner = typing.get_args(annotation)
    return [kind for each in inner for kind in _plain(each)] if inner else [annotation]


def lazy_group(
    commands: Mapping[str, tuple[str, str]], headings: Mapping[str, Sequence[str]] | None = None
) -> type[TyperGroup]:
    """Makes a group of name -> (`module:function`, one line of help).

    A command's module is imported when it is used. `headings`: names that the help lists together; the others
    come last. If `function` is a table of the same form, it becomes a group with the module's docstring as
    its help.
    """

    class LazyGroup(TyperGroup):
        def list_commands(self, _ctx: Any) -> list[str]:
            return list(commands)

        def get_command(self, _ctx: Any, cmd_name: str) -> Any:
            if cmd_name not in commands:
                return None
            return _load(cmd_name, commands[cmd_name][0])

        def format_commands(self, _ctx: Any, formatter: Any) -> None:
            named = {name for names in (headings or {}).values() for name in names}
            rest = "Others" if named else "Commands"
            listed = {**(headings or {}), rest: [name for name in commands if name not in named]}
            for heading, names in listed.items():
                if names:
                    with formatter.section(heading):
                        formatter.write_dl([(name, commands[name][1]) for name in names])

        def resolve_command(self, ctx: Any, args: list[str]) -> Any:
            if (meant_now := current(args[0], args[1:])) in commands:
                args = [meant_now, *args[1:]]
            if args[0] not in commands:
                meant = nearest(args[0], commands) or f": choose one of {', '.join(commands)}"
                ctx.fail(f"no command {args[0]!r}{meant}")
            return super().resolve_command(ctx, args)

        def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
            # people add --debug at the end of the line that failed
            own = args[: args.index("--")] if "--" in args else args
            if "--debug" in own:
                args = ["--debug", *(each for each in own if each != "--debug"), *args[len(own) :]]
            try:
                return super().parse_args(ctx, args)
            except _MISTYPED as error:
                mistake = "" if ctx.parent else _typed_wrongly(error)
                if not mistake:
                    raise
                typer.echo(f"eigenscan: {mistake}: see eigenscan --help", err=True)
                raise typer.Exit(EXIT_USAGE) from None
            except BrokenPipeError:
                raise typer.Exit(EXIT_UNREAD) from None
            except OSError as error:  # its help cannot be written
                typer.echo(f"eigenscan: {one_line(error)}", err=True)
                raise typer.Exit(EXIT_USAGE) from None

        def invoke(self, ctx: Any) -> Any:
            try:
                with _signals_of_compiled_code():
                    return super().invoke(ctx)
            except (Exception, KeyboardInterrupt) as error:
                if ctx.find_root().params.get("debug"):
                    raise
                names = [ctx.info_name] if ctx.parent else []
                command = " ".join(["eigenscan", *filter(None, names), ctx.invoked_subcommand or "?"])
                if isinstance(error, KeyboardInterrupt):
                    typer.echo(f"{command}: ended by Ctrl-C{': ' if str(error) else ''}{error}", err=True)
                    raise typer.Exit(EXIT_STOPPED) from None
                if isinstance(error, BrokenPipeError) and error.filename == STDOUT:
                    raise typer.Exit(EXIT_UNREAD) from None  # its reader, such as head, has what it wanted
                described = _described(error, command, ctx.invoked_subcommand in commands)
                if described is None:
                    raise
                line, exit_code = described
                typer.echo(line, err=True)
                raise typer.Exit(exit_code) from None

    return LazyGroup
