"""Reliability diagram of all logs: how often a pose was right, over how sure the tracker claimed to be."""

import math
from itertools import product
from pathlib import Path
from typing import Any

from eigenscan.workbench.evaluation.metrics import Bin, calibration_error, pooled

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
"""Okabe and Ito's, distinguished by the colour-blind too; then again with the next mark."""
MARKS = "osD^"
LARGEST = 700.0
"""Area of the largest mark, points squared; areas go by the root of counts: most poses are in one bin."""


def draw_reliability(path: Path, found: dict[str, Any]) -> None:
    """Draws the calibration bins of the figures of `eigenscan evaluate`, by name of the log."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.lines import Line2D

    diagrams = {name: [Bin(**entry) for entry in figures["calibration"]] for name, figures in found.items()}
    every = pooled(list(diagrams.values()))
    most = max((entry.count for bins in diagrams.values() for entry in bins), default=1)
    figure, axis = plt.subplots(figsize=(8.4, 7.2))
    axis.fill_between([0, 1], [0, 1], 0, color="#c0392b", alpha=0.07, lw=0)
    axis.plot([0, 1], [0, 1], color="#777777", ls="--", lw=1.5, zorder=1)
    axis.plot([b.confidence for b in every], [b.right for b in every], color="black", lw=3.5, zorder=2)
    handles = [Line2D([], [], color="black", lw=3.5, label="all logs pooled")]
    for (name, bins), (mark, colour) in zip(diagrams.items(), product(MARKS, COLOURS), strict=False):
        sizes = [LARGEST * math.sqrt(b.count / most) for b in bins]
        published, right = [b.confidence for b in bins], [b.right for b in bins]
        axis.scatter(
            published,
            right,
            sizes,
            color=colour,
            marker=mark,
            alpha=0.75,
            edgecolor="white",
            lw=0.8,
            zorder=3,
        )
        label = f"{name}, {_error(bins)}"
        handles.append(Line2D([], [], color=colour, label=label, ls="", marker=mark, markersize=11))
    for x, y, words in ((0.15, 0.69, "right more often than stated"), (0.96, 0.05, "too sure of itself")):
        axis.text(x, y, words, fontsize=13, color="#777777", ha="left" if x < y else "right")
    axis.set_title(f"Is it right as often as it states?\n{_poses(every)}", fontsize=16)
    axis.set_xlabel("stated confidence", fontsize=15)
    axis.set_ylabel("share right, within 0.5 m and 10°", fontsize=15)
    axis.set(xlim=(-0.03, 1.03), ylim=(-0.03, 1.03), aspect="equal")
    for side in (axis.xaxis, axis.yaxis):
        side.set_major_formatter(matplotlib.ticker.PercentFormatter(1.0, symbol=" %"))
    axis.tick_params(labelsize=13)
    axis.legend(handles=handles, title="calibration error\n(larger mark: more poses)", fontsize=12,
                title_fontsize=12, loc="upper left", alignment="left", bbox_to_anchor=(1.01, 1.0),
                frameon=False)  # fmt: skip
    figure.savefig(path, dpi=90, bbox_inches="tight")
    plt.close(figure)


def _poses(bins: list[Bin]) -> str:
    total = sum(b.count for b in bins)
    sure = sum(b.count for b in bins if b.confidence >= 0.9)
    return f"{total:,} poses; {100 * sure / max(total, 1):.0f} % state 90 % or more"


def _error(bins: list[Bin]) -> str:
    error = calibration_error(bins)
    return "no poses" if error is None else f"{100 * error:.1f} %"
