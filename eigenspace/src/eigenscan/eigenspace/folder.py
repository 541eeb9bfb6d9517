"""Models on disk: a folder of plain files.

    manifest.json        the set: versions, frame, area, one entry a region
    map.yaml, map.pgm    the map, as map_server reads it
    regions/NAME.npz     one region; numpy.load opens it
    regions.png          what the regions are, for people
    regions.geojson      the same as polygons in the map frame, to be edited and built from

A folder appears whole or not at all: it is written beside its place and then swapped in; what it replaces is
kept (see `versions`). Any number of processes may write and read it at the same time.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from eigenscan.eigenspace.floors import Floor
from eigenscan.eigenspace.model import ModelError, RegionModel, set_of, set_version
from eigenscan.eigenspace.region_file import pack_region, read_region
from eigenscan.eigenspace.versions import MANIFEST, alone, place_of, put
from eigenscan.geometry.gridmap import GridMap, MapError, read_map, write_map
from eigenscan.schemas import model_pb2
from eigenscan.schemas.methods import of_service

MAP, REGIONS, PICTURE = "map.yaml", "regions", "regions.png"
OUTLINES = "regions.geojson"
LAYOUT = 2
MOST_READS = 20
"""Of a folder that is replaced during each of them. A build takes seconds; nobody builds so often."""


@dataclass(frozen=True)
class SiteModel:
    """A map and the models of its regions; a set belongs together. `floors`: none if it is one map."""

    grid: GridMap
    frame_id: str
    regions: tuple[RegionModel, ...]
    floors: tuple[Floor, ...] = ()

    def to_message(self) -> model_pb2.ModelSet:
        """The set as a message of the contract."""
        return set_of(
            [model.entry for model in self.regions],
            self.grid.version,
            self.frame_id,
            self.grid.free_area,
            [floor.to_message() for floor in self.floors],
        )

    def check_method(self, method: str) -> None:
        """Raises ModelError if a method needs other eigenspaces than these models have."""
        wanted, made = of_service(method, "mapbuilder"), self.regions[0].space.analysis
        held = {"embedding": made.embedding.kind, "components": made.components}
        if any(wanted.get(name, value) != value for name, value in held.items()):
            options = " ".join(f"--{name} {wanted[name]}" for name in held)
            raise ModelError(
                f"method {method}: the models hold {made.components} components of {made.embedding.kind}: "
                f"give the map, or build them with {options}"
            )


def write_models(
    site: SiteModel,
    folder: Path,
    picture: bytes | None = None,
    outlines: str | None = None,
    others: Mapping[str, bytes] | None = None,
) -> None:
    """Writes `folder`; replaces an existing model folder.

    `picture` is a PNG, `outlines` GeoJSON, `others` further files by name.
    Raises ModelError if something else exists there, or if it cannot be written.
    """
    contents = {model.region: pack_region(model) for model in site.regions}

    def put_regions(regions: Path) -> None:
        for name, content in contents.items():
            (regions / f"{name}.npz").write_bytes(content)

    publish(folder, site.grid, site.to_message(), put_regions, picture, outlines, others)


def publish(
    folder: Path,
    grid: GridMap,
    message: model_pb2.ModelSet,
    put_regions: Callable[[Path], None],
    picture: bytes | None,
    outlines: str | None,
    others: Mapping[str, bytes] | None = None,
) -> None:
    """Writes `folder` as write_models does.

    `put_regions` puts the set's region files into the folder that it is given.
    Raises ModelError as write_models does.
    """
    check_place(folder)
    folder = place_of(folder)
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        fresh = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
        try:
            fresh.chmod(0o755)
            write_map(grid, fresh / MAP)
            (fresh / REGIONS).mkdir()
            put_regions(fresh / REGIONS)
            if picture is not None:
                (fresh / PICTURE).write_bytes(picture)
            if outlines is not None:
                (fresh / OUTLINES).write_text(outlines, encoding="utf-8")
            (fresh / MANIFEST).write_text(json.dumps(_manifest(message), indent=1) + "\n", encoding="utf-8")
            for name, content in (others or {}).items():
                (fresh / name).write_bytes(content)
            _take_place(fresh, folder)
        finally:
            shutil.rmtree(fresh, ignore_errors=True)
    except OSError as error:
        raise ModelError(f"{folder}: cannot be written: {error.strerror}: check the place") from error


def check_place(folder: Path) -> None:
    """Raises ModelError if `folder` is anything but a model folder or a free place."""
    holds_models = (folder / MANIFEST).is_file()
    if folder.exists() and not holds_models and not (folder.is_dir() and not any(folder.iterdir())):
        raise ModelError(f"{folder}: is there and holds no models: name a new folder")


def _take_place(fresh: Path, folder: Path) -> None:
    with alone(folder):
        if (folder / MANIFEST).is_file():
            put(folder, fresh)
        else:
            fresh.rename(folder)


def _manifest(message: model_pb2.ModelSet) -> dict[str, Any]:
    return {
        "layout": LAYOUT,
        "version": message.version,
        "frame_id": message.frame_id,
        "map_version": message.map_version,
        "free_area_m2": message.free_area_m2,
        "floors": [Floor.from_message(floor).to_json() for floor in message.floors],
        "regions": [
            {"region": entry.region, "version": entry.version, "wire_bytes": entry.size}
            for entry in message.entries
        ],
    }


def read_models(folder: Path) -> SiteModel:
    """Reads the models in a folder that write_models wrote; again if it was replaced meanwhile.

    Raises ModelError that names a file if it is missing, has another layout, or another version than the
    manifest states.
    """
    for _ in range(MOST_READS):
        before = _state(folder)
        try:
            return _read_once(folder)
        except ModelError:
            if _state(folder) == before:
                raise
    return _read_once(folder)


def floor_names(folder: Path) -> tuple[str, ...]:
    """Names of the floors that a folder holds models of; none if it is one map, or no model folder."""
    try:
        return tuple(str(published["name"]) for published in _read_manifest(folder / MANIFEST)["floors"])
    except (ModelError, KeyError, TypeError):
        return ()


def _state(folder: Path) -> tuple[int, int] | None:
    """A value that changes when the folder is replaced; None if there is no folder."""
    try:
        found = folder.stat()
    except OSError:
        return None
    return found.st_ino, found.st_ctime_ns


def _read_once(folder: Path) -> SiteModel:
    manifest = _read_manifest(folder / MANIFEST)
    try:
        grid = read_map(folder / MAP)
    except MapError as error:
        raise ModelError(str(error)) from error
    entries = manifest["regions"]
    regions = tuple(read_region(folder / REGIONS / f"{e['region']}.npz", e["version"]) for e in entries)
    if set_version(grid.version, [model.version for model in regions]) != manifest["version"]:
        raise ModelError(f"{folder / MAP}: is not the map that the models were built from: build again")
    try:
        floors = tuple(Floor.from_json(published) for published in manifest.get("floors", []))
    except (KeyError, TypeError, ValueError) as error:
        raise ModelError(f"{folder / MANIFEST}: floors: {error}: build again") from error
    return SiteModel(grid, manifest["frame_id"], regions, floors)


def _read_manifest(path: Path) -> dict[str, Any]:
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
        if manifest["layout"] != LAYOUT:
            raise ModelError(
                f"{path}: layout {manifest['layout']}, this version reads {LAYOUT}: build the models again, "
                "eigenscan build MAP -o MODEL"
            )
        if not (manifest["version"] and manifest["frame_id"] and manifest["regions"]):
            raise ModelError(f"{path}: names no regions")
        for entry in manifest["regions"]:
            if Path(entry["region"]).name != entry["region"] or not entry["version"]:
                raise ModelError(f"{path}: {entry['region']!r} cannot be a region's name")
    except OSError as error:
        raise ModelError(f"{path}: cannot be read: {error.strerror}: is this a model folder?") from error
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
        raise ModelError(f"{path}: is not JSON: {error}") from error
    except (KeyError, TypeError) as error:
        raise ModelError(f"{path}: is no manifest of models: lacks {error}") from error
    result: dict[str, Any] = manifest
    return result
