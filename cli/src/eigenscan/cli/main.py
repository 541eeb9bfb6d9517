"""The `eigenscan` command: one module of this folder for each subcommand."""

from __future__ import annotations

from typing import Annotated

import typer
from eigenscan.cli.command_group import lazy_group

COMMANDS = {
    "demo": ("eigenscan.cli.demo:demo", "watch a simulated robot find itself, twice"),
    "run": ("eigenscan.cli.run:run", "start all services for your own map and robot"),
    "build": ("eigenscan.cli.build:build", "build the models of a map, into a folder"),
    "models": ("eigenscan.cli.models:models", "list the versions of a model folder, go back to one"),
    "map": ("eigenscan.cli.map_log:map_log", "make a map of a log, with odometry or without"),
    "import": (
        "eigenscan.cli.import_log:import_log",
        "turn a CARMEN log, a ROS bag or a CSV into a recording",
    ),
    "evaluate": (
        "eigenscan.cli.evaluate:evaluate",
        "judge the pipeline on a log, with a reference or without",
    ),
    "play": ("eigenscan.cli.play:play", "publish a recording on Zenoh"),
    "replay": ("eigenscan.cli.replay:replay", "feed a recording to a service's core and compare its answers"),
    "replay-test": (
        "eigenscan.cli.replay_test:replay_test",
        "check a folder of recordings against the services",
    ),
    "conform": ("eigenscan.cli.conform:conform", "judge any program in a service's place by the contract"),
    "repair": ("eigenscan.cli.repair:repair", "save what can be read of a recording that was cut or damaged"),
    "view": ("eigenscan.cli.view:view", "look at a recording in Rerun's web viewer"),
    "simulate": ("eigenscan.cli.simulate:simulate", "a simulated robot's recording and its true path"),
    "simtest": ("eigenscan.cli.simtest:simtest", "run a simulated site through simulated faults, by seeds"),
    "doctor": ("eigenscan.cli.doctor:doctor", "find what is wrong with a deployment, and how to mend it"),
    "fleet": ("eigenscan.cli.fleet:COMMANDS", "many robots on one site"),
}
"""Name: `module:function` and one line of help. A module is imported when its command is used."""

HEADINGS = {
    "Start here": ("demo", "run"),
    "Maps": ("map", "build", "models"),
    "Logs and recordings": ("import", "simulate", "evaluate", "play", "view", "repair"),
    "A site": ("fleet", "doctor"),
    "Changes to the services": ("replay", "replay-test", "conform", "simtest"),
}
"""Commands that the help lists together; the others come last."""

app = typer.Typer(
    name="eigenscan",
    cls=lazy_group(COMMANDS, HEADINGS),
    help="Finds a robot with a 2D lidar on a map, without an initial pose.",
    epilog="Exit codes: 0 done, 1 ran and failed, 2 wrong usage or bad input, 130 ended by Ctrl-C. "
    "Start with: eigenscan demo. More on one command: eigenscan demo --help",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(version("eigenscan"))
        raise typer.Exit


@app.callback()
def _root(
    *,
    debug: Annotated[
        bool, typer.Option("--debug", help="Show the trace of errors that have one line.")
    ] = False,
    _version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and end."),
    ] = False,
) -> None:
    pass


if __name__ == "__main__":
    app()
