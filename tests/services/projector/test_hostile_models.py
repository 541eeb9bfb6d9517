"""Models that look sound and are of no building: refused before anything compiled sees them."""

from dataclasses import replace
from typing import cast

import pytest
from eigenscan.eigenspace.folder import SiteModel
from eigenscan.eigenspace.model import ModelError, RegionModel, set_version
from eigenscan.eigenspace.space_message import space_from_message, space_to_message
from eigenscan.projector import model_set_assembler, set_aside
from eigenscan.projector.model_set_assembler import ModelSetAssembler, WholeSet
from eigenscan.schemas import model_pb2
from eigenscan.schemas.channels import MODEL, MODEL_SET, SPACE
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.health_pb2 import Health
from foxglove_schemas_protobuf.Grid_pb2 import Grid

from tests.services.projector.office import envelopes, ready, site


def _put(assembler: ModelSetAssembler, built: SiteModel) -> WholeSet | None:
    """All messages of a site; the last answer, which is the set where it is whole."""
    whole = None
    for envelope in envelopes(built):
        message = envelope.message
        if isinstance(message, Grid):
            whole = assembler.put_map(message)
        elif isinstance(message, model_pb2.RegionModel):
            whole = assembler.put_model(message)
        elif isinstance(message, model_pb2.ModelSet):
            whole = assembler.put_set(message)
    return whole


def _moved(built: SiteModel, shift: float) -> SiteModel:
    """The site with one region elsewhere, and every hash made again."""
    first = built.regions[0]
    return replace(built, regions=(replace(first, origin=first.origin + shift), *built.regions[1:]))


@pytest.mark.parametrize("shift", [1e308, 1e7, -400.0])
def test_a_region_outside_of_the_map_is_refused_although_its_hash_is_right(shift: float) -> None:
    with pytest.raises(ModelError, match=site().regions[0].region):
        _put(ModelSetAssembler(), _moved(site(), shift))


def test_after_a_hostile_set_the_next_sound_one_is_taken() -> None:
    assembler = ModelSetAssembler()
    with pytest.raises(ModelError):
        _put(assembler, _moved(site(), 400.0))
    whole = _put(assembler, site())
    assert whole is not None
    assert whole.version == site().to_message().version


def test_positions_closer_than_a_building_needs_take_no_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """At 1 mm the grid around 180 m2 took 500 MB."""
    monkeypatch.setattr(model_set_assembler, "MOST_CELLS", 10**6)
    finer = tuple(replace(one, spacing=0.001, index=one.index * 500) for one in site().regions)
    with pytest.raises(ModelError, match=r"spacing 0\.001 m makes .* larger --spacing"):
        _put(ModelSetAssembler(), replace(site(), regions=finer))


def _other(number: int) -> model_pb2.RegionModel:
    """A sound model of another version."""
    return replace(site().regions[0], spacing=0.501 + 0.001 * number).to_message()


def test_models_that_no_set_needs_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each distinct one stayed until a set was whole."""
    monkeypatch.setattr(set_aside, "MOST", 3)
    assembler = ModelSetAssembler()
    for number in range(10):
        assembler.put_model(_other(number))
    assert len(assembler._models) == 3
    assert assembler.set_aside == 7
    *parts, announced = (one.message for one in envelopes(site()))
    assembler.put_set(cast(model_pb2.ModelSet, announced))
    for message in parts[1:]:
        assembler.put_model(cast(model_pb2.RegionModel, message))
        for number in range(5):
            assembler.put_model(_other(number))
    whole = assembler.put_map(cast(Grid, parts[0]))
    assert whole is not None, assembler.missing


def test_models_that_no_set_needs_are_bounded_by_their_size(monkeypatch: pytest.MonkeyPatch) -> None:
    core, one = ready(), set_aside.size_of_model(RegionModel.from_message(_other(0)))
    monkeypatch.setattr(set_aside, "MOST_BYTES", int(2.5 * one))
    before = core.condition().counters
    for number in range(10):
        core.handle(Envelope(MODEL, {"site": "s", "region": f"r{number}"}, _other(number)))
    assert core.condition().counters["set_aside_model"] == 8
    assert "set_aside_model" not in before


def test_eigenspaces_of_unknown_models_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(set_aside, "MOST", 3)
    core, space = ready(), space_to_message(site().regions[0].space)
    for number in range(10):
        message = model_pb2.RegionSpace(region="r", model_version=str(number), space=space)
        core.handle(Envelope(SPACE, {"site": "s", "region": "r", "kind": "k"}, message))
    assert len(core._spaces) == 3
    assert core.condition().counters["set_aside_space"] == 7


def _announcing(*versions: str) -> model_pb2.ModelSet:
    """A set with a right hash that names these models."""
    entries = [
        model_pb2.ModelSet.Entry(region=f"r{number}", version=one) for number, one in enumerate(versions)
    ]
    return model_pb2.ModelSet(version=set_version("", versions), entries=entries)


def test_a_set_of_very_many_models_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(set_aside, "MOST_REGIONS", 10)
    core = ready()
    core.handle(Envelope(MODEL_SET, {"site": "s"}, _announcing(*map(str, range(11)))))
    condition = core.condition()
    assert condition.status == Health.STATUS_DEGRADED
    assert "11 regions, 10 at most" in condition.detail
    assert condition.counters["refused_model_set"] == 1


def test_the_models_of_an_announced_set_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever a set named stayed, up to gigabytes, until the set was whole."""
    core, own = ready(), sum(map(set_aside.size_of_model, site().regions))
    others = [_other(number) for number in range(10)]
    one = set_aside.size_of_model(RegionModel.from_message(others[0]))
    monkeypatch.setattr(set_aside, "MOST_SET_BYTES", own + 5 * one)
    monkeypatch.setattr(set_aside, "MOST", 3)
    core.handle(Envelope(MODEL_SET, {"site": "s"}, _announcing(*(other.version for other in others))))
    for other in others:
        core.handle(Envelope(MODEL, {"site": "s", "region": other.region}, other))
    condition = core.condition()
    assert condition.status == Health.STATUS_DEGRADED
    assert "GB of memory" in condition.detail
    assert condition.counters["set_aside_model"] == 7
    assert set(core._assembler._models) == {
        *(model.version for model in site().regions),
        *(other.version for other in others[-3:]),
    }


def test_models_that_a_set_names_are_kept_where_those_of_the_last_one_go(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(set_aside, "MOST", 2)
    assembler, others = ModelSetAssembler(), [_other(number) for number in range(4)]
    assembler.put_set(_announcing(*(other.version for other in others[:2])))
    for other in others:
        assembler.put_model(other)
    assembler.put_set(_announcing(*(other.version for other in others[2:])))
    assert len(assembler._models) == 4
    assert assembler.set_aside == 0


def test_what_is_held_is_not_summed_again_at_each_model(monkeypatch: pytest.MonkeyPatch) -> None:
    """4,096 models cost 8 million sums."""
    asked: list[int] = []

    def size(_: RegionModel) -> int:
        asked.append(1)
        return 1

    monkeypatch.setattr(model_set_assembler, "size_of_model", size)
    assembler = ModelSetAssembler()
    for number in range(10):
        assembler.put_model(_other(number))
    assert len(asked) == 10


@pytest.mark.parametrize(("field", "value"), [("mean", 3e38), ("mean", -1e20), ("total_variance", 3e38)])
def test_an_eigenspace_of_no_ranges_is_refused(field: str, value: float) -> None:
    """Its lists were empty, and health was OK."""
    message = space_to_message(site().regions[0].space)
    if field == "mean":
        message.mean[:] = [value] * len(message.mean)
    else:
        message.total_variance = value
    with pytest.raises(ValueError, match="no ranges"):
        space_from_message(message)


def test_an_eigenspace_with_a_cap_that_no_range_has_is_refused() -> None:
    """Its square was an OverflowError."""
    message = space_to_message(site().regions[0].space)
    message.cap = 1e200
    with pytest.raises(ValueError, match="give metres above 0"):
        space_from_message(message)
