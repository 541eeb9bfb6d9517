"""What a reader counted, for people: the same words wherever a log is read."""

from __future__ import annotations

from collections.abc import Mapping

_HINTS = {
    "absurd_stamp": "left out",
    "clock_set_back": "what follows goes on from there",
    "duplicate_stamp": "left out: each message needs a stamp of its own",
    "lidars_at_another_height": "a map shows one plane; take them with --lidar-topic",
    "lidars_off_the_base": (
        "left out: tf does not place them on the others' base. Of another robot? Take one with --lidar-topic "
        "and --odometry-topic. Of this one? eigenscan import --mount"
    ),
    "lidars_without_mount": (
        "none in the log: taken to be at the base's origin; give it with eigenscan import --mount"
    ),
    "no_metadata": "no metadata.yaml in the folder: read without it",
    "no_stamp": "left out",
    "not_finite": "left out",
    "out_of_order": "left out: stamped before earlier ones",
    "scans_of_another_frame": "on a lidar's topic: let each lidar have its own",
    "stamps_repaired": "by the order of the lines",
    "stray_stamps": "far from their neighbours': mended by the time of recording",
    "topics_of_the_same_lidar": "take them with --lidar-topic",
    "topics_stamped_by_recording": "no stamps in their headers, or of another clock than the rest",
    "truncated_file": "what could be read was taken",
    "undecodable_message": "left out",
}
"""What was done, or what helps, by the end of a counter's name."""


def remarks(counters: Mapping[str, int]) -> list[str]:
    """A line for each of a log's counters that is not 0."""
    found = []
    for what, count in sorted(counters.items()):
        hint = next((f" ({words})" for name, words in _HINTS.items() if what.endswith(name)), "")
        if count:
            found.append(f"{what.replace('_', ' ')}: {count}{hint}")
    return found
