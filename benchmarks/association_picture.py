"""Figures 6 and 7 of the paper: hypotheses of one scan from nearest poses, and from volumes that enclose it.

In the paper's own space (three components of plain ranges) and at equal recall: as many nearest poses are
listed as it takes to hold the right one as often as the volumes do. The scan drawn is the one whose two
numbers of false hypotheses are nearest to the medians.

    .venv/bin/python benchmarks/association_picture.py docs/images/figure_6_7.png [--json OUT]
"""

import argparse
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from association import Asked, apart, candidates, hits, simulated, whole
from eigenscan.eigenspace.folder import SiteModel
from eigenscan.geometry.gridmap import OCCUPIED, GridMap
from eigenscan.projector.association.kinds import Kind
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.site import Site

SCANS, AREAS, MARGINS = 200, (200.0, 470.0), (0.0, 0.25, 0.5)
WRONG, RIGHT, TRUTH = "#c0392b", "#1e8449", "#1f4e9c"


@dataclass(frozen=True)
class Compared:
    """The hypotheses of each scan: nearest poses, and volumes that hold the right one as often."""

    nearest: list[np.ndarray]
    volumes: list[np.ndarray]
    recall: float

    def false(self, asked: list[Asked]) -> tuple[np.ndarray, np.ndarray]:
        """False hypotheses of each scan, by both."""
        near, held = (
            np.array([_false(poses, one) for poses, one in zip(lists, asked, strict=True)])
            for lists in (self.nearest, self.volumes)
        )
        return near, held


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("picture", type=Path, help="draw to this file")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    rows = draw_6_7(options.picture)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))


def draw_6_7(path: Path) -> list[dict[str, Any]]:
    """Draws both figures side by side; what they show for other margins and areas too."""
    rows = []
    print("office m2 | margin | recall | poses listed | false: nearest poses | false: volumes")
    for area in AREAS:
        built, asked = simulated(SCANS, area)
        near = _lists(built, asked, "sweep", 0.0)
        for margin in MARGINS:
            both = _at_equal_recall(near, _lists(built, asked, "tetrahedra", margin), asked)
            counts = both.false(asked)
            rows.append({
                "area_m2": area, "margin": margin, "recall": both.recall, "listed": len(both.nearest[0]),
                "false_nearest": float(counts[0].mean()), "false_volumes": float(counts[1].mean()),
            })  # fmt: skip
            print(" | ".join(f"{value:.4g}" for value in rows[-1].values()), flush=True)
            if area == AREAS[0] and margin == MARGINS[-1]:
                _draw_ordinary(path, built.grid, asked, both, counts)
    return rows


def _lists(built: SiteModel, asked: list[Asked], kind: Kind, margin: float) -> list[np.ndarray]:
    chosen = {"association": kind, "margin": margin, "embedding": "range", "components": 3}
    site = Site(whole(built), ProjectorSettings.model_validate(chosen))
    return [candidates(site, site.view(one.seen.sensor), one.seen, 10**6)[0] for one in asked]


def _at_equal_recall(near: list[np.ndarray], volumes: list[np.ndarray], asked: list[Asked]) -> Compared:
    recall = float(np.mean([hits(p, one.truth).any() for p, one in zip(volumes, asked, strict=True)]))
    needed = [int(np.argmax(hits(p, one.truth))) + 1 for p, one in zip(near, asked, strict=True)]
    count = int(np.quantile(needed, recall, method="higher"))
    return Compared([poses[:count] for poses in near], volumes, recall)


def _draw_ordinary(
    path: Path, grid: GridMap, asked: list[Asked], both: Compared, counts: tuple[np.ndarray, np.ndarray]
) -> None:
    """The scan, found by both, whose numbers of false hypotheses are nearest to the medians."""
    off = sum(np.abs(np.log((count + 1) / (np.median(count) + 1))) for count in counts)
    for lists in (both.nearest, both.volumes):
        off[[not hits(p, one.truth).any() for p, one in zip(lists, asked, strict=True)]] = np.inf
    i = int(np.argmin(off))
    _draw(path, grid, asked[i], {"nearest": both.nearest[i], "volumes": both.volumes[i]})


def _false(poses: np.ndarray, one: Asked) -> int:
    return int(np.count_nonzero(~hits(apart(poses), one.truth)))


def _draw(path: Path, grid: GridMap, one: Asked, lists: dict[str, np.ndarray]) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.lines import Line2D

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
    legend = []
    for color, marker, label, style in marks:
        legend.append(Line2D([], [], color=color, marker=marker, ls="", markersize=12, label=label))
        legend[-1].set_fillstyle(style)  # type: ignore[arg-type]
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


if __name__ == "__main__":
    main()
