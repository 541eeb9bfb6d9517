"""Figures 6 and 7 of the paper: hypotheses of one scan from nearest poses, and from volumes that enclose it.

In the paper's own space (three components of plain ranges) and at equal recall: as many nearest poses are
listed as it takes to hold the right one as often as the volumes do. The scan is the one whose two numbers of
false hypotheses are nearest to the medians.
"""

from pathlib import Path
from typing import Any

import numpy as np
from association import Asked, apart, candidates, hits, simulated, whole
from eigenscan.geometry.gridmap import OCCUPIED, GridMap
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.site import Site

SCANS, AREA = 150, 200.0
WRONG, RIGHT, TRUTH = "#c0392b", "#1e8449", "#1f4e9c"


def draw_6_7(path: Path) -> dict[str, Any]:
    """Draws both figures side by side; what they show, over all scans."""
    built, asked = simulated(SCANS, AREA)
    nearest, volumes = (
        [candidates(site, site.view(one.seen.sensor), one.seen, 10**6)[0] for one in asked]
        for site in (
            Site(
                whole(built),
                ProjectorSettings.model_validate(
                    {"association": kind, "embedding": "range", "components": 3}
                ),
            )
            for kind in ("sweep", "tetrahedra")
        )
    )
    recall = float(np.mean([hits(p, one.truth).any() for p, one in zip(volumes, asked, strict=True)]))
    needed = [int(np.argmax(hits(p, one.truth))) + 1 for p, one in zip(nearest, asked, strict=True)]
    listed = int(np.quantile(needed, recall, method="higher"))
    lists = {"nearest": [p[:listed] for p in nearest], "volumes": volumes}
    false = {
        name: np.array([_false(p, one) for p, one in zip(poses, asked, strict=True)])
        for name, poses in lists.items()
    }
    both = np.all([[hits(p, one.truth).any() for p, one in zip(poses, asked, strict=True)]
                   for poses in lists.values()], axis=0)  # fmt: skip
    ordinary = sum(np.abs(np.log((count + 1) / (np.median(count) + 1))) for count in false.values())
    chosen = int(np.argmin(np.where(both, ordinary, np.inf)))
    _draw(path, built.grid, asked[chosen], {name: poses[chosen] for name, poses in lists.items()})
    return {"recall": recall, "nearest_listed": listed} | {
        f"false_{name}": float(count.mean()) for name, count in false.items()
    }


def _false(poses: np.ndarray, one: Asked) -> int:
    return int(np.count_nonzero(~hits(apart(poses), one.truth)))


def _draw(path: Path, grid: GridMap, one: Asked, lists: dict[str, np.ndarray]) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(14, 6.4))
    titles = {"nearest": "Figure 6: the nearest poses", "volumes": "Figure 7: volumes that enclose the scan"}
    height, width = (size * grid.resolution for size in grid.cells.shape)
    for axis, (name, poses) in zip(axes, lists.items(), strict=True):
        shown = apart(poses)
        hit = hits(shown, one.truth)
        axis.imshow(
            np.where(grid.cells == OCCUPIED, 0.55, 1.0), cmap="gray", vmin=0, vmax=1, origin="lower",
            extent=(0, width, 0, height),
        )  # fmt: skip
        for part, colour in ((shown[~hit], WRONG), (shown[hit], RIGHT)):
            _arrows(axis, part, colour)
        axis.plot(*one.truth[:2], "o", color=TRUTH, markersize=17, fillstyle="none", markeredgewidth=2.5)
        axis.set_title(f"{titles[name]}\n{np.count_nonzero(~hit)} wrong hypotheses", fontsize=17)
        axis.set_axis_off()
    marks = ((RIGHT, ">", "right", "full"), (WRONG, ">", "wrong", "full"), (TRUTH, "o", "the robot", "none"))
    legend = [
        plt.Line2D([], [], color=color, marker=marker, ls="", markersize=12, label=label, fillstyle=style)
        for color, marker, label, style in marks
    ]
    figure.legend(handles=legend, loc="lower center", ncols=3, fontsize=14, frameon=False)
    figure.subplots_adjust(left=0.01, right=0.99, bottom=0.09, top=0.88, wspace=0.03)
    figure.savefig(path, dpi=90)
    plt.close(figure)


def _arrows(axis: Any, poses: np.ndarray, colour: str) -> None:
    x, y, heading = poses.T
    axis.quiver(
        x, y, np.cos(heading), np.sin(heading), color=colour, pivot="mid", units="xy", scale=1.6,
        width=0.09, headwidth=4, headlength=4, headaxislength=4, zorder=3,
    )  # fmt: skip
