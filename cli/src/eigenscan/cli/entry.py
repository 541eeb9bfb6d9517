"""The entry point of `eigenscan`: signals, Ctrl-C while it still loads, and errors of standard output."""

from __future__ import annotations

import atexit
import codecs
import io
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

STDOUT = "standard output"
ENDING = (signal.SIGTERM, signal.SIGHUP)
"""Of `kill` and `timeout`, and of a terminal that is closed."""
SIGNALLED = 128
"""Exit code, as shells have it, of a process that a signal ended, less the signal's number."""
EXIT_STOPPED = SIGNALLED + signal.SIGINT
"""Exit code after Ctrl-C."""
AGAIN_S = 0.1
"""After which a signal is sent again."""
EXIT_UNREAD = 141
"""Exit code where the reader of standard output ended first, as shells have it after SIGPIPE."""


def main() -> None:
    """Runs the command."""
    usual = signal.getsignal(signal.SIGINT)
    if usual is not signal.SIG_IGN:  # as a shell has it in a script's background
        signal.signal(signal.SIGINT, _end)
    from eigenscan.runtime.closed_streams import lead_nowhere

    lead_nowhere()
    from eigenscan.cli.main import app

    signal.signal(signal.SIGINT, usual)
    for number in ENDING:
        if signal.getsignal(number) is not signal.SIG_IGN:  # as nohup has it
            signal.signal(number, _unwind)
    sys.unraisablehook = _send_again
    code = 0
    if os.environ.get("COLUMNS") == "0":  # some terminals do not know their width; nothing fits in none
        del os.environ["COLUMNS"]
    try:
        with named_output():
            app()
    except SystemExit as ended:
        if not isinstance(ended.code, int | None):
            raise
        code = ended.code or 0
    # not in the except: the error would hold what a command had open, a session's threads among it
    _leave(code)


def _leave(code: int) -> None:
    """Ends the process without the interpreter's own end, which a thread that opens a session would abort."""
    signal.signal(signal.SIGINT, _end)
    by_signal = code - SIGNALLED
    if by_signal not in (signal.SIGINT, *ENDING):
        for thread in threading.enumerate():
            if thread is not threading.current_thread() and not thread.daemon:
                thread.join()
    atexit._run_exitfuncs()
    with suppress(OSError):
        sys.stdout.flush()
    with suppress(OSError):
        sys.stderr.flush()
    if by_signal in ENDING:  # who started this process sees how it ended
        signal.signal(by_signal, signal.SIG_DFL)
        os.kill(os.getpid(), by_signal)
    os._exit(code)


def _unwind(number: int, _: object) -> None:
    """Ends the command as an error would, so that children end and no half of a file stays."""
    for each in ENDING:  # a closed terminal may send both
        signal.signal(each, lambda *_: None)  # not SIG_IGN, which a child would inherit
    raise SystemExit(SIGNALLED + number)


def _send_again(swallowed: sys.UnraisableHookArgs) -> None:
    """Sends a signal again whose error was raised in a callback of compiled code, and lost there.

    So numba's compiler has it: the command went on, and no later signal ended it.
    """
    error = swallowed.exc_value
    if isinstance(error, KeyboardInterrupt):
        number = signal.SIGINT
    elif isinstance(error, SystemExit) and isinstance(error.code, int) and error.code - SIGNALLED in ENDING:
        number = signal.Signals(error.code - SIGNALLED)
        signal.signal(number, _unwind)
    else:
        sys.__unraisablehook__(swallowed)
        return
    again = threading.Timer(AGAIN_S, os.kill, (os.getpid(), number))
    again.daemon = True
    again.start()


def _end(*_: object) -> None:
    os.write(2, b"eigenscan: ended by Ctrl-C\n")
    os._exit(EXIT_STOPPED)  # an exception in the midst of an import would show where


class _Named(io.FileIO):
    """Standard output whose errors name it: else nobody knows which of all outputs is full or closed."""

    def write(self, data: object) -> int:
        try:
            return super().write(data)  # type: ignore[arg-type]
        except OSError as error:
            error.filename = STDOUT
            raise


@contextmanager
def named_output() -> Iterator[None]:
    """Lets errors of standard output name it, also the last one, at the end of the process."""
    usual = sys.stdout
    if not isinstance(usual, io.TextIOWrapper):
        yield
        return
    usual.flush()
    sys.stdout = io.TextIOWrapper(
        io.BufferedWriter(_Named(usual.fileno(), "wb", closefd=False)),
        encoding=usual.encoding,
        # a finished work is not lost for a sign, such as °, that an output in ASCII has not
        errors=usual.errors if codecs.lookup(usual.encoding).name == "utf-8" else "replace",
        line_buffering=usual.line_buffering,
    )
    try:
        yield
    finally:
        try:
            sys.stdout.flush()
        except OSError:  # reported already; the interpreter would try again, and show a trace
            os.dup2(os.open(os.devnull, os.O_WRONLY), usual.fileno())


if __name__ == "__main__":
    main()
