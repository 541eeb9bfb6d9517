"""A night of equal messages: the comparison holds none of them."""

import tracemalloc

from eigenscan.schemas.channels import POSE
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.tracking_pb2 import PoseEstimate
from eigenscan.workbench.replay.comparison import Comparison, Terms
from eigenscan.workbench.replay.playing import Event, Side

START, PERIOD_NS = 1_700_000_000_000_000_000, 25_000_000


def compared(recorded: list[int], replayed: list[int]) -> Comparison:
    """Of the poses with these numbers, each with a stamp of its own."""
    comparison = Comparison([POSE], {"s/robot/r/pose": (0, 2 * START)}, Terms())
    for pair in zip(recorded, replayed, strict=True):
        for side, number in zip((Side.RECORDED, Side.REPLAYED), pair, strict=True):
            message = PoseEstimate(timestamp=stamp(START + number * PERIOD_NS))
            comparison.take(Event(side, number, Envelope(POSE, {"site": "s", "robot": "r"}, message)))
    return comparison


def test_equal_messages_take_no_memory() -> None:
    compared([0], [0])
    tracemalloc.start()
    comparison = compared([*range(5000)], [*range(5000)])
    held = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert comparison.counts[POSE].same == 5000
    assert held < 50_000


def test_another_order_is_found_where_it_begins_however_late() -> None:
    numbers = [*range(3000)]
    comparison = compared(numbers, [*numbers[:2000], 2001, 2000, *numbers[2002:]])
    comparison.finish()
    assert comparison.first is not None
    (field,) = comparison.first.fields
    assert (field.path, field.recorded) == ("(order)[2000]", START + 2000 * PERIOD_NS)
    assert comparison.counts[POSE].different == 1
