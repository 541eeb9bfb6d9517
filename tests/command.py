"""The `eigenscan` command without a new Python for each call: the same words, exit codes and files.

What is about the process itself (signals, a quick start, a terminal) starts one; tests/cli/test_frame.py
shows that both end alike.
"""

import os
import subprocess
import traceback
from collections.abc import Iterator
from contextlib import chdir, contextmanager
from pathlib import Path

from eigenscan.cli.main import app
from typer.testing import CliRunner


def eigenscan(
    *arguments: object, cwd: Path | None = None, **environment: str
) -> subprocess.CompletedProcess[str]:
    """What `eigenscan ARGUMENTS` prints and how it ends, in the folder `cwd`."""
    words = [str(argument) for argument in arguments]
    with chdir(cwd or Path.cwd()), _environment_kept():
        result = CliRunner().invoke(app, words, env=environment, prog_name="eigenscan")
    error = "" if isinstance(result.exception, SystemExit) or result.exc_info is None else result.exc_info
    published = "".join(traceback.format_exception(*error)) if error and result.exception else ""
    return subprocess.CompletedProcess(words, result.exit_code, result.stdout, result.stderr + published)


@contextmanager
def _environment_kept() -> Iterator[None]:
    """A command may set variables for those that it starts; a test after it has none of them."""
    before = dict(os.environ)
    try:
        yield
    finally:
        for name in set(os.environ) - set(before):
            del os.environ[name]
        os.environ.update(before)
