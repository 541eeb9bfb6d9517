import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from eigenscan.eigenspace.floors import Floor
from eigenscan.eigenspace.folder import SiteModel, read_models, write_models
from eigenscan.eigenspace.model import ModelError
from eigenscan.eigenspace.versions import CHANGE, KEPT, choose, choose_proposal, kept_in, versions
from eigenscan.geometry.circle import TURN
from eigenscan.geometry.gridmap import OCCUPIED, GridMap
from eigenscan.mapbuilder.keeping.store import PICTURE, Store
from eigenscan.mapbuilder.site import Plan, build_site

from tests.command import eigenscan
from tests.services.mapbuilder.floorplan import box

PLAN = Plan(step=TURN / 60, spacing=1.0)


def changed(grid: GridMap, number: int) -> SiteModel:
    """The office with a cabinet somewhere else each time."""
    after = replace(grid, cells=grid.cells.copy())
    box(after, 8.0 + 0.2 * number, 4.4, 8.6 + 0.2 * number, 5.0, OCCUPIED)
    return build_site(after, PLAN)


@pytest.fixture
def store(office: GridMap, tmp_path: Path) -> Store:
    write_models(build_site(office, PLAN), tmp_path / "model")
    return Store(tmp_path / "model")


def propose(store: Store, site: SiteModel) -> str:
    store.propose(site, {"since": read_models(store.folder).to_message().version}, b"a picture")
    return site.to_message().version


def command(*arguments: object) -> subprocess.CompletedProcess[str]:
    return eigenscan("models", *arguments)


def test_what_is_in_use_is_given_once_and_again_when_it_is_another(store: Store, office: GridMap) -> None:
    first = store.renewed()
    assert first is not None
    assert store.renewed() is None
    os.utime(store.folder / "manifest.json")
    assert store.renewed() is None
    version = propose(store, changed(office, 1))
    assert store.renewed() is None
    store.accept()
    accepted = store.renewed()
    assert accepted is not None
    assert accepted.to_message().version == version
    assert store.renewed() is None


def test_a_floor_whose_own_frame_moved_is_news(store: Store, office: GridMap) -> None:
    """The set has the same version, so poses stayed in the frame that the floor had before."""
    site, outline = build_site(office, PLAN), np.array([[0, 0], [14, 0], [14, 9], [0, 9]], dtype=np.float64)
    for x in (0.0, 40.0):
        floor = Floor("ground", np.array([x, 0.0, 0.0]), outline)
        write_models(replace(site, floors=(floor,)), store.folder)
        found = store.renewed()
        assert found is not None
        assert found.floors[0].origin[0] == x


def test_a_folder_that_cannot_be_read_is_reported_once_and_read_when_it_is_mended(
    store: Store, office: GridMap
) -> None:
    assert store.renewed() is not None
    manifest = store.folder / "manifest.json"
    good = manifest.read_text()
    manifest.write_text("{")
    with pytest.raises(ModelError, match="is not JSON"):
        store.renewed()
    assert store.renewed() is None
    manifest.write_text(good)
    assert store.renewed() is not None


def test_an_operator_sees_accepts_and_takes_back_a_proposal(store: Store, office: GridMap) -> None:
    before = versions(store.folder)[0].version
    version = propose(store, changed(office, 1))
    line = command("list", store.folder).stdout.splitlines()[1]
    assert version[:12] in line
    assert f"proposed: {kept_in(store.folder) / version[:12] / PICTURE}" in line
    with pytest.raises(ModelError, match="no older version"):  # a proposal is nothing to go back to
        choose(versions(store.folder), None, store.folder)
    done = command("accept", store.folder)
    assert done.returncode == 0, done.stderr
    assert versions(store.folder)[0].version == version
    assert json.loads((store.folder / CHANGE).read_text())["since"] == before
    assert not any(v.proposed_for for v in versions(store.folder))
    assert choose(versions(store.folder), None, store.folder).version == before
    done = command("accept", store.folder)
    assert done.returncode == 2
    assert "no change is proposed" in done.stderr


def test_a_proposal_for_another_version_is_refused(store: Store, office: GridMap) -> None:
    version = propose(store, changed(office, 1))
    write_models(changed(office, 2), store.folder)
    with pytest.raises(ModelError, match="wait for a new proposal"):
        choose_proposal(versions(store.folder), version[:8], store.folder)


def test_there_is_one_proposal_and_it_is_never_in_the_way_of_those_kept(
    store: Store, office: GridMap
) -> None:
    for number in range(KEPT + 2):
        write_models(changed(office, number), store.folder)
    kept = {v.version for v in versions(store.folder)}
    newest = [propose(store, changed(office, 20 + number)) for number in range(2)][-1]
    assert {v.version for v in versions(store.folder)} == kept | {newest}
    assert choose(versions(store.folder), None, store.folder).proposed_for == ""
    store.withdraw()
    assert {v.version for v in versions(store.folder)} == kept


FOREVER = """
import sys
from pathlib import Path
from eigenscan.eigenspace.folder import read_models
from eigenscan.mapbuilder.keeping.store import Store
folder, others = Path(sys.argv[1]), [read_models(Path(name)) for name in sys.argv[2:]]
store = Store(folder)
print("ready", flush=True)
while True:
    for site in others:
        store.propose(site, {"since": read_models(folder).to_message().version}, b"a picture")
        store.accept()
"""


def test_whenever_it_is_killed_there_is_no_half_version(
    store: Store, office: GridMap, tmp_path: Path
) -> None:
    for number in (1, 2):
        write_models(changed(office, number), tmp_path / f"other{number}")
    arguments = [store.folder, tmp_path / "other1", tmp_path / "other2"]
    for after_s in (0.013, 0.041):
        process = subprocess.Popen([sys.executable, "-c", FOREVER, *arguments], stdout=subprocess.PIPE)
        assert process.stdout is not None
        assert process.stdout.readline() == b"ready\n"
        time.sleep(after_s)
        process.send_signal(signal.SIGKILL)
        process.communicate()
        for version in versions(store.folder):
            assert read_models(version.folder).to_message().version == version.version
