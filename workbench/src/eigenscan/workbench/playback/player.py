"""Plays messages at the pace at which they were logged, as far and as long as its user wants."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from eigenscan.schemas.envelope import Envelope
from eigenscan.workbench.playback.cast import shifted
from eigenscan.workbench.playback.controls import Command, Controls, Do
from eigenscan.workbench.simulation.live import Metronome
from eigenscan.workbench.simulation.stage import Timed

LOOK_S = 0.1
LONGEST_PAUSE_NS = 600_000_000_000
"""Time without a message that is waited for, ns. In a longer one no recorder ran, or its clock was set."""


@dataclass(frozen=True)
class Score:
    """The messages to play. `messages` yields all from a time on; times are log times, ns."""

    messages: Callable[[int], Iterator[Timed]]
    start: int
    """Begin of the recording: seconds count from here."""
    begin: int
    end: int


class Player:
    """One playback. `moved` is called with its time (ns), and whether it is paused."""

    def __init__(
        self,
        score: Score,
        publish: Callable[[Envelope], None],
        controls: Controls,
        moved: Callable[[int, bool], None],
        speed: float = 1.0,
        clock: Callable[[], int] | None = None,
    ) -> None:
        """With `clock`, ns since the epoch, stamps are shifted to the present."""
        self._score, self._publish, self._controls, self._moved = score, publish, controls, moved
        self._metronome, self._clock = Metronome(speed), clock
        self._paused = self._stepping = False
        self._at = score.begin
        self._shift: int | None = None
        self._newest = 0
        self._looked_at = 0.0

    def play(self) -> None:
        """Plays to the end, or until it is asked to end."""
        begin: int | None = self._score.begin
        while begin is not None:
            self._start_again()
            begin = self._play_from(begin)

    def _play_from(self, begin: int) -> int | None:
        """Plays on from a time; where to go on, None at the end."""
        for timed in self._score.messages(begin):
            if timed.time - self._at > LONGEST_PAUSE_NS:
                self._start_again()
            while (rest := self._rest(timed)) is None or rest > 0.0 or self._owes_a_look():
                command = self._controls.wait(rest)
                if command is None:
                    continue
                if command.do is Do.END:
                    return None
                target = self._obey(command)
                if target is not None:
                    return target
            self._stepping = False
            self._publish(self._stamped(timed))
            self._go_to(timed.time)
        return None

    def _rest(self, timed: Timed) -> float | None:
        """Seconds until a message is due; None while paused."""
        if self._stepping:
            return 0.0
        return None if self._paused else self._metronome.rest(timed.time)

    def _owes_a_look(self) -> bool:
        """Whether commands were not asked for since a while, for there was no time to wait.

        Not before the message of a step: the command after it would take its place.
        """
        now = time.monotonic()
        if self._stepping or now - self._looked_at < LOOK_S:
            return False
        self._looked_at = now
        return True

    def _obey(self, command: Command) -> int | None:
        """Obeys a command; returns the time to continue at, None for the present one."""
        if command.do in {Do.SEEK, Do.SKIP}:
            origin = self._score.start if command.do is Do.SEEK else self._at
            target = origin + int(command.seconds * 1e9)
            return self._go_to(min(max(target, self._score.begin), self._score.end))
        if command.do is Do.STEP:
            self._paused = self._stepping = True
        else:
            self._paused = command.do is Do.PAUSE or (command.do is Do.TOGGLE and not self._paused)
            self._start_again()
        self._go_to(self._at)
        return None

    def _go_to(self, moment: int) -> int:
        self._at = moment
        self._moved(moment, self._paused)
        return moment

    def _start_again(self) -> None:
        self._metronome.reset()
        self._shift = None

    def _stamped(self, timed: Timed) -> Envelope:
        """The message as published. Shifted stamps never decrease, even if the playback goes back."""
        if self._clock is None:
            return timed.envelope
        if self._shift is None:
            self._shift = max(self._clock(), self._newest + 1) - timed.time
        self._newest = max(self._newest, timed.time + self._shift)
        return shifted(timed.envelope, self._shift)
