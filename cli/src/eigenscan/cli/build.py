"""`eigenscan build`: a map's models in a folder."""

from __future__ import annotations

import math
import os
import time
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from eigenscan.cli.figures import JsonFile, prepare, print_rows, write_figures
from eigenscan.runtime.errors import StoppedError, UsageError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from eigenscan.eigenspace.floors import Floor
    from eigenscan.eigenspace.pieces import Piece, Pieces
    from eigenscan.geometry.gridmap import GridMap
    from eigenscan.mapbuilder.cluster import Workers
    from eigenscan.mapbuilder.geojson import GivenRegion
    from eigenscan.mapbuilder.quality import Quality
    from eigenscan.mapbuilder.site import Layout, Plan, Progress
    from eigenscan.schemas.model_pb2 import ModelSet


def build(
    map_files: Annotated[
        list[Path],
        typer.Argument(
            metavar="MAP...",
            help="map_server yaml, floor plan (.dxf, .svg) or image; several: the floors of one site",
            show_default=False,
        ),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="folder to write the models to")],
    spacing: Annotated[float, typer.Option(min=0.05, max=5.0, help="m between positions")] = 0.5,
    error: Annotated[
        float,
        typer.Option(
            min=0.0,
            max=20.0,
            help="add positions where interpolation is off by more than this, m; 0 disables",
        ),
    ] = 0.0,
    step: Annotated[
        float, typer.Option(min=0.1, max=10.0, help="degrees between beams", rich_help_panel="Model")
    ] = 0.5,
    clearance: Annotated[
        float, typer.Option(min=0.0, max=5.0, help="m from a position to a wall", rich_help_panel="Model")
    ] = 0.15,
    margin: Annotated[
        float, typer.Option(min=0.0, max=10.0, help="m that regions overlap", rich_help_panel="Model")
    ] = 1.0,
    range_max: Annotated[
        float, typer.Option(min=1.0, max=130.0, help="m that a beam reaches", rich_help_panel="Model")
    ] = 80.0,
    fov: Annotated[
        float,
        typer.Option(
            min=1.0, max=360.0, help="degrees that the site's usual lidar sees", rich_help_panel="Model"
        ),
    ] = 180.0,
    embedding: Annotated[
        Literal["ring", "range"],
        typer.Option(
            help="what is analysed: points on a ring, or ranges as in the paper", rich_help_panel="Model"
        ),
    ] = "ring",
    range_cap: Annotated[
        float | None,
        typer.Option(
            min=1.0,
            max=130.0,
            help="m; longer ranges count as this; default by embedding",
            rich_help_panel="Model",
        ),
    ] = None,
    components: Annotated[
        int, typer.Option(min=1, max=64, help="principal components of a region", rich_help_panel="Model")
    ] = 16,
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
    frame_id: Annotated[str, typer.Option(help="name of the map frame", rich_help_panel="Model")] = "map",
    jobs: Annotated[int, typer.Option("--jobs", "-j", min=0, help="threads; 0: one a core")] = 0,
    workers: Annotated[
        int, typer.Option(min=0, help="processes of this machine that build instead, by dask")
    ] = 0,
    scheduler: Annotated[
        str, typer.Option(metavar="ADDRESS", help="dask scheduler whose workers build instead")
    ] = "",
    json_file: JsonFile = None,
) -> None:
    """Build the models of a map: regions, panoramas, eigenspaces, and a picture of them.

    In a floor plan lines are walls. What they enclose is free space, also where doorways up to 1.2 m wide are
    open. Regions are found, or read from GeoJSON: polygons in the map frame, in m, with the property "name".
    Several maps are the floors of one site; each floor is named by its file. Finished regions are kept in
    MODEL.pieces, so that the same command continues after an interruption. --workers and --scheduler are for
    large sites: pip install 'eigenscan[cluster]'.

    \b
    Examples:
      eigenscan build MAP.yaml -o MODEL
      eigenscan build MAP.yaml -o MODEL --spacing 0.25
      eigenscan build MAP.yaml -o MODEL --regions ROOMS.geojson
      eigenscan build plan.dxf -o MODEL --layer WALLS
      eigenscan build plan.svg -o MODEL --metres-per-unit 0.01
      eigenscan build ground.yaml first.yaml -o MODEL
      eigenscan build CAMPUS.yaml -o MODEL --scheduler tcp://10.0.0.5:8786
      eigenscan run MODEL
    """  # noqa: D301 - \b keeps the lines apart in --help
    if not frame_id:
        raise UsageError("--frame-id: give the map frame a name, such as map")
    from eigenscan.eigenspace.pieces import Pieces
    from eigenscan.geometry.plans import PlanOptions, read_plan
    from eigenscan.mapbuilder.cluster import Workers
    from eigenscan.mapbuilder.drawn import outlines
    from eigenscan.mapbuilder.floors import name_by_floor
    from eigenscan.mapbuilder.geojson import read_regions, to_geojson
    from eigenscan.mapbuilder.picture import draw_regions
    from eigenscan.mapbuilder.quality import IN_SIGHT_M, quality
    from eigenscan.mapbuilder.regions import Division
    from eigenscan.mapbuilder.site import Plan
    from eigenscan.workbench.progress import Bars

    plan = Plan(
        spacing=spacing,
        error=error,
        step=math.radians(step),
        clearance=clearance,
        range_max=range_max,
        embedding=embedding,
        range_cap=range_cap,
        field_of_view=math.radians(fov),
        components=components,
        frame_id=frame_id,
        division=Division(margin=margin),
        threads=jobs or len(os.sched_getaffinity(0)),
    )
    if workers and scheduler:
        raise UsageError("--workers and --scheduler: give one of them")
    engine = Workers(workers, scheduler) if workers or scheduler else None
    prepare(json_file)
    drawn = read_regions(regions) if regions else ()
    began = time.perf_counter()
    options = PlanOptions(metres_per_unit, layer or ())
    plans = [(path.stem, read_plan(path, options)) for path in map_files]
    grid, floors = _stacked(plans)
    with Pieces(out) as pieces, Bars(transient=True) as bars:
        moved = bars.start_steps()
        moved("regions", 0.0)
        layout = _lay_out(grid, plan, drawn, map_files, regions)
        if floors and not drawn:
            layout = name_by_floor(layout, floors)
        built = _build(grid, plan, layout, pieces, moved, engine)
        message = pieces.publish(
            built[0],
            grid,
            frame_id,
            draw_regions(grid, layout.areas),
            to_geojson(outlines(layout.regions, layout.names), frame_id),
            floors,
        )
    found = quality(grid, layout.positions.points, IN_SIGHT_M)
    _summarize(message, layout, found, built, out, time.perf_counter() - began, json_file)
    for path, (_, each) in zip(map_files, plans, strict=True):
        if each.is_lossy:
            typer.echo(
                f"{path}: its image is a JPEG, whose noise may make unknown ground free, or free ground "
                "unknown: save the original as PNG",
                err=True,
            )
    if found.strips:
        typer.echo(
            "most of the map is occupied, and its free ground is as narrow as walls: is negate in its yaml "
            "right, or the image black on white?",
            err=True,
        )


def _stacked(maps: Sequence[tuple[str, GridMap]]) -> tuple[GridMap, tuple[Floor, ...]]:
    from eigenscan.mapbuilder.floors import stack

    return stack(maps) if len(maps) > 1 else (maps[0][1], ())


def _lay_out(
    grid: GridMap, plan: Plan, drawn: Sequence[GivenRegion], map_files: Sequence[Path], regions: Path | None
) -> Layout:
    from eigenscan.eigenspace.model import ModelError
    from eigenscan.mapbuilder.geojson import RegionsError
    from eigenscan.mapbuilder.site import lay_out

    try:
        return lay_out(grid, plan, drawn)
    except RegionsError as error:
        raise UsageError(f"{regions}: {error}") from error
    except ModelError as error:
        raise UsageError(f"{', '.join(map(str, map_files))}: {error}") from error


def _build(
    grid: GridMap, plan: Plan, layout: Layout, pieces: Pieces, progress: Progress, workers: Workers | None
) -> tuple[Mapping[str, Piece], int]:
    """The finished regions."""
    from eigenscan.mapbuilder.sharded import build_pieces

    try:
        with workers or nullcontext():
            return build_pieces(grid, plan, layout, pieces, progress, workers)
    except KeyboardInterrupt:
        raise StoppedError(f"finished regions are in {pieces.place}; the same command goes on") from None


def _summarize(
    message: ModelSet,
    layout: Layout,
    found: Quality,
    built: tuple[Mapping[str, Piece], int],
    folder: Path,
    seconds: float,
    json_file: Path | None,
) -> None:
    from eigenscan.eigenspace.folder import PICTURE

    pieces, before = built
    explained = [piece.explained for piece in pieces.values()]
    spacing = layout.positions.spacing
    shared = sum(len(area.positions.index) for area in layout.areas)
    wire_bytes = sum(entry.size for entry in message.entries)
    figures = {
        "regions": len(pieces),
        "regions_finished_before": before,
        "floors": [floor.name for floor in message.floors],
        "free_area_m2": message.free_area_m2,
        "map_cell_m": found.cell_m,
        "wall_thickness_m": found.wall_thickness_m,
        "walls_thinned": found.thinned,
        "walls_in_sight": found.walls_in_sight,
        "usual_range_m": None if math.isnan(found.usual_range_m) else found.usual_range_m,
        "positions": layout.held,
        "spacing_m": spacing,
        "within_error": None if math.isnan(layout.within) else layout.within,
        "explained": explained,
        "wire_bytes": wire_bytes,
        "build_s": seconds,
        "version": message.version,
        "model": str(folder),
        "picture": str(folder / PICTURE),
    }
    apart = f"{spacing:g} m apart"
    if not math.isnan(layout.within):
        apart += " at the closest"
    rows = {
        "regions": str(len(pieces)) + (f", {before} of them finished before" if before else ""),
        **({"floors": ", ".join(floor.name for floor in message.floors)} if message.floors else {}),
        "free area": f"{message.free_area_m2:.0f} m²",
        "walls": f"{found.wall_thickness_m:.2f} m thick in cells of {found.cell_m:g} m"
        + (f": {found.expectation}" if found.expectation else ""),
        "in sight": f"{found.walls_in_sight:.0%} of the beams meet a wall, "
        f"{found.usual_range_m:.1f} m away in the median",
        "positions": f"{layout.held} ({shared} with the regions' overlap), {apart}",
        **(
            {}
            if math.isnan(layout.within)
            else {"bound held": f"at {layout.within:.1%} of the places between"}
        ),
        "eigenspaces": f"{min(explained):.0%} to {max(explained):.0%} of a region's variance",
        "on the wire": f"{wire_bytes / 1e6:.1f} MB",
        "built in": f"{seconds:.1f} s",
        "version": message.version[:12],
        "models": str(folder),
        "picture": str(folder / PICTURE),
    }
    print_rows(rows, json_file)
    write_figures(figures, json_file)
