"""Whether a lidar's ranges or angles are wrong, or the map's scale, or one is mirrored: as scans fit the map.

With each list of the whole map a projector states which errors would make the scan likelier, and by how much.
What scans of new places state adds up (CUSUM; Page, "Continuous inspection schemes", Biometrika 1954).
"""

from __future__ import annotations

from collections.abc import Mapping
from math import exp, isfinite, log
from typing import NamedTuple

from eigenscan.schemas.hypotheses_pb2 import RangeCheck
from eigenscan.tracker.lidars import Lidars

FOR, AGAINST = 6.0, 2.0
"""Nats of one scan at most: neighbouring scans err alike, and of some the list lacks the pose."""
FITS = 1.0
"""Nats against each error of a scan that fits as it is: it often does with an error, along a hallway say."""
BY_MAP = 1.0
"""Nats that an inexact map gives some error in each of its scans, for a whole room. A hall displaced by 25 cm
gives up to 4 here and there; an error of 0.3 m gives 5 to 12 (benchmarks/range_errors.py).
"""
FIRST, LEAST, MOST = log(1e-4), -30.0, 18.0
"""Ln odds of each error before the first scan; the least, for it may begin later: five scans then show it;
the most, for it may be mended. On maps with missing or displaced parts many scans in a row seem to have such
an error (benchmarks/range_errors.py prints how often it is named rightly and wrongly).
"""
TRIED = 32
"""Errors that are followed at most."""
LARGEST = 10.0
"""Factor, and m: with a larger error no scan would fit anywhere."""
RANGES = (
    "scans fit the map only with ranges {}: has the lidar another scale or an offset, "
    "or the map another resolution?"
)
MIRRORED = "scans fit the map only mirrored: is the map's image mirrored, or is the lidar upside down?"
ANGLES = "scans fit the map only with beams {:.2f} times as far apart: is the lidar's angle_increment right?"


class RangeError(NamedTuple):
    """Ranges are `factor` times the true ones, plus `offset`, m; beams are `apart` times as far apart.

    `mirrored`: the scan or the map is. `searched`: the whole map was, for which not each scan is.
    """

    factor: float = 1.0
    offset: float = 0.0
    apart: float = 1.0
    mirrored: bool = False
    searched: bool = False

    def __str__(self) -> str:
        """In words, for the person who can mend it. In small rooms scale and offset look alike."""
        if self.mirrored:
            return MIRRORED
        if self.apart != 1.0:
            return ANGLES.format(1.0 / self.apart)
        how = f"{1.0 / self.factor:.2f} times as long"
        if self.offset:
            how = f"{abs(self.offset):.1f} m {'shorter' if self.offset > 0.0 else 'longer'}"
        return RANGES.format(how)


def gains(checked: RangeCheck) -> dict[RangeError, float]:
    """What a projector's check states, without what is no number or no such error."""
    found = {
        RangeError(
            one.factor, one.offset, one.apart or 1.0, one.mirrored, one.searched or one.mirrored
        ): one.gain
        for one in checked.errors[:TRIED]
    }
    return {
        error: gain
        for error, gain in found.items()
        if 1.0 / LARGEST < error.factor < LARGEST
        and 1.0 / LARGEST < error.apart < LARGEST
        and abs(error.offset) < LARGEST
        and isfinite(gain)
    }


class _Lidar:
    """How probable each error of one lidar's ranges is."""

    def __init__(self) -> None:
        self.odds: dict[RangeError, float] = {}
        """Ln of the odds against scans that are right."""
        self.come = 1.0
        """How far the robot has come: 1 further on, a scan is new evidence."""
        self._judged: dict[RangeError, float] = {}
        """By error, how far it had come when the odds last changed."""

    def take(self, found: Mapping[RangeError, float]) -> None:
        found = {error: gain - BY_MAP for error, gain in found.items()}
        # an error that is not stated fits no better than the best one that is
        others = min(max((g for e, g in found.items() if not e.searched), default=-FITS), 0.0)
        for error in [*self.odds, *(each for each in found if each not in self.odds)][:TRIED]:
            if error.searched and found and error not in found:
                continue  # not tried
            gain = min(max(found.get(error, others), -AGAINST), FOR)
            new = min(self.come - self._judged.get(error, 0.0), 1.0)
            odds = self.odds.get(error, FIRST) + new * gain
            self.odds[error], self._judged[error] = min(max(odds, LEAST), MOST), self.come

    @property
    def trust(self) -> float:
        return 1.0 / (1.0 + sum(map(exp, self.odds.values())))


class RangeErrors:
    """How probable it is that ranges or angles of a robot's lidars are wrong."""

    def __init__(self) -> None:
        self._lidars = Lidars(_Lidar)

    def move(self, new: float) -> None:
        """The robot has come on: by 1, a scan is new evidence."""
        for lidar in self._lidars.all():
            lidar.come += new

    def see(self, lidar: str, stamp: int) -> None:
        """A scan of this stamp, ns, came from a lidar."""
        self._lidars.now = stamp
        self._lidars.see(lidar, stamp)

    def take(self, lidar: str, found: Mapping[RangeError, float]) -> None:
        """Takes by how many nats a lidar's scan is likelier with each error; none: it fits as it is."""
        self._lidars.of(lidar).take(found)

    @property
    def trust(self) -> float:
        """Probability that the ranges and angles of each lidar are right."""
        return min((each.trust for _, each in self._lidars.present()), default=1.0)

    @property
    def fault(self) -> str:
        """What is rather wrong, in words; empty: nothing that shows."""
        present = list(self._lidars.present())
        for name, lidar in present:
            if lidar.trust < 0.5:
                error = max(lidar.odds, key=lidar.odds.__getitem__)
                return str(error) if len(present) == 1 else f"{name}: {error}"
        return ""
