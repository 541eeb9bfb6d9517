"""`eigenscan build`: a map's models in a folder."""

from __future__ import annotations

import math
import os
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from eigenscan.cli.figures import JsonFile, prepare, say, write_figures
from eigenscan.cli.frame import UsageError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from eigenscan.eigenspace.folder import SiteModel
    from eigenscan.geometry.gridmap import GridMap
    from eigenscan.mapbuilder.geojson import GivenRegion
    from eigenscan.mapbuilder.site import Layout, Plan


def build(
    map_file: Annotated[
        Path,
        typer.Argument(
            metavar="MAP", help="map_server yaml, floor plan (.dxf, .svg) or image", show_default=False
        ),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="folder to write the models to")],
    spacing: Annotated[float, typer.Option(min=0.05, max=5.0, help="m between positions")] = 0.5,
    step: Annotated[float, typer.Option(min=0.1, max=10.0, help="degrees between beams")] = 0.5,
    clearance: Annotated[float, typer.Option(min=0.0, max=5.0, help="m from a position to a wall")] = 0.15,
    margin: Annotated[float, typer.Option(min=0.0, max=10.0, help="m that regions overlap")] = 1.0,
    range_max: Annotated[float, typer.Option(min=1.0, max=130.0, help="m that a beam reaches")] = 80.0,
    range_cap: Annotated[float, typer.Option(min=1.0, max=130.0, help="m that PCA clips ranges to")] = 20.0,
    fov: Annotated[float, typer.Option(min=1.0, max=360.0, help="degrees that the sensor sees")] = 180.0,
    share: Annotated[float, typer.Option(min=0.01, max=1.0, help="of the variance to hold")] = 0.9,
    regions: Annotated[
        Path | None, typer.Option(help="GeoJSON of the regions, such as an edited MODEL/regions.geojson")
    ] = None,
    metres_per_unit: Annotated[
        float | None, typer.Option(min=1e-6, help="m that a drawing's unit is, or an image's pixel")
    ] = None,
    layer: Annotated[
        list[str] | None,
        typer.Option(help="layer (DXF) or group (SVG) of walls; repeat for more; default: all"),
    ] = None,
    frame_id: Annotated[str, typer.Option(help="name of the map frame")] = "map",
    jobs: Annotated[int, typer.Option("--jobs", "-j", min=0, help="threads; 0: one a core")] = 0,
    json_file: JsonFile = None,
) -> None:
    """Build the models of a map: regions, panoramas, eigenspaces, and a picture of them.

    A floor plan's walls are its lines; what they enclose is free, doorways up to 1.2 m notwithstanding.
    Regions are found, or taken from GeoJSON: polygons in the map frame, m, property "name".

    \b
    Examples:
      eigenscan build MAP.yaml -o MODEL
      eigenscan build MAP.yaml -o MODEL --spacing 0.25
      eigenscan build MAP.yaml -o MODEL --regions ROOMS.geojson
      eigenscan build plan.dxf -o MODEL --layer WALLS
      eigenscan build plan.svg -o MODEL --metres-per-unit 0.01
      eigenscan run --map MODEL
    """  # noqa: D301 - \b keeps the lines apart in --help
    if not frame_id:
        raise UsageError("--frame-id: give the map frame a name, such as map")
    from eigenscan.cli.plans import PlanOptions, read_plan
    from eigenscan.eigenspace.folder import PICTURE, check_place, write_models
    from eigenscan.mapbuilder.drawn import outlines
    from eigenscan.mapbuilder.geojson import read_regions, to_geojson
    from eigenscan.mapbuilder.picture import draw_regions
    from eigenscan.mapbuilder.regions import Division
    from eigenscan.mapbuilder.site import Plan

    plan = Plan(
        spacing=spacing,
        step=math.radians(step),
        clearance=clearance,
        range_max=range_max,
        range_cap=range_cap,
        field_of_view=math.radians(fov),
        share=share,
        frame_id=frame_id,
        division=Division(margin=margin),
        threads=jobs or len(os.sched_getaffinity(0)),
    )
    check_place(out)
    prepare(json_file)
    drawn = read_regions(regions) if regions else ()
    began = time.perf_counter()
    grid = read_plan(map_file, PlanOptions(metres_per_unit, layer or ()))
    layout = _lay_out(grid, plan, drawn, map_file, regions)
    site = _build(grid, plan, layout, map_file)
    took = time.perf_counter() - began
    write_models(site, out, draw_regions(site), to_geojson(outlines(layout.regions, layout.names), frame_id))
    _summarize(site, out, out / PICTURE, took, json_file)


def _lay_out(
    grid: GridMap, plan: Plan, drawn: Sequence[GivenRegion], map_file: Path, regions: Path | None
) -> Layout:
    from eigenscan.eigenspace.model import ModelError
    from eigenscan.mapbuilder.geojson import RegionsError
    from eigenscan.mapbuilder.site import lay_out

    try:
        return lay_out(grid, plan, drawn)
    except RegionsError as error:
        raise UsageError(f"{regions}: {error}") from error
    except ModelError as error:
        raise UsageError(f"{map_file}: {error}") from error


def _build(grid: GridMap, plan: Plan, layout: Layout, map_file: Path) -> SiteModel:
    """The models, with a progress bar on a terminal."""
    from eigenscan.eigenspace.model import ModelError
    from eigenscan.mapbuilder.site import build_site
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True, disable=not sys.stderr.isatty()) as progress:
        bar = progress.add_task("reading", total=1.0)
        try:
            return build_site(
                grid,
                plan,
                lambda what, share: progress.update(bar, description=what, completed=share),
                layout,
            )
        except ModelError as error:
            raise UsageError(f"{map_file}: {error}") from error


def _summarize(site: SiteModel, folder: Path, picture: Path, seconds: float, json_file: Path | None) -> None:
    import numpy as np

    message = site.to_message()
    shared = np.concatenate([model.index for model in site.regions])
    spacing = site.regions[0].spacing
    components = [len(model.space.eigenvalues) for model in site.regions]
    figures = {
        "regions": len(site.regions),
        "free_area_m2": message.free_area_m2,
        "positions": len(np.unique(shared, axis=0)),
        "spacing_m": spacing,
        "components": components,
        "wire_bytes": sum(entry.size for entry in message.entries),
        "build_s": seconds,
        "version": message.version,
        "model": str(folder),
        "picture": str(picture),
    }
    rows = {
        "regions": str(len(site.regions)),
        "free area": f"{message.free_area_m2:.0f} m²",
        "positions": f"{figures['positions']}, {spacing:g} m apart ({len(shared)} with the regions' overlap)",
        "panoramas": f"{site.regions[0].ranges.shape[1]} beams each",
        "components": f"{min(components)} to {max(components)} a region",
        "on the wire": f"{sum(entry.size for entry in message.entries) / 1e6:.1f} MB",
        "built in": f"{seconds:.1f} s",
        "version": message.version[:12],
        "models": str(folder),
        "picture": str(picture),
    }
    say(rows, json_file)
    write_figures(figures, json_file)
