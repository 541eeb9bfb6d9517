"""Models on disk: a folder of plain files.

    manifest.json        the set: versions, frame, area, one entry a region
    map.yaml, map.pgm    the map, as map_server reads it
    regions/NAME.npz     one region; numpy.load opens it
    regions.png          what the regions are, for people
    regions.geojson      the same as polygons in the map frame, to be edited and built from

A folder appears whole or not at all: it is written beside its place and then swapped in; what it replaces is
kept (see `versions`).
"""

from __future__ import annotations

import json
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from eigenscan.eigenspace.components import Eigenspace
from eigenscan.eigenspace.model import ModelError, RegionModel, model_set, set_version
from eigenscan.eigenspace.panorama import Sensor
from eigenscan.eigenspace.versions import MANIFEST, replace
from eigenscan.geometry.gridmap import GridMap, MapError, read_map, write_map
from eigenscan.schemas import model_pb2

MAP, REGIONS, PICTURE = "map.yaml", "regions", "regions.png"
OUTLINES = "regions.geojson"
LAYOUT = 1
_PLAIN = ("region", "frame_id", "spacing", "origin", "index", "ranges", "range_cap", "range_unit", "outline")


@dataclass(frozen=True)
class SiteModel:
    """A map and the models of its regions; a set belongs together."""

    grid: GridMap
    frame_id: str
    regions: tuple[RegionModel, ...]

    def to_message(self) -> model_pb2.ModelSet:
        """The set as the contract says it."""
        return model_set(self.regions, self.grid.version, self.frame_id, self.grid.free_area)


def write_models(
    site: SiteModel, folder: Path, picture: bytes | None = None, outlines: str | None = None
) -> None:
    """Writes `folder`, in place of a model folder that is there; `picture` is a PNG, `outlines` GeoJSON.

    Raises ModelError where something else than a model folder is there or it cannot be written.
    """
    check_place(folder)
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        fresh = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
        try:
            _fill(site, fresh, picture, outlines)
            _take_place(fresh, folder)
        finally:
            shutil.rmtree(fresh, ignore_errors=True)
    except OSError as error:
        raise ModelError(f"{folder}: cannot be written: {error.strerror}: check the place") from error


def check_place(folder: Path) -> None:
    """Raises ModelError where `folder` is something that models must not replace."""
    holds_models = (folder / MANIFEST).is_file()
    if folder.exists() and not holds_models and not (folder.is_dir() and not any(folder.iterdir())):
        raise ModelError(f"{folder}: is there and holds no models: name a new folder")


def _fill(site: SiteModel, folder: Path, picture: bytes | None, outlines: str | None) -> None:
    folder.chmod(0o755)
    write_map(site.grid, folder / MAP)
    (folder / REGIONS).mkdir()
    for model in site.regions:
        np.savez_compressed(folder / REGIONS / f"{model.region}.npz", allow_pickle=False, **_arrays(model))
    if picture is not None:
        (folder / PICTURE).write_bytes(picture)
    if outlines is not None:
        (folder / OUTLINES).write_text(outlines, encoding="utf-8")
    text = json.dumps(_manifest(site), indent=1)
    (folder / MANIFEST).write_text(text + "\n", encoding="utf-8")


def _take_place(fresh: Path, folder: Path) -> None:
    if (folder / MANIFEST).is_file():
        replace(folder, fresh)
    else:
        fresh.rename(folder)


def _manifest(site: SiteModel) -> dict[str, Any]:
    message = site.to_message()
    return {
        "layout": LAYOUT,
        "version": message.version,
        "frame_id": site.frame_id,
        "map_version": message.map_version,
        "free_area_m2": message.free_area_m2,
        "regions": [
            {"region": entry.region, "version": entry.version, "wire_bytes": entry.size}
            for entry in message.entries
        ],
    }


def _arrays(model: RegionModel) -> dict[str, Any]:
    arrays: dict[str, Any] = {name: getattr(model, name) for name in _PLAIN}
    sensor, space = model.sensor, model.space
    arrays["sensor"] = np.array([sensor.angle_min, sensor.angle_increment, sensor.beams, sensor.range_max])
    arrays["mean"], arrays["total_variance"] = space.mean, space.total_variance
    arrays["eigenvectors"], arrays["eigenvalues"] = space.vectors, space.eigenvalues
    return arrays


def read_models(folder: Path) -> SiteModel:
    """Models of a folder that write_models made.

    Raises ModelError naming the file where it is missing, of another layout, or does not have the
    version that the manifest says.
    """
    manifest = _read_manifest(folder / MANIFEST)
    try:
        grid = read_map(folder / MAP)
    except MapError as error:
        raise ModelError(str(error)) from error
    entries = manifest["regions"]
    regions = tuple(_read_region(folder / REGIONS / f"{e['region']}.npz", e["version"]) for e in entries)
    if set_version(grid.version, [model.version for model in regions]) != manifest["version"]:
        raise ModelError(f"{folder / MAP}: is not the map that the models were built from: build again")
    return SiteModel(grid, manifest["frame_id"], regions)


def _read_manifest(path: Path) -> dict[str, Any]:
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
        if manifest["layout"] != LAYOUT:
            raise ModelError(
                f"{path}: layout {manifest['layout']}, this build reads {LAYOUT}: build it again"
            )
        if not (manifest["version"] and manifest["frame_id"] and manifest["regions"]):
            raise ModelError(f"{path}: names no regions")
        for entry in manifest["regions"]:
            if Path(entry["region"]).name != entry["region"] or not entry["version"]:
                raise ModelError(f"{path}: {entry['region']!r} cannot be a region's name")
    except OSError as error:
        raise ModelError(f"{path}: cannot be read: {error.strerror}: is this a model folder?") from error
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise ModelError(f"{path}: is not JSON: {error}") from error
    except (KeyError, TypeError) as error:
        raise ModelError(f"{path}: is no manifest of models: lacks {error}") from error
    result: dict[str, Any] = manifest
    return result


def _read_region(path: Path, version: str) -> RegionModel:
    try:
        with path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            model = _from_arrays(file)
    except OSError as error:
        raise ModelError(f"{path}: cannot be read: {error.strerror or error}") from error
    except (BadZipFile, KeyError, ValueError, TypeError, EOFError) as error:
        raise ModelError(f"{path}: is no region of a model: {error}") from error
    if model.version != version:
        raise ModelError(f"{path}: content is not the version {version[:12]} of the manifest: build again")
    return model


def _from_arrays(file: Any) -> RegionModel:
    angle_min, step, beams, range_max = file["sensor"].tolist()
    return RegionModel(
        region=str(file["region"]),
        frame_id=str(file["frame_id"]),
        spacing=float(file["spacing"]),
        origin=file["origin"],
        index=file["index"],
        ranges=file["ranges"],
        sensor=Sensor(angle_min, step, int(beams), range_max),
        range_cap=float(file["range_cap"]),
        space=Eigenspace(
            float(file["mean"]), file["eigenvectors"], file["eigenvalues"], float(file["total_variance"])
        ),
        outline=file["outline"],
        range_unit=float(file["range_unit"]),
    )
