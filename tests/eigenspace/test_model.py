import dataclasses
import hashlib
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from eigenscan.eigenspace.analysis import ANALYSIS_TURN, HEADING_STRIDE, Analysis, RegionSpace
from eigenscan.eigenspace.components import analyse
from eigenscan.eigenspace.embedding import Embedding
from eigenscan.eigenspace.folder import SiteModel, read_models, write_models
from eigenscan.eigenspace.model import NO_WALL, RANGE_UNIT, ModelError, RegionModel, quantize, set_version
from eigenscan.eigenspace.panorama import Sensor, resample
from eigenscan.geometry.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from eigenscan.schemas import model_pb2
from eigenscan.schemas.channels import MODEL
from eigenscan.schemas.wire import decode, encode

ANALYSIS = Analysis(Embedding("ring", 9.0), beams=46, components=4)


def model(region: str = "hall", seed: int = 0) -> RegionModel:
    rng = np.random.default_rng(seed)
    panoramas = rng.uniform(0.5, 30.0, (7, 48)).astype(np.float32)
    panoramas[2, 5:9] = np.inf
    index = np.column_stack([np.arange(7) - 3, np.arange(7) // 2]).astype(np.int32)
    return RegionModel.of(
        ANALYSIS,
        region=region,
        frame_id="map",
        spacing=0.25,
        origin=np.array([-1.5, 2.0]),
        index=index,
        ranges=quantize(panoramas),
        outline=np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]),
    )


def same(a: RegionModel, b: RegionModel) -> None:
    for field in dataclasses.fields(RegionModel):
        one, other = getattr(a, field.name), getattr(b, field.name)
        if field.name == "space":
            same_space(one, other)
        else:
            np.testing.assert_array_equal(one, other)


def same_space(one: RegionSpace, other: RegionSpace) -> None:
    """To the last bit."""
    assert one.embedding == other.embedding
    assert (one.usual_error, one.space.total_variance) == (other.usual_error, other.space.total_variance)
    for name in ("mean", "vectors", "eigenvalues"):
        np.testing.assert_array_equal(getattr(one.space, name), getattr(other.space, name))


def test_a_model_comes_back_from_the_wire_as_it_went() -> None:
    sent = model()
    message = decode(MODEL, encode(sent.to_message()))
    assert isinstance(message, model_pb2.RegionModel)
    received = RegionModel.from_message(message)
    same(sent, received)
    assert received.version == sent.version
    np.testing.assert_allclose(received.positions[0], [-1.5 - 0.75, 2.0])


def test_ranges_are_kept_to_half_a_step_and_no_wall_stays_none() -> None:
    panoramas = np.array([[0.0, 0.0011, 12.3456, 131.0, 131.2, 500.0, np.inf]], dtype=np.float32)
    steps = quantize(panoramas)
    assert steps.tolist()[0][4:] == [NO_WALL] * 3
    np.testing.assert_allclose(steps[0, :4] * RANGE_UNIT, panoramas[0, :4], atol=RANGE_UNIT / 2 + 1e-5)
    kept = dataclasses.replace(model(), ranges=np.repeat(steps, 7, axis=0)).panoramas
    assert np.isinf(kept[:, 4:]).all()
    assert kept.dtype == np.float32


def test_an_entry_states_how_many_beams_meet_a_wall() -> None:
    assert model().entry.walls_in_sight == pytest.approx(1.0 - 4 / (7 * 48))


def test_the_version_is_the_contents() -> None:
    one = model()
    assert model().version == one.version
    changed = [
        dataclasses.replace(one, region="other"),
        dataclasses.replace(one, spacing=0.3),
        dataclasses.replace(one, index=one.index + 1),
        dataclasses.replace(one, ranges=one.ranges + np.uint16(1)),
        dataclasses.replace(one, space=dataclasses.replace(one.space, usual_error=0.5)),
    ]
    assert len({one.version, *(m.version for m in changed)}) == 6


def test_another_compressor_does_not_make_another_version() -> None:
    message = model().to_message()
    message.panoramas = zlib.compress(zlib.decompress(message.panoramas), 9)
    assert RegionModel.from_message(message).version == message.version


def broken(**changes: object) -> model_pb2.RegionModel:
    message = model().to_message()
    for name, value in changes.items():
        field = getattr(message, name)
        if hasattr(field, "extend"):
            del field[:]
            field.extend(value)
        else:
            setattr(message, name, value)
    return message


def broken_space(**changes: object) -> model_pb2.RegionModel:
    """A model whose version is right, but not its eigenspace."""
    message = model().to_message()
    for name, value in changes.items():
        field = getattr(message.space, name)
        if hasattr(field, "extend"):
            del field[:]
            field.extend(value)
        else:
            setattr(message.space, name, value)
    return renamed(message)


def renamed(message: model_pb2.RegionModel) -> model_pb2.RegionModel:
    """With the version that its content has, by the contract's words."""
    plain = model_pb2.RegionModel()
    plain.CopyFrom(message)
    plain.ClearField("version")
    plain.panoramas = zlib.decompress(message.panoramas)
    message.version = hashlib.sha256(plain.SerializeToString(deterministic=True)).hexdigest()
    return message


def test_what_a_later_version_adds_is_part_of_the_content() -> None:
    message = model().to_message()
    later = model_pb2.RegionModel.FromString(message.SerializeToString() + b"\xb1\x01" + 8 * b"\x3f")
    with pytest.raises(ModelError, match="claims"):
        RegionModel.from_message(later)
    same(RegionModel.from_message(renamed(later)), model())


def first_format() -> model_pb2.RegionModel:
    """A model as the first release published it: with an eigenspace of plain ranges."""
    message = model().to_message()
    message.ClearField("space")
    message.format, message.range_cap, message.mean, message.total_variance = 1, 15.0, 7.0, 3.0
    message.sensor.angle_increment, message.sensor.beams = 0.1, 2
    message.eigenvectors.extend([0.6, 0.8])
    message.eigenvalues.append(2.5)
    return renamed(message)


def test_of_the_first_format_the_space_is_derived_and_the_version_stays() -> None:
    message = first_format()
    received = RegionModel.from_message(message)
    assert received.version == message.version != model().version
    now = model().derive(Analysis())[0]
    same_space(received.space, now)
    same(received, dataclasses.replace(model(), space=now))


def test_the_version_of_the_first_format_holds_its_own_eigenspace_too() -> None:
    message = first_format()
    message.eigenvectors[0] = 0.7
    with pytest.raises(ModelError, match="claims"):
        RegionModel.from_message(message)


def test_a_space_for_another_lidar_is_that_of_the_same_panoramas() -> None:
    one = model()
    wide = one.space.analysis.of(Sensor.facing(2 * np.pi, np.deg2rad(0.5), 5.0))
    assert (wide.beams, wide.embedding.cap, wide.components) == (ANALYSIS_TURN, 5.0, 4)
    space, held = one.derive(wide)
    direct = analyse(Embedding("ring", 5.0)(resample(one.panoramas, ANALYSIS_TURN)), ANALYSIS_TURN, 4)
    np.testing.assert_array_equal(space.space.vectors, direct.vectors)
    assert held.shape[1:] == (ANALYSIS_TURN // HEADING_STRIDE, 4)
    same_space(one.derive(one.space.analysis)[0], one.space)


@pytest.mark.parametrize(
    ("message", "stated"),
    [
        (broken(format=3), "format 3, this version reads 2: .* eigenscan build"),
        (broken(format=1), "claims"),
        (broken(version="0" * 64), "claims"),
        (broken(spacing=0.26), "claims"),
        (broken(spacing=0.0), "spacing = 0"),
        (broken(range_unit=float("nan")), "range_unit = nan"),
        (broken(index_x=[], index_y=[]), "0 x and 0 y"),
        (broken(index_x=[1, 2]), "2 x and 7 y"),
        (broken(panoramas=model().to_message().panoramas[:-20]), "bytes of panoramas, expected 672"),
        (broken(panoramas=b"rubbish"), "do not inflate"),
        (broken(panoramas=b""), "0 bytes of panoramas"),
        (broken(beams=0), "panoramas of 0"),
        (broken(beams=4_000_000_000), "panoramas of 4000000000"),
        (broken(beams=50), "bytes of panoramas, expected 700"),
        (broken_space(eigenvalues=[1.0]), "368 numbers of vectors"),
        (broken_space(vectors=[float("inf")] * 368), "not finite"),
        (broken_space(vectors=[0.5] * 368), "unit length"),
        (broken_space(eigenvalues=[-1.0] * 4), "at least 0"),
        (broken_space(mean=[float("nan"), 0.0]), "not finite"),
        (broken_space(mean=[0.0]), "1 of the mean"),
        (broken_space(usual_error=float("nan")), "not finite"),
        (broken_space(embedding=0), "embedding 0"),
        (broken_space(cap=float("inf")), "range cap"),
        (broken_space(turn=360), "46 beams of 360"),
        (broken_space(beams=0), "0 beams of 180"),
        (broken(outline_x=[1.0]), "1 x and 3 y"),
        (model_pb2.RegionModel(), "format 0"),
        (broken(origin_x=1e308, origin_y=1e308), "no building"),
        (broken(origin_y=float("nan")), "no building"),
        (broken(spacing=1e-9), "no building"),
        (broken(beams=65536, index_x=[0] * 10_000, index_y=[0] * 10_000), "more than"),
    ],
)
def test_a_broken_model_is_refused_with_what_is_wrong(message: model_pb2.RegionModel, stated: str) -> None:
    with pytest.raises(ModelError, match=stated):
        RegionModel.from_message(message)


def test_a_payload_that_inflates_beyond_measure_is_refused_unread() -> None:
    bomb = zlib.compress(bytes(50_000_000), 9)
    with pytest.raises(ModelError, match="673 bytes of panoramas, expected 672"):
        RegionModel.from_message(broken(panoramas=bomb))


def site() -> SiteModel:
    cells = np.full((12, 15), FREE, dtype=np.uint8)
    cells[0], cells[:, 3] = OCCUPIED, UNKNOWN
    grid = GridMap(cells, 0.05, np.array([1.0, 2.0, 0.25]))
    return SiteModel(grid, "floor2", (model("a"), model("b", 1)))


def test_a_folder_comes_back_as_it_was_written(tmp_path: Path) -> None:
    folder = tmp_path / "deep" / "models"
    write_models(site(), folder, b"a picture")
    read = read_models(folder)
    assert read.to_message() == site().to_message()
    np.testing.assert_array_equal(read.grid.cells, site().grid.cells)
    for one, other in zip(read.regions, site().regions, strict=True):
        same(one, other)
    assert (folder / "regions.png").read_bytes() == b"a picture"
    assert sorted(p.name for p in folder.parent.iterdir()) == ["models"]


def test_the_files_are_plain(tmp_path: Path) -> None:
    import json

    write_models(site(), tmp_path / "m")
    manifest = json.loads((tmp_path / "m/manifest.json").read_text())
    assert [entry["region"] for entry in manifest["regions"]] == ["a", "b"]
    with np.load(tmp_path / "m/regions/a.npz") as file:
        np.testing.assert_array_equal(file["ranges"], model("a").ranges)


def test_a_new_set_takes_the_place_of_an_old_one_and_nothing_elses(tmp_path: Path) -> None:
    write_models(site(), tmp_path / "m")
    only = SiteModel(site().grid, "floor2", (model("c", 2),))
    write_models(only, tmp_path / "m")
    assert [m.region for m in read_models(tmp_path / "m").regions] == ["c"]
    assert not (tmp_path / "m/regions/a.npz").exists()
    (tmp_path / "papers").mkdir()
    (tmp_path / "papers/thesis.txt").write_text("years of work")
    with pytest.raises(ModelError, match="holds no models"):
        write_models(only, tmp_path / "papers")
    assert (tmp_path / "papers/thesis.txt").exists()
    (tmp_path / "file").write_text("")
    with pytest.raises(ModelError, match="holds no models"):
        write_models(only, tmp_path / "file")


def test_a_write_that_fails_leaves_the_old_set(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_models(site(), tmp_path / "m")
    before = read_models(tmp_path / "m").to_message()

    def full(*_arguments: object, **_named: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("eigenscan.eigenspace.folder.write_map", full)
    with pytest.raises(ModelError, match="No space left"):
        write_models(SiteModel(site().grid, "floor2", (model("c", 2),)), tmp_path / "m")
    assert read_models(tmp_path / "m").to_message() == before
    assert [p.name for p in tmp_path.iterdir()] == ["m"]


def damage_text(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


@pytest.mark.parametrize(
    ("damage", "stated"),
    [
        (lambda m: (m / "manifest.json").unlink(), "manifest.json: cannot be read"),
        (lambda m: (m / "manifest.json").write_text("{"), "is not JSON"),
        (lambda m: (m / "manifest.json").write_text("[]"), "no manifest"),
        (lambda m: (m / "manifest.json").write_text("{}"), "lacks 'layout'"),
        (lambda m: damage_text(m / "manifest.json", '"layout": 2', '"layout": 9'), "layout 9"),
        (lambda m: damage_text(m / "manifest.json", '"region": "a"', '"region": "../a"'), "region's name"),
        (lambda m: damage_text(m / "manifest.json", '"region": "a"', '"region": "b"'), "not the version"),
        (lambda m: (m / "regions/a.npz").unlink(), "a.npz: cannot be read"),
        (lambda m: (m / "regions/a.npz").write_bytes(b"PK"), "a.npz"),
        (
            lambda m: (m / "regions/a.npz").write_bytes((m / "regions/a.npz").read_bytes()[:-300]),
            "a.npz: is no region",
        ),
        (lambda m: np.savez(m / "regions/a.npz", region="a"), "a.npz: is no region"),
        (lambda m: damage_text(m / "map.yaml", "0.05", "0.06"), "is not the map"),
        (lambda m: (m / "map.pgm").unlink(), "map.pgm"),
    ],
)
def test_a_damaged_folder_is_refused_with_the_file_and_what_is_wrong(
    tmp_path: Path, damage: Callable[[Path], object], stated: str
) -> None:
    folder = tmp_path / "m"
    write_models(site(), folder)
    damage(folder)
    with pytest.raises(ModelError, match=stated):
        read_models(folder)


def test_the_sets_version_is_that_of_its_map_and_models_in_order() -> None:
    import hashlib

    message = site().to_message()
    text = "\n".join([message.map_version, *(entry.version for entry in message.entries)])
    assert message.version == hashlib.sha256(text.encode()).hexdigest()
    assert set_version("m", ["a", "b"]) != set_version("m", ["b", "a"])
    assert [entry.size for entry in message.entries] == [
        model("a").to_message().ByteSize(),
        model("b", 1).to_message().ByteSize(),
    ]
