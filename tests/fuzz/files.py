"""Readers of files and of single payloads."""

from __future__ import annotations

import bz2
import contextlib
import gzip
import io
import json
import math
import os
import struct
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
from eigenscan.eigenspace.folder import SiteModel, read_models, write_models
from eigenscan.eigenspace.model import ModelError, RegionModel
from eigenscan.eigenspace.space_file import read_spaces, write_spaces
from eigenscan.eigenspace.space_message import space_from_message, space_to_message
from eigenscan.eigenspace.versions import versions
from eigenscan.fleet import layout
from eigenscan.geometry.gridmap import from_message as grid_from_message
from eigenscan.geometry.gridmap import read_image, read_map, write_map
from eigenscan.geometry.gridmap import to_message as grid_to_message
from eigenscan.geometry.plans import PlanOptions, read_plan
from eigenscan.ingest.options import ScanIngestOptions
from eigenscan.mapbuilder.geojson import read_regions
from eigenscan.mapbuilder.keeping.evidence import Evidence
from eigenscan.mapbuilder.keeping.store import Store
from eigenscan.mapbuilder.options import MapbuilderOptions
from eigenscan.projector.model_set_assembler import ModelSetAssembler
from eigenscan.projector.options import ProjectorOptions
from eigenscan.recorder.files import Files
from eigenscan.recorder.options import RecorderOptions
from eigenscan.recorder.uploads import Uploads
from eigenscan.ros_bridge import cdr
from eigenscan.ros_bridge.cloud import Slice
from eigenscan.ros_bridge.gyroscope import HeadingSum
from eigenscan.ros_bridge.inbound import grid_map, odometry, odometry_of_tf, raw_scan, relocation
from eigenscan.ros_bridge.options import RosBridgeOptions
from eigenscan.ros_bridge.parameters import LiveSettings, Parameters
from eigenscan.ros_bridge.service_types import SERVICES
from eigenscan.runtime.inbox import Arrival
from eigenscan.runtime.latched_cache import LatchedCache
from eigenscan.runtime.recording import RecordingWriter, contents, is_complete, read, read_metadata
from eigenscan.runtime.repair import is_sound, repair
from eigenscan.runtime.settings import Given, ServiceSettings, read_table, typed, validated
from eigenscan.schemas import model_pb2
from eigenscan.schemas.channels import MODEL
from eigenscan.schemas.recordings_pb2 import RecordingRequest
from eigenscan.schemas.wire import encode, encoding
from eigenscan.tracker.core import TrackerCore
from eigenscan.tracker.last_pose import Remembering
from eigenscan.tracker.options import TrackerOptions
from eigenscan.tracker.settings import TrackerSettings
from eigenscan.workbench.evaluation.reference import read_trajectory
from eigenscan.workbench.evaluation.windows import read_times, read_windows
from eigenscan.workbench.logs import open_log
from eigenscan.workbench.replay.casting import cast
from eigenscan.workbench.replay.services import CHOICES, PIPELINE
from eigenscan.workbench.replay.survey import survey
from foxglove_schemas_protobuf.Grid_pb2 import Grid
from google.protobuf.message import DecodeError, Message
from rosbags.rosbag2 import StoragePlugin

from tests.fuzz.mutation import damaged, forged
from tests.fuzz.reader import Opened, Reader
from tests.services.projector.office import envelopes, office
from tests.services.recorder.traffic import Site
from tests.services.ros_bridge.test_cloud import cloud as ros_cloud
from tests.services.ros_bridge.test_core import odometry as ros_odometry
from tests.services.ros_bridge.test_core import scan as ros_scan
from tests.services.ros_bridge.test_core import transform as ros_transform
from tests.services.ros_bridge.test_gyroscope import imu
from tests.workbench.logs.test_ros import usual

Bytes = Mapping[str, bytes]


Attacks = Callable[[], Bytes]


def _opened(read: Callable[[bytes], object], seeds: Bytes, attacks: Attacks = dict) -> Opened:
    others = list(seeds.values())
    return Opened(read, seeds, lambda random, name: damaged(random, seeds[name], others), attacks)


def _file(
    name: str,
    suffix: str,
    read: Callable[[Path], object],
    make: Callable[[Path], tuple[Bytes, Attacks]],
    weight: float = 1.0,
) -> Reader:
    """A reader of a file that ends in `suffix`; `make` gives its seeds and attacks, from an empty folder."""

    def open_(folder: Path) -> Opened:
        (folder / "made").mkdir()
        seeds, attacks = make(folder / "made")
        path = folder / f"input{suffix}"

        def take(data: bytes) -> None:
            path.unlink(missing_ok=True)
            path.write_bytes(data)
            read(path)

        return _opened(take, seeds, attacks)

    return Reader(name, open_, weight)


def _all(items: Iterable[object]) -> None:
    for _ in items:
        pass


# ---- maps, drawings, regions


def _small_map(folder: Path) -> Path:
    write_map(office(), folder / "map.yaml")
    return folder / "map.yaml"


def _map_yaml(folder: Path) -> tuple[Bytes, Attacks]:
    text = _small_map(folder).read_bytes()
    (folder.parent / "map.pgm").write_bytes((folder / "map.pgm").read_bytes())
    (folder.parent / "loop.pgm").symlink_to("loop.pgm")
    os.mkfifo(folder.parent / "pipe.pgm")
    image = b"image: map.pgm\nresolution: 0.05\norigin: [0, 0, 0]\n"
    seeds = {
        "saved": text,
        "scale": image + b"mode: scale\noccupied_thresh: 0.65\nfree_thresh: 0.196\nnegate: 0\n",
    }
    return seeds, lambda: {
        "nested": b"[" * 9_000,
        "nested maps": b"{a: " * 1_500,
        "nested by indent": b"".join(b"\n" + b" " * k + b"a:" for k in range(400)),
        "aliases": b"a: &a [x]\nb: &b [*a, *a]\n" + image,
        "huge integer": b"image: map.pgm\norigin: [0, 0, 0]\nresolution: " + b"9" * 90_000,
        "huge origin": b"image: map.pgm\nresolution: 0.05\norigin: [" + b"9" * 400 + b", 0, 0]",
        "no date": b"image: map.pgm\nresolution: 2020-99-99\norigin: [0, 0, 0]",
        "binary": b"image: !!binary aGFsbG8=\nresolution: !!float 5\norigin: [0, 0, 0]",
        "sexagesimal": b"image: map.pgm\nresolution: 1:2:3:4:5.5\norigin: [0, 0, 0]",
        "merge": b"<<: [{image: map.pgm}]\nresolution: 0.05\norigin: [0, 0, 0]",
        "unhashable": b"{[a]: b}",
        "a pipe": image.replace(b"map.pgm", b"pipe.pgm"),
        "a loop": image.replace(b"map.pgm", b"loop.pgm"),
        "a device": image.replace(b"map.pgm", b"/dev/zero"),
        "a folder": image.replace(b"map.pgm", b"."),
        "a null": image.replace(b"map.pgm", b'"a\\0b"'),
        "a long name": image.replace(b"map.pgm", b"x" * 5000),
        "a mode": image + b"mode: [a]\n",
        "negate": image + b"negate: [[]]\n",
        "thresholds": image + b"free_thresh: .nan\noccupied_thresh: .inf\n",
    }


def _png(width: int, height: int, depth: int, colour: int, rows: bytes, more: bytes = b"") -> bytes:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + head + more + chunk(b"IDAT", zlib.compress(rows, 9)) + chunk(b"IEND", b"")


def _image(folder: Path) -> tuple[Bytes, Attacks]:
    from PIL import Image

    _small_map(folder)
    seeds = {}
    with Image.open(folder / "map.pgm") as image:
        small = image.resize((60, 40))
        for kind in ("PPM", "PNG", "BMP", "JPEG", "TIFF", "GIF"):
            target = io.BytesIO()
            small.save(target, kind)
            seeds[kind] = target.getvalue()
        clear = io.BytesIO()
        small.convert("RGBA").save(clear, "PNG")
        seeds["RGBA"] = clear.getvalue()
    side = 19_000
    return seeds, lambda: {
        "bomb of one bit": _png(side, side, 1, 0, bytes((side + 7) // 8 + 1) * side),
        "bomb of a byte": _png(6000, 6000, 8, 0, bytes(6001) * 6000),
        "bomb of colours": _png(2500, 2500, 8, 6, bytes(10_001) * 2500),
        "header alone": _png(2**31 - 1, 2**31 - 1, 8, 0, b""),
        "text bomb": _png(
            4,
            4,
            8,
            0,
            bytes(20),
            b"" + struct.pack(">I", 0) + b"tEXt" + struct.pack(">I", zlib.crc32(b"tEXt")),
        ),
        "pgm of 10^18": b"P5\n1000000000 1000000000\n255\n",
        "pgm of 20000": b"P5\n19999 19999\n255\n" + bytes(1000),
        "ppm of 9000": b"P6\n9000 9000\n255\n" + bytes(1000),
        "plain pgm": b"P2\n19999 19999\n255\n" + b"0 " * 1000,
        "eps": b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 10 10\n(%pipe%id) (r) file\n",
        "svg": b"<svg/>",
    }


_SVG = (
    b'<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" '
    b'width="1000" height="800">%s</svg>'
)
_HOUSE = (
    b'<g id="walls"><rect x="0" y="0" width="1000" height="800" fill="none" stroke="black"/>'
    b'<path d="M 500 0 L 500 300 A 50 50 0 0 1 600 350 C 1 2 3 4 500 800 Z" stroke="black" fill="none"/>'
    b'<circle cx="200" cy="200" r="30" fill="black" transform="rotate(30)"/></g>'
    b'<use href="#walls" x="20"/>'
)


def _svg(_folder: Path) -> tuple[Bytes, Attacks]:
    deep = b"".join(b'<g id="g%d">%s</g>' % (k, b'<use href="#g%d"/>' % (k - 1) * 10) for k in range(1, 12))
    entity = b"".join(b'<!ENTITY a%d "%s">' % (k, b"&a%d;" % (k - 1) * 10) for k in range(1, 10))
    return {"house": _SVG % _HOUSE}, lambda: {
        "uses": _SVG % (b'<g id="g0"><rect width="9" height="9" stroke="black"/></g>' + deep),
        "uses itself": _SVG % b'<g id="a"><use href="#a"/></g>',
        "entities": b'<!DOCTYPE svg [<!ENTITY a0 "lol">' + entity + b"]>" + _SVG % b"<text>&a9;</text>",
        "a file": b'<!DOCTYPE svg [<!ENTITY x SYSTEM "file:///etc/passwd">]>' + _SVG % b"<text>&x;</text>",
        "nested": _SVG % (b"<g>" * 20_000 + b"</g>" * 20_000),
        "nested far": _SVG % (b"<g>" * 30_000 + b"</g>" * 30_000),
        "an image": _SVG % b'<image href="/dev/zero" width="5" height="5"/>',
        "far": _SVG % b'<path d="M 0 0 L 1e308 1e308 L nan 0 Z" stroke="black"/>',
        "a long curve": _SVG % (b'<path stroke="black" d="M 0 0 ' + b"C 1 2 3 4 5 6 " * 20_000 + b'"/>'),
        "wide curves": _SVG % (b'<path stroke="black" d="M 0 0 ' + b"C 1e6 2 3 1e6 5 6e6 " * 2000 + b'"/>'),
        "arcs": _SVG % (b'<path stroke="black" d="M 0 0 ' + b"A 1e5 9e5 0 0 1 6e4 3 " * 3000 + b'"/>'),
        "shapes": _SVG % (b'<rect x="1" y="2" width="3" height="4" stroke="black"/>' * 2_000),
        "styles": _SVG % (b"<style>" + b"g{a:b}" * 20_000 + b"</style>" + b"<g/>" * 10),
        "transforms": _SVG
        % (b'<g transform="' + b"scale(1e9) " * 40_000 + b'"><rect width="1" height="1"/></g>'),
        "view box": b'<svg viewBox="0 0 0 0" width="1e400" height="nan"><rect width="1" height="1"/></svg>',
    }


def _dxf(folder: Path) -> tuple[Bytes, Attacks]:
    from ezdxf.filemanagement import new

    def text(of: Any) -> bytes:
        of.saveas(folder / "drawing.dxf")
        return (folder / "drawing.dxf").read_bytes()

    house = new("R2000", setup=False)
    house.units = 6
    house.header["$INSUNITS"] = 6
    space = house.modelspace()
    space.add_lwpolyline([(0, 0), (10, 0), (10, 8), (0, 8)], close=True)
    space.add_line((5, 0), (5, 3))
    space.add_circle((2, 2), 0.5)
    space.add_arc((7, 5), 1.0, 0, 90)
    space.add_ellipse((7, 3), (1, 0), 0.5)
    space.add_spline([(1, 5), (2, 6), (3, 5)])
    block = house.blocks.new("table")
    block.add_lwpolyline([(0, 0), (1, 0), (1, 1)], close=True)
    space.add_blockref("table", (3, 3))
    whole = text(house)
    old = new("R12")
    for a, b in (((0, 0), (9, 0)), ((9, 0), (9, 7)), ((9, 7), (0, 7)), ((0, 7), (0, 0))):
        old.modelspace().add_line(a, b)
    plain = text(old)

    nested = new("R2000")
    nested.blocks.new("b0").add_line((0, 0), (1, 1))
    for k in range(1, 9):
        own = nested.blocks.new(f"b{k}")
        for _ in range(10):
            own.add_blockref(f"b{k - 1}", (0, 0))
    nested.modelspace().add_blockref("b8", (0, 0))
    rows = new("R2000")
    rows.blocks.new("b").add_line((0, 0), (1, 1))
    rows.modelspace().add_blockref("b", (0, 0)).dxf.row_count = 30_000
    rows.modelspace()[0].dxf.column_count = 30_000
    wide = new("R2000")
    wide.header["$INSUNITS"] = 6
    wide.modelspace().add_circle((0, 0), 1e9)
    many = new("R2000")
    many.header["$INSUNITS"] = 6
    for _ in range(60):
        many.modelspace().add_circle((0, 0), 4e3)
        many.modelspace().add_ellipse((0, 0), (5e3, 0), 0.001)
    spline = new("R2000")
    spline.header["$INSUNITS"] = 6
    spline.modelspace().add_open_spline([(k, (-1) ** k * 1e5) for k in range(2000)])
    far = new("R2000")
    far.header["$INSUNITS"] = 6
    far.modelspace().add_line((0, 0), (1e308, 1e308))
    return {"house": whole, "old": plain}, lambda: {
        "nested blocks": text(nested),
        "rows of a block": text(rows),
        "a wide circle": text(wide),
        "many wide circles": text(many),
        "a wild spline": text(spline),
        "far": text(far),
        "binary": b"AutoCAD Binary DXF\r\n\x1a\x00" + bytes(1000),
        "lines without end": b"0\nSECTION\n2\nENTITIES\n"
        + b"0\nLINE\n8\n0\n10\n0\n20\n0\n11\n1\n21\n1\n" * 20_000,
    }


def _geojson(_folder: Path) -> tuple[Bytes, Attacks]:
    ring = [[0, 0], [1, 0], [1, 1], [0, 0]]
    feature = {
        "type": "Feature",
        "properties": {"name": "hall"},
        "geometry": {"type": "Polygon", "coordinates": [ring]},
    }
    whole = {
        "type": "FeatureCollection",
        "frame_id": "map",
        "features": [
            feature,
            {
                **feature,
                "properties": {},
                "geometry": {"type": "MultiPolygon", "coordinates": [[ring], [ring]]},
            },
        ],
    }
    sound = json.dumps(whole).encode()

    def with_ring(points: str) -> bytes:
        return sound.replace(json.dumps(ring).encode(), points.encode())

    return {"two": sound}, lambda: {
        "nested": b"[" * 100_000,
        "nested objects": b'{"a":' * 100_000,
        "huge integer": with_ring("[[" + "9" * 5000 + ", 0], [1, 0], [1, 1], [0, 0]]"),
        "large integer": with_ring("[[" + "9" * 400 + ", 0], [1, 0], [1, 1], [0, 0]]"),
        "not a number": with_ring("[[NaN, Infinity], [1, 0], [1, 1], [0, 0]]"),
        "deep points": with_ring("[[[[1]], 2], [1, 0], [1, 1], [0, 0]]"),
        "names": json.dumps({**whole, "features": [feature] * 3}).encode(),
        "many names": json.dumps(
            {**whole, "features": [{**feature, "properties": {"name": f"r{k}"}} for k in range(5000)]}
        ).encode(),
        "coordinates": json.dumps(
            {**whole, "features": [{**feature, "geometry": {"type": "Polygon", "coordinates": {"a": 1}}}]}
        ).encode(),
    }


# ---- logs


def _carmen(_folder: Path) -> tuple[Bytes, Attacks]:
    flaser = "FLASER 9 " + " ".join(["1.0", "2.5"] * 4 + ["81.9"]) + " 1 2 0.5 1 2 0.5 {t} host {t}\n"
    robot = (
        "ROBOTLASER1 0 -1.57 3.14 0.3 10.0 0.01 0 8 1 2 3 4 5 6 7 8 0 .1 .2 .3 .1 .2 .3 0 0 0 0 0 {t} h {t}\n"
    )
    raw = "RAWLASER1 0 -1.57 3.14 0.3 10.0 0.01 0 5 1 2 3 4 5 0 {t} h {t}\n"
    odom = "ODOM 1.0 2.0 0.5 0.1 0.0 0.0 {t} h {t}\n"
    text = "".join((flaser + odom + robot + raw).format(t=f"{1e9 + k / 10:.3f}") for k in range(20)).encode()
    return {"plain": text, "gz": gzip.compress(text, mtime=0), "bz2": bz2.compress(text)}, lambda: {
        "gz bomb": gzip.compress(bytes(30_000_000), 9, mtime=0),
        "bz2 bomb": bz2.compress(bytes(20_000_000), 9),
        "one line": b"FLASER " + b"1 " * 499_000,
        "beams of 10^12": b"FLASER 1000000000000 1 2 3 0 0 0 0 0 0 1 h 1\n",
        "stamps": b"".join(
            b"ODOM 0 0 0 0 0 0 %s h %s\n" % (s, s) for s in (b"1e308", b"-1e308", b"nan", b"1e19", b"0")
        ),
        "late": text.replace(b"1000000000.", b"200000000000."),
        "params": b"PARAM laser_front_laser_resolution " + b"9" * 5000 + b"\n" + text[:500],
        "gz of lines": gzip.compress(b"FLASER 3 1 2 3 0 0 0 0 0 0 1 h 1\n" * 4_000, 9, mtime=0),
    }


def _csv(_folder: Path) -> tuple[Bytes, Attacks]:
    wide = "time_s,angle_min_deg,angle_increment_deg,range_m_0,range_m_1,range_m_2\n" + "".join(
        f"{k / 10},-90,45,1,2,3\n" for k in range(20)
    )
    long = "time_s,angle_deg,range_m,x,y,theta\n" + "".join(
        f"{k / 10},{a},{2 + a},{k / 10},0,0\n" for k in range(10) for a in (-1.0, -0.5, 0.0, 0.5, 1.0)
    )
    head = b"time_s,angle_deg,range_m\n"
    return {"wide": wide.encode(), "long": long.encode()}, lambda: {
        "angles apart": head + b"0,0,1\n0,1e-12,1\n0,6,1\n1,0,1\n",
        "angles far": head + b"0,-1e300,1\n0,1e300,1\n0,1e-300,2\n",
        "columns": b"time_s," + b"r," * 300_000 + b"\n" + b"1," * 300_000,
        "a field": b'time_s,angle,range\n0,"' + b"1" * 900_000 + b'",2\n',
        "stamps": head
        + b"".join(b"%s,0,1\n" % s for s in (b"1e308", b"-1e308", b"nan", b"inf", b"1e19", b"9" * 400)),
        "nulls": head + bytes(1000),
        "quotes": head + b'"' * 100_001,
    }


def _bags(container: str) -> Callable[[Path], tuple[Bytes, Attacks]]:
    def make(folder: Path) -> tuple[Bytes, Attacks]:
        if container == "ros1":
            story = usual(True, 1)
            from rosbags.rosbag1 import Writer

            packed = {}
            for number, pack in enumerate((None, Writer.CompressionFormat.BZ2, Writer.CompressionFormat.LZ4)):
                packed[str(number)] = story.write(folder / f"{number}.bag", pack=pack).read_bytes()
            return packed, dict
        storage = StoragePlugin.MCAP if container == "mcap" else StoragePlugin.SQLITE3
        written = usual(False, 1).write(folder / "a", storage)
        return {"usual": next(written.glob("*.mcap" if container == "mcap" else "*.db3")).read_bytes()}, dict

    return make


def _log(path: Path) -> None:
    _all(open_log(path).envelopes())


def _metadata_yaml() -> Reader:
    def open_(folder: Path) -> Opened:
        written = usual(False, 1).write(folder / "a")
        path = written / "metadata.yaml"

        def take(data: bytes) -> None:
            path.write_bytes(data)
            _log(written)

        return _opened(
            take,
            {"usual": path.read_bytes()},
            lambda: {
                "nested": b"[" * 2_000,
                "aliases": b"a: &a [x,x,x,x,x,x,x,x,x,x]\n"
                + b"".join(
                    b"%c: &%c [%s]\n" % (97 + k, 97 + k, b",".join([b"*%c" % (96 + k)] * 10))
                    for k in range(1, 9)
                ),
                "elsewhere": path.read_bytes().replace(b"a.db3", b"../../../../dev/zero"),
                "python": b"!!python/object/apply:os.system ['true']",
            },
        )

    return Reader("log.metadata", open_, 0.3)


def _trajectory(_folder: Path) -> tuple[Bytes, Attacks]:
    text = "# t x y z qx qy qz qw\n" + "".join(f"{k}.5 {k} 0 0 0 0 0 1\n" for k in range(30))
    return {
        "usual": text.encode(),
        "csv": b"start_time,end_time\n1,2\n3.5,4\n",
        "times": b"time\n1\n2.5\n",
    }, lambda: {
        "stamps": b"".join(
            b"%s 0 0 0 0 0 0 1\n" % s for s in (b"1e30", b"-1e30", b"1e999999999", b"1e-999999999")
        ),
        "stamp": b"1e999999999 0 0 0 0 0 0 1\n",
        "stamp of 19 digits": b"1e19 0 0 0 0 0 0 1\n",
        "window": b"start_time,end_time\n0,1e999999\n",
        "times": b"time\n1e99999999\n",
    }


def _read_trajectories(path: Path) -> None:
    faults = []
    for reader in (read_trajectory, read_windows, read_times):
        try:
            reader(path)
        except ValueError as error:
            faults.append(error)
    for fault in faults:
        raise fault


# ---- recordings


def _traffic(path: Path, seconds: float = 2.0) -> bytes:
    with RecordingWriter(path, {"recorder": {"settings": "{}"}}) as writer:
        for number, envelope in enumerate(Site("site", seconds=seconds).messages()):
            writer.write(envelope, 1_700_000_000_000_000_000 + number * 1_000_000)
    return path.read_bytes()


def _recording(folder: Path) -> tuple[Bytes, Attacks]:
    from mcap.writer import CompressionType, Writer

    whole = _traffic(folder / "whole.mcap")

    def of(
        messages: Iterable[tuple[str, int, bytes]],
        kind: str = "eigenscan.Health",
        compression: CompressionType = CompressionType.ZSTD,
    ) -> bytes:
        target = io.BytesIO()
        writer = Writer(target, compression=compression, chunk_size=1 << 30)
        writer.start(profile="eigenscan")
        schema = writer.register_schema(kind, "protobuf", b"")
        channels: dict[str, int] = {}
        for topic, time, data in messages:
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, "protobuf", schema)
            writer.add_message(channels[topic], time, data, time)
        writer.finish()
        return target.getvalue()

    attacks = lambda: {  # noqa: E731
        "chunk bomb": of([("site/health/a/b", 1, bytes(250_000_000))]),
        "lz4 bomb": of([("site/health/a/b", 1, bytes(40_000_000))], compression=CompressionType.LZ4),
        "other schema": of([("site/robot/r/pose", 1, b"\x0a\x00")]),
        "stamps": of([("site/health/a/b", t, b"") for t in (2**64 - 1, 0, 2**63, 1)]),
        "long key": of([("site/health/" + "x" * 60_000 + "/b", 1, b"")]),
        "escapes": of([("site/robot/\x1b[2J/pose", 1, b"")]),
        "sizes": b"\x89MCAP0\r\n" + b"\x06" + struct.pack("<Q", 2**62) + bytes(100),
        "chunk sizes": b"\x89MCAP0\r\n\x06"
        + struct.pack("<Q", 60)
        + struct.pack("<QQQI", 0, 1, 2**40, 0)
        + bytes(32),
    }
    return {
        "whole": whole,
        "cut": whole[: len(whole) * 2 // 3],
        "health": of([("site/health/a/b", 1, b"")]),
    }, attacks


def _read_recording(path: Path) -> None:
    repaired = path.with_name("repaired.mcap")
    repaired.unlink(missing_ok=True)
    faults: list[Exception] = []
    for reader in (
        lambda: _all(read(path)),
        lambda: _all(read(path, 1_700_000_000_100_000_000)),
        lambda: contents(path),
        lambda: read_metadata(path),
        lambda: is_complete(path),
        lambda: is_sound(path),
        lambda: repair(path, repaired),
        lambda: _all(open_log(path).envelopes()),
        lambda: cast(survey(path), CHOICES[PIPELINE], {}),
    ):
        try:
            reader()
        except ValueError as error:
            faults.append(error)
            if type(error).__module__.startswith("eigenscan."):
                continue
            raise
    if faults:
        raise faults[0]


# ---- models


def _message(
    name: str,
    kind: type[Message],
    read: Callable[[Any], object],
    seeds: Callable[[], Bytes],
    attacks: Callable[[], Bytes] = dict,
    weight: float = 1.0,
) -> Reader:
    """A reader of messages that came by the network."""

    def open_(_folder: Path) -> Opened:
        made, own = seeds(), list(seeds().values())

        def take(data: bytes) -> None:
            message = kind()
            try:
                message.ParseFromString(data)
            except DecodeError:
                return
            read(message)

        return Opened(take, made, lambda random, _name: forged(random, kind, own), attacks)

    return Reader(name, open_, weight)


def _site() -> SiteModel:
    from tests.services.projector.office import site

    return site(spacing=1.0, components=4)


def _region_seeds() -> Bytes:
    return {model.region: encode(model.to_message()) for model in _site().regions[:2]}


def _rehashed(message: model_pb2.RegionModel) -> None:
    """As an attacker would: whatever the fields are, the version is right."""
    from eigenscan.eigenspace.model import _digest, _inflate

    with contextlib.suppress(Exception):
        message.version = _digest(message, _inflate(message))
    RegionModel.from_message(message)


def _region_attacks() -> Bytes:
    first = _site().regions[0].to_message()

    def of(**fields: Any) -> bytes:
        changed = model_pb2.RegionModel()
        changed.CopyFrom(first)
        for name, value in fields.items():
            if isinstance(value, list):
                del getattr(changed, name)[:]
                getattr(changed, name).extend(value)
            else:
                setattr(changed, name, value)
        return encode(changed)

    bomb = zlib.compress(bytes(2**28), 9)
    return {
        "far": of(origin_x=1e308, origin_y=1e308),
        "bomb": of(panoramas=bomb),
        "most panoramas": of(beams=720, index_x=list(range(180_000)), index_y=[0] * 180_000, panoramas=bomb),
        "beams": of(beams=2**32 - 1),
        "old format": of(format=1),
        "old format, one position": of(
            format=1, index_x=[0], index_y=[0], panoramas=zlib.compress(bytes(2 * first.beams))
        ),
        "positions far apart": of(index_x=[10**6] * len(first.index_x)),
        "outline": of(outline_x=[math.nan] * 4, outline_y=[1e308] * 4),
    }


def _read_space(message: model_pb2.Eigenspace) -> None:
    """As its readers do: they name its region."""
    try:
        space_from_message(message)
    except ValueError as error:
        if type(error) is not ValueError:
            raise
        raise ModelError(str(error)) from error


def _set_reader() -> Reader:
    """Map, models and set as a projector takes them, with the versions made right where that is possible."""

    def open_(_folder: Path) -> Opened:
        sound = envelopes(_site())
        seeds = {f"{n} {each.channel.name}": encode(each.message) for n, each in enumerate(sound)}

        def mutate(random: Random, name: str) -> bytes:
            number = int(name.split(maxsplit=1)[0])
            kind = type(sound[number].message)
            return bytes([number]) + forged(random, kind, [seeds[name]])

        def take(data: bytes) -> None:
            number = data[0] % len(sound) if data else 0
            assembler = ModelSetAssembler()
            for place, each in enumerate(sound):
                message = each.message
                if place == number:
                    message = type(message)()
                    try:
                        message.ParseFromString(data[1:])
                    except DecodeError:
                        return
                    if isinstance(message, model_pb2.RegionModel):
                        _rehashed(message)
                if isinstance(message, Grid):
                    assembler.put_map(message)
                elif isinstance(message, model_pb2.RegionModel):
                    assembler.put_model(message)
                elif isinstance(message, model_pb2.ModelSet):
                    assembler.put_set(message)

        opened = {name: bytes([int(name.split()[0])]) + data for name, data in seeds.items()}
        return Opened(take, opened, mutate, dict)

    return Reader("model.set", open_, 0.3)


def _grid_seeds() -> Bytes:
    return {"office": encode(grid_to_message(office(), "map"))}


def _models_folder() -> Reader:
    """A model folder of which one file is not what it was."""

    def open_(folder: Path) -> Opened:
        models = folder / "models"
        write_models(_site(), models, b"", None)
        files = {
            str(path.relative_to(models)): path.read_bytes()
            for path in sorted(models.rglob("*"))
            if path.is_file()
        }
        files = {name: data for name, data in files.items() if not name.endswith((".pgm", ".png"))}
        names = sorted(files)

        def take(data: bytes) -> None:
            name = names[data[0] % len(names)] if data else names[0]
            (models / name).write_bytes(data[1:])
            try:
                faults = []
                for reader in (read_models, versions):
                    try:
                        reader(models)
                    except ValueError as error:
                        faults.append(error)
                for fault in faults:
                    raise fault
            finally:
                (models / name).write_bytes(files[name])

        seeds = {name: bytes([number]) + files[name] for number, name in enumerate(names)}
        manifest, region = (
            names.index("manifest.json"),
            next(n for n, name in enumerate(names) if name.endswith(".npz")),
        )
        return Opened(
            take,
            seeds,
            lambda random, name: seeds[name][:1] + damaged(random, seeds[name][1:], list(files.values())),
            lambda: {
                "nested": bytes([manifest]) + b"[" * 100_000,
                "a list": bytes([manifest]) + b"[1, 2]",
                "elsewhere": bytes([manifest])
                + files["manifest.json"].replace(b'"region": "', b'"region": "../'),
                **{
                    f"npz {name}": bytes([region]) + data
                    for name, data in _archives(files[names[region]]).items()
                },
            },
        )

    return Reader("folder.models", open_, 0.5)


def _archives(sound: bytes) -> Bytes:
    """Archives of numpy that take all memory, or are none."""
    with zipfile.ZipFile(io.BytesIO(sound)) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}

    def packed(changed: Mapping[str, bytes]) -> bytes:
        target = io.BytesIO()
        with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
            for name, data in {**parts, **changed}.items():
                archive.writestr(zipfile.ZipInfo(name), data, zipfile.ZIP_DEFLATED, 9)
        return target.getvalue()

    def header(shape: str, kind: str = "<f8") -> bytes:
        text = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}".encode()
        return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text

    first = sorted(parts)[0]
    return {
        "bomb": packed({first: header("(12500000,)") + bytes(100_000_000)}),
        "shape of 10^15": packed({first: header("(1000000000000000,)")}),
        "shape of 10^40": packed({first: header("(" + "9" * 40 + ",)")}),
        "shape below 0": packed({first: header("(-1, 5)")}),
        "objects": packed({first: header("(1,)", "|O") + b"\x80\x04N."}),
        "open header": packed({first: b"\x93NUMPY\x01\x00\x10\x00{'descr': (      "}),
        "nested header": packed({first: header("(" * 200 + ")" * 200)}),
        "long header": packed({first: b"\x93NUMPY\x02\x00" + struct.pack("<I", 2**31)}),
        "many": packed({f"{k}.npy": b"" for k in range(9000)}),
        "no part": packed({first: b""}),
    }


def _spaces(folder: Path) -> tuple[Bytes, Attacks]:
    write_spaces({model.version: model.space for model in _site().regions}, folder / "a.npz")
    sound = (folder / "a.npz").read_bytes()
    return {"usual": sound}, lambda: _archives(sound)


def _evidence() -> Reader:
    def open_(folder: Path) -> Opened:
        store, grid = Store(folder / "models"), office()
        store.save(Evidence.of(grid, 60.0), grid)
        path = folder / "models.evidence.npz"
        sound = path.read_bytes()

        def take(data: bytes) -> None:
            path.write_bytes(data)
            store.load(grid, 60.0)

        return _opened(take, {"usual": sound}, lambda: _archives(sound))

    return Reader("folder.evidence", open_, 0.3)


def _cache() -> Reader:
    """A folder of latched samples: names and contents."""

    def open_(folder: Path) -> Opened:
        kept = folder / "kept"
        cache = LatchedCache(kept)
        for model in _site().regions[:2]:
            key = MODEL.key({"site": "s", "region": model.region})
            cache.put(Arrival(MODEL, key, encode(model.to_message()), encoding(MODEL)))
        files = {path.name: path.read_bytes() for path in sorted(kept.iterdir())}

        def take(data: bytes) -> None:
            name, _, content = data.partition(b"\0")
            path = kept / (os.fsdecode(name).replace("/", "%2F")[:200] or "x")
            if path.is_dir():
                return
            path.write_bytes(content)
            try:
                again = LatchedCache(kept)
                _all(again.read("s"))
                again.put(Arrival(MODEL, "s/model/a", b"x", encoding(MODEL)))
            finally:
                path.unlink(missing_ok=True)
                for each in kept.iterdir():
                    if each.is_file() and each.name not in files:
                        each.unlink()
                for own, before in files.items():
                    (kept / own).write_bytes(before)

        seeds = {name: name.encode() + b"\0" + data[:2000] for name, data in files.items()}
        return _opened(
            take,
            seeds,
            lambda: {
                "superscript": "²-0-s%2Fmap".encode() + b"\0x\ny",
                "digits of elsewhere": "٣-0-s%2Fmap".encode() + b"\0x\ny",
                "large number": b"9" * 150 + b"-0-s%2Fmap\0x\ny",
                "no key": b"1--\0",
            },
        )

    return Reader("folder.cache", open_)


def _last_pose() -> Reader:
    def open_(folder: Path) -> Opened:
        import time

        from eigenscan.schemas.geometry_pb2 import Covariance3, Pose2
        from eigenscan.schemas.tracking_pb2 import Relocation

        path = folder / "site.r.pose"
        now = Relocation(pose=Pose2(x=1), covariance=Covariance3(xx=1, yy=1, tt=1), frame_id="map")
        now.timestamp.FromNanoseconds(time.time_ns() - 10**9)
        seed = now.SerializeToString()

        def take(data: bytes) -> None:
            path.write_bytes(data)
            core = Remembering(TrackerCore(TrackerSettings()), TrackerOptions(last_pose=folder), folder)
            for output in core.start():
                _all(core.handle(output))

        return Opened(take, {"usual": seed}, lambda random, _: forged(random, Relocation, [seed]), dict)

    return Reader("folder.last_pose", open_)


def _uploads() -> Reader:
    def open_(folder: Path) -> Opened:
        _traffic(folder / "site-20260101-000000.mcap", 1.0)
        uploads = Uploads(Files(folder, "site"))
        name = "site-20260101-000000.mcap"
        seed = RecordingRequest(name=name, offset=5, length=100).SerializeToString()
        return Opened(
            lambda data: (uploads.answer("bytes", data), uploads.answer("parts", data)),
            {"usual": seed},
            lambda random, _: forged(random, RecordingRequest, [seed]),
            lambda: {
                "elsewhere": RecordingRequest(name="../../etc/passwd", length=2**31).SerializeToString()
            },
        )

    return Reader("recordings.asked", open_, 0.5)


# ---- CDR


def _cdr() -> Reader:
    def open_(_folder: Path) -> Opened:
        kinds = [
            cdr.LASER_SCAN,
            cdr.ODOMETRY,
            cdr.TRANSFORMS,
            cdr.POSE_WITH_COVARIANCE,
            cdr.OCCUPANCY_GRID,
            cdr.PARTICLE_CLOUD,
            cdr.BOND,
            cdr.STRING,
            *(f"{kind}_Request" for kind in SERVICES),
            cdr.POINT_CLOUD,
            cdr.IMU,
        ]
        sound = {
            cdr.LASER_SCAN: ros_scan(),
            cdr.ODOMETRY: ros_odometry(1, 2, 0.5),
            cdr.TRANSFORMS: ros_transform("odom", "base_link", (0.2, 0.1, 0.3), (0.0, 0.0, 1.0, 0.0)),
            cdr.POSE_WITH_COVARIANCE: ros_odometry(1, 2, 0.5),
            cdr.OCCUPANCY_GRID: ros_odometry(1, 2, 0.5),
            cdr.POINT_CLOUD: ros_cloud([(1.0, 2.0, 0.3), (2.0, 1.0, 0.4)]),
            cdr.IMU: imu((0.0, 0.0, 0.5), 1),
        }
        seeds = {
            f"{n} {kind}": bytes([n]) + sound.get(kind, bytes([0, 1, 0, 0]) + bytes(40))
            for n, kind in enumerate(kinds)
        }
        parameters = Parameters.of_bridge(LiveSettings(RosBridgeOptions()))
        headings = HeadingSum(Counter())

        def take(data: bytes) -> None:
            kind = kinds[data[0] % len(kinds)] if data else kinds[0]
            body = cdr.decode(kind, data[1:])
            if kind == cdr.LASER_SCAN:
                raw_scan(body, 1, (0.0, 0.0, 0.0), upside_down=False)
            elif kind == cdr.ODOMETRY:
                odometry(body)
            elif kind == cdr.TRANSFORMS:
                for item in body.transforms:
                    odometry_of_tf(item)
            elif kind == cdr.POSE_WITH_COVARIANCE:
                relocation(body)
            elif kind == cdr.OCCUPANCY_GRID:
                grid_map(body)
            elif kind == cdr.POINT_CLOUD:
                Slice(0.1, 0.6).scan(body, 1, np.eye(4))
            elif kind == cdr.IMU:
                heading = headings.take(body, np.eye(4))
                assert heading is None or np.isfinite(heading.heading)
            elif kind.endswith("Parameters_Request"):
                parameters.answer(kind.removesuffix("_Request"), data[1:])

        others = [data[1:] for data in seeds.values()]
        return Opened(
            take,
            seeds,
            lambda random, name: seeds[name][:1] + damaged(random, seeds[name][1:], others),
            lambda: {
                "length": seeds[f"2 {cdr.TRANSFORMS}"][:5] + struct.pack("<I", 2**32 - 1) + bytes(64),
                "many": seeds[f"2 {cdr.TRANSFORMS}"][:5] + struct.pack("<I", 2**31) + bytes(900_000),
            },
        )

    return Reader("cdr", open_, 2.0)


# ---- configurations and settings

_OPTIONS: dict[str, type[ServiceSettings]] = {
    "scan-ingest": ScanIngestOptions,
    "projector": ProjectorOptions,
    "tracker": TrackerOptions,
    "mapbuilder": MapbuilderOptions,
    "recorder": RecorderOptions,
    "ros-bridge": RosBridgeOptions,
}


def _settings(folder: Path) -> tuple[Bytes, Attacks]:
    text = 'site = "hospital"\nrobot = "a-*,b-7"\nmetrics_port = 0\n'
    seeds = {}
    for service, kind in _OPTIONS.items():
        lines = []
        for name, field in kind.model_fields.items():
            if name in ServiceSettings.model_fields or field.default_factory or field.is_required():
                continue
            value = field.default
            if isinstance(value, bool):
                lines.append(f"{name} = {str(value).lower()}")
            elif isinstance(value, int | float):
                lines.append(f"{name} = {value}")
            elif isinstance(value, str):
                lines.append(f"{name} = {json.dumps(value)}")
        seeds[service] = (text + f"[{service}]\n" + "\n".join(lines) + "\n").encode()
    return seeds, lambda: {
        "nested": b"a = " + b"[" * 90_000,
        "nested tables": b"a = " + b"{a = " * 20_000,
        "dotted": b".".join([b"a"] * 19_000) + b" = 1",
        "huge integer": b"metrics_port = " + b"9" * 90_000,
        "robots": b'robot = "' + b",".join(b"r%d-*" % k for k in range(2000)) + b'"',
        "a date": b"site = 2020-01-01T00:00:00Z",
        "escapes": b'site = "\\u001b[2J"',
        "stop": b"stop_s = inf\nbehind_after = nan",
    }


def _read_settings(path: Path) -> None:
    service = sorted(_OPTIONS)[path.stat().st_size % len(_OPTIONS)]
    validated(_OPTIONS[service], read_table(_OPTIONS[service], service, path))


def _flag() -> Reader:
    """A word on the command line or in the environment."""

    def open_(_folder: Path) -> Opened:
        seeds = {
            f"{service} {name}": f"{service}\n{name}\n{field.default}".encode()
            for service, kind in _OPTIONS.items()
            for name, field in kind.model_fields.items()
        }

        def take(data: bytes) -> None:
            service, _, rest = data.decode(errors="replace").partition("\n")
            name, _, text = rest.partition("\n")
            kind = _OPTIONS.get(service, TrackerOptions)
            if name in kind.model_fields:
                validated(kind, {name: Given(typed(kind, name, text), f"--{name}")})

        def mutate(random: Random, name: str) -> bytes:
            head, _, value = seeds[name].rpartition(b"\n")
            return (
                head
                + b"\n"
                + damaged(random, value, [b'["a", "b"]', b'{"a": 1}', b"1e308", b"nan", b"a-*,b"])
            )

        return Opened(
            take,
            seeds,
            mutate,
            lambda: {
                "nested": b"ros-bridge\nscan\n" + b"[" * 100_000,
                "huge integer": b"ros-bridge\nscan\n[" + b"9" * 5000 + b"]",
            },
        )

    return Reader("settings.flag", open_, 2.0)


def _fleet() -> Reader:
    def open_(folder: Path) -> Opened:
        path = folder / "fleet.toml"
        layout.begin(folder, "hospital", ["10.0.0.1"])
        sound = path.read_bytes()
        more = (
            sound + b'[robots.r17]\nscan_raw = 5.0\n[groups]\nlab = "a-*"\n'
            if b"\n[groups]" not in sound
            else sound
        )

        def take(data: bytes) -> None:
            path.write_bytes(data)
            layout.read(folder)

        return _opened(
            take,
            {"new": sound, "more": more.replace(b"# lab", b"lab").replace(b"# [robots", b"[robots")},
            lambda: {
                "nested": b"a = " + b"[" * 90_000,
                "robots": sound + b"".join(b"[robots.r%d]\nscan = 1.0\n" % k for k in range(20_000)),
                "air": sound.replace(b"scan = 2.0", b"scan = nan"),
                "huge integer": b"site = " + b"9" * 50_000,
            },
        )

    return Reader("fleet.toml", open_, 0.5)


FILES: tuple[Reader, ...] = (
    _file("map.yaml", ".yaml", read_map, _map_yaml),
    _file("map.image", ".png", lambda path: read_image(path, 0.05), _image, 2.0),
    _file("plan.svg", ".svg", lambda path: read_plan(path, PlanOptions(0.01)), _svg, 0.3),
    _file("plan.dxf", ".dxf", lambda path: read_plan(path, PlanOptions()), _dxf, 0.1),
    _file("regions.geojson", ".json", read_regions, _geojson, 2.0),
    _file("log.carmen", ".log", _log, _carmen),
    _file("log.csv", ".csv", _log, _csv),
    _file("log.ros1", ".bag", _log, _bags("ros1"), 0.3),
    _file("log.ros2", ".db3", _log, _bags("sqlite"), 0.3),
    _file("log.mcap", ".mcap", _log, _bags("mcap"), 0.3),
    _metadata_yaml(),
    _file("log.trajectory", ".txt", _read_trajectories, _trajectory, 2.0),
    _file("recording", ".mcap", _read_recording, _recording, 0.1),
    _message("model.region", model_pb2.RegionModel, _rehashed, _region_seeds, _region_attacks, 0.5),
    _message(
        "model.space",
        model_pb2.Eigenspace,
        _read_space,
        lambda: {"one": encode(space_to_message(_site().regions[0].space))},
    ),
    _message("model.grid", Grid, grid_from_message, _grid_seeds, weight=2.0),
    _set_reader(),
    _models_folder(),
    _file("folder.spaces", ".npz", read_spaces, _spaces, 0.5),
    _evidence(),
    _cache(),
    _last_pose(),
    _uploads(),
    _cdr(),
    _file("settings.toml", ".toml", _read_settings, _settings, 0.5),
    _flag(),
    _fleet(),
)
assert len({reader.name for reader in FILES}) == len(FILES)
