"""Sweep, verification, thinning, refinement and likelihood against plain loops."""

from dataclasses import replace

import numpy as np
import pytest
from eigenscan.eigenspace.analysis import ANALYSIS_TURN
from eigenscan.eigenspace.folder import SiteModel
from eigenscan.geometry.circle import TURN
from eigenscan.geometry.distance_field import DistanceField
from eigenscan.geometry.gridmap import FREE, OCCUPIED, GridMap
from eigenscan.geometry.pose import compose, inverse, transform
from eigenscan.geometry.raycast import RayCaster
from eigenscan.mapbuilder.site import Plan, build_site
from eigenscan.projector.association.manifold import Sheets
from eigenscan.projector.association.sweep import SweepTable
from eigenscan.projector.connectivity import best_of_neighbourhoods, lattice_poses
from eigenscan.projector.intervals import leaving
from eigenscan.projector.lattice import Lattice
from eigenscan.projector.likelihood import Exactness
from eigenscan.projector.observation import by_reach, observe
from eigenscan.projector.projection import find_candidates, project
from eigenscan.projector.refinement import POLISH, SLIDE, fit
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.subspaces import SeenPart
from eigenscan.projector.verification import cap, find_overshot, grid_of, predicted, verify
from eigenscan.projector.wall_field import WallField
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.services.projector.office import (
    Array,
    free_poses,
    is_right,
    office,
    poses_of,
    ready,
    receive,
    scan_at,
    site,
)
from tests.services.projector.steps import beyond_walls, clearance, support

# written out, not taken from what is tested: a change there must show here
UNLIKE = 0.5
RANGE_CAP = 10.0
OVERSHOT_M = 0.5


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**16), st.integers(1, 3), st.integers(1, 40))
def test_the_sweep_finds_the_nearest_of_all_regions(seed: int, regions: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    # whole numbers up to the largest: packing into bytes loses nothing
    tables = [
        rng.integers(-127, 128, size=(int(rng.integers(1, 90)), 4)).astype(np.float32) for _ in range(regions)
    ]
    tables[0][0] = 127.0
    alphas = rng.normal(0, 60, size=(regions, 4))
    residuals = rng.uniform(0, 4000, regions)
    sheets = [Sheets(t[:, None], np.zeros((len(t), 2)), np.zeros((len(t), 2), int)) for t in tables]
    found = SweepTable.of(sheets).nearest(alphas, residuals, count)
    found = found.best(count)
    rows, square = found.rows, found.squares
    direct = np.concatenate(
        [((t - a) ** 2).sum(axis=1) + e for t, a, e in zip(tables, alphas, residuals, strict=True)]
    )
    nearest = np.sort(direct)[:count]
    assert len(rows) == len(nearest)
    assert np.allclose(square, nearest, rtol=1e-4)
    assert np.allclose(direct[rows], nearest, rtol=1e-4)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**16), st.integers(1, 3), st.integers(1, 40), st.integers(3, 12))
def test_the_sweep_finds_those_nearest_in_the_beams_seen(
    seed: int, regions: int, count: int, beams: int
) -> None:
    rng = np.random.default_rng(seed)
    tables = [
        rng.integers(-127, 128, size=(int(rng.integers(1, 90)), 4)).astype(np.float32) for _ in range(regions)
    ]
    tables[0][0] = 127.0
    # four orthonormal vectors over twelve beams, of which some are seen
    vectors = [np.linalg.qr(rng.normal(size=(12, 4)))[0][:beams] for _ in range(regions)]
    scans = rng.normal(0, 60, size=(regions, beams))
    part = SeenPart(
        np.array([s @ s for s in scans]),
        np.array([v.T @ s for v, s in zip(vectors, scans, strict=True)]),
        np.array([v.T @ v for v in vectors]),
    )
    searched = rng.random(regions) < 0.7
    searched[0] = True
    lacking = 1.0 - beams / 12.0
    sheets = [Sheets(t[:, None], np.zeros((len(t), 2)), np.zeros((len(t), 2), int)) for t in tables]
    found = SweepTable.of(sheets).nearest_to_part(part, searched, lacking, count).best(count)
    direct = np.concatenate(
        [
            ((s - t @ v.T) ** 2).sum(axis=1) if of else np.full(len(t), np.inf)
            for t, v, s, of in zip(tables, vectors, scans, searched, strict=True)
        ]
    )
    nearest = np.sort(direct[np.isfinite(direct)])[:count]
    assert len(found.rows) == len(nearest)
    # what holds coefficients that no beam shows is small against what a beam shows
    assert np.allclose(direct[found.rows], nearest, rtol=1e-2, atol=20.0)
    assert np.allclose(found.squares * (1.0 - lacking), direct[found.rows], rtol=1e-2, atol=20.0)


def test_a_scan_that_reaches_only_near_walls_is_found() -> None:
    core, listed = ready(), 0
    for i, truth in enumerate(free_poses(24, 12)):
        scan = scan_at(truth, seed=i)
        near = [r if r < 2.5 else np.inf for r in scan.ranges]
        scan.ranges[:] = near
        message, _ = receive(core, scan)
        listed += bool(is_right(poses_of(message), truth).any())
    assert listed >= 20


def test_opening_the_nearest_blocks_loses_few_of_the_nearest_poses() -> None:
    core = ready()
    built = core._site
    assert built is not None
    view = built.view(observe(scan_at(free_poses(1, 0)[0])).sensor).complete()
    table = view.association
    assert isinstance(table, SweepTable)
    everything = replace(table, opened=1e6)
    recall, nearest = [], []
    for i, truth in enumerate(free_poses(30, 12)):
        seen = observe(scan_at(truth, seed=i))
        projected = project(view, seen, seen.used)
        square = projected.error_energy**2 * 2 * len(seen.coarse)
        some = table.nearest(projected.coefficients, square, 300).rows
        every = everything.nearest(projected.coefficients, square, 300).rows
        recall.append(np.isin(every, some).mean())
        nearest.append(np.isin(every[:30], some).mean())
    assert np.mean(recall) > 0.95
    assert np.mean(nearest) > 0.97


def test_verification_is_truncated_l1_of_the_best_neighbour() -> None:
    lattice = Lattice.of(site(0.25).regions)
    truth = free_poses(1, 3)[0]
    seen = observe(scan_at(truth))
    thick = lattice.panoramas + np.float32(0.3)
    windows, leaves = (predicted(ranges, len(seen.coarse), 30.0) for ranges in (lattice.panoramas, thick))
    rng = np.random.default_rng(0)
    position = rng.integers(0, len(lattice.positions), 50)
    heading = rng.integers(0, ANALYSIS_TURN, 50)
    found_position, found_heading, cost = verify(
        windows, leaves, lattice, position, heading, seen.coarse, 30.0, 50
    )

    used = np.isfinite(seen.coarse)

    def direct(p: int, k: int) -> float:
        along = (k + np.arange(len(seen.coarse))) % ANALYSIS_TURN
        enter, leave = (np.minimum(ranges[p, along], RANGE_CAP) for ranges in (lattice.panoramas, thick))
        ends = np.minimum(seen.coarse, RANGE_CAP)
        off = np.where(ends > leave, np.minimum(ends - leave, UNLIKE), 0.0)
        off = np.where(ends < enter, np.minimum(enter - ends, UNLIKE), off)
        reach = np.sqrt(np.minimum(seen.coarse[used], RANGE_CAP))
        return float((off[used] * reach).sum() / reach.sum())

    for i in range(50):
        turned = min(
            ((direct(position[i], heading[i] + step), step) for step in (0, -1, 1)), key=lambda t: t[0]
        )
        around = lattice.neighbours[position[i]]
        all_of_them = [
            direct(p, heading[i] + turned[1] + step) for p in around[around >= 0] for step in (-1, 0, 1)
        ]
        # ranges are whole numbers of half a millimetre
        assert np.isclose(cost[i], min(*all_of_them, turned[0]), atol=2.5e-4)
        assert np.isclose(cost[i], direct(found_position[i], found_heading[i]), atol=2.5e-4)


@pytest.mark.parametrize(("beams", "range_max", "cap"), [(7, 0.0, 10.0), (91, 5.6, 5.6), (180, 30.0, 10.0)])
def test_a_window_from_any_direction_on_is_a_stretch_of_the_predicted_scans(
    beams: int, range_max: float, cap: float
) -> None:
    panoramas = np.random.default_rng(3).uniform(0.0, 15.0, (4, ANALYSIS_TURN)).astype(np.float32)
    panoramas[panoramas > 14.0] = np.inf
    shown = predicted(panoramas, beams, range_max)
    for first in (0, 1, ANALYSIS_TURN - 1, ANALYSIS_TURN + 1):
        window = panoramas[:, (first + np.arange(beams)) % ANALYSIS_TURN]
        found = shown[:, first : first + beams] * 0.0005
        assert np.abs(found - np.minimum(window, cap)).max() <= 0.00025 + 1e-6


def test_lattice_keeps_shared_positions_once_and_searches_every_place() -> None:
    models = site(0.25).regions
    lattice = Lattice.of(models)
    assert len(np.unique(np.round(lattice.positions, 4), axis=0)) == len(lattice.positions)
    for model, own, searched in zip(models, lattice.regions, lattice.searched, strict=True):
        assert np.allclose(lattice.positions[own], model.positions)
        away = lattice.positions[own][:, None] - lattice.positions[searched][None]
        # every position has a searched one in its own block of half a metre
        assert np.abs(away).max(axis=2).min(axis=1).max() <= 0.5 - 1e-6 + 0.25
    step = lattice.positions[lattice.neighbours[:, 5]] - lattice.positions
    there = lattice.neighbours[:, 5] >= 0
    assert np.allclose(step[there], [0.0, 0.25])


@pytest.mark.parametrize("spacing", [0.25, 0.5])
def test_the_nearest_position_is_found_beside_walls_and_off_the_map(spacing: float) -> None:
    lattice = Lattice.of(site(spacing).regions)
    low, high = lattice.positions.min(axis=0), lattice.positions.max(axis=0)
    points = np.random.default_rng(7).uniform(low - 5.0, high + 5.0, (300, 2))
    away = np.linalg.norm(lattice.positions[None] - points[:, None], axis=2)
    found = lattice.nearest(points)
    assert np.array_equal(away[np.arange(len(points)), found], away.min(axis=1))


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**16), st.integers(1, 12))
def test_thinning_keeps_the_best_of_each_neighbourhood(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    poses = np.column_stack([rng.uniform(0, 2, (40, 2)), rng.uniform(-np.pi, np.pi, 40)])
    order = rng.permutation(40)
    kept: list[int] = []
    for i in order:
        turn = np.abs((poses[kept, 2] - poses[i, 2] + np.pi) % (2 * np.pi) - np.pi)
        near = (np.hypot(*(poses[kept, :2] - poses[i, :2]).T) <= 0.5) & (turn <= 0.4)
        if len(kept) < count and not near.any():
            kept.append(int(i))
    assert best_of_neighbourhoods(poses, order, 0.5, 0.4, count).tolist() == kept


def test_lattice_poses_look_along_their_windows() -> None:
    poses = lattice_poses(np.array([[1.0, 2.0]]), np.array([0, 0]), np.array([0, 45]), 180, -np.pi / 2)
    assert np.allclose(poses, [[1.0, 2.0, np.pi / 2], [1.0, 2.0, -np.pi]])


def test_refinement_goes_home_from_half_a_grid_step() -> None:
    field = DistanceField.of(office())
    coarse, fine = WallField.of(field, 0.1), WallField.of(field)
    errors = []
    for i, truth in enumerate(free_poses(30, 5)):
        points = observe(scan_at(truth, seed=i)).points
        start = truth + np.random.default_rng(i).uniform(-1, 1, 3) * [0.2, 0.2, 0.05]
        slid = fit(coarse, start[None], points, SLIDE)
        home = fit(fine, slid.poses, points, POLISH)
        errors.append(np.abs(home.poses[0] - truth))
    # within a cell of the map
    assert np.median(errors, axis=0).max() < 0.05
    assert np.mean(np.max(errors, axis=1) < 0.12) >= 0.9


def test_a_turned_map_turns_the_refined_pose_and_its_information() -> None:
    grid = office()
    shift = np.array([2.0, -1.0, 0.7])
    turned = GridMap(grid.cells, grid.resolution, compose(shift, grid.origin))
    truth = free_poses(1, 8)[0]
    points = observe(scan_at(truth)).points
    start = truth + np.array([0.1, -0.05, 0.03])
    plain = fit(WallField.of(DistanceField.of(grid)), start[None], points, POLISH)
    other = fit(WallField.of(DistanceField.of(turned)), compose(shift, start)[None], points, POLISH)
    assert np.allclose(compose(inverse(shift), other.poses), plain.poses, atol=1e-4)
    cos, sin = np.cos(shift[2]), np.sin(shift[2])
    R = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    assert np.allclose(R.T @ other.information[0] @ R, plain.information[0], rtol=1e-2, atol=0.5)


def test_support_counts_walls_and_beams_through_them() -> None:
    grid = office()
    field = WallField.of(DistanceField.of(grid))
    caster = RayCaster.of(grid)
    truth = free_poses(1, 11)[0]
    seen = observe(scan_at(truth, noise=0.0))
    used = seen.used
    z, bearings = seen.coarse[used], seen.bearings[used]

    def of(pose: np.ndarray, ranges: np.ndarray) -> tuple[float, float]:
        ends = ranges.astype(np.float32)
        clear = clearance(field, pose[None], bearings, caster.cast(pose, bearings, 40.0), ends)
        mean, explained = support(field, pose[None], bearings, ends, beyond_walls(clear))
        return float(mean[0]), float(explained[0])

    full, explained = of(truth, z)
    assert full > 0.9
    assert explained > 0.95
    shorter, _ = of(truth, np.where(np.arange(len(z)) % 2, z, 0.3))
    longer, _ = of(truth, np.where(np.arange(len(z)) % 2, z, z + 1.0))
    # something in front of every other beam takes its support; a wall that is not there speaks against
    assert 0.4 < shorter < 0.75
    assert longer < shorter - 0.2


@pytest.mark.parametrize(("inexactness", "sure"), [(0.0, 1.0), (0.05, 0.5), (0.15, 0.1)])
def test_a_map_is_as_sure_of_its_walls_as_they_are_exact(inexactness: float, sure: float) -> None:
    assert Exactness.of(inexactness).sure == pytest.approx(sure)


@pytest.mark.parametrize("inexactness", [0.0, 0.05, 0.15])
def test_by_chance_an_end_point_lacks_as_much_in_any_map(inexactness: float) -> None:
    distance = np.linspace(0.0, 1.0, 10_001)
    lacking = []
    for exactness in (Exactness.of(0.0), Exactness.of(inexactness)):
        counts = exactness.scale**2 / (exactness.scale**2 + distance**2)
        lacking.append(exactness.gain * np.mean(1.0 - counts))
    assert lacking[1] == pytest.approx(lacking[0], rel=1e-3)


def test_many_beams_on_one_near_thing_show_little_more_than_one() -> None:
    weight = by_reach(np.array([0.5, 8.0]))
    assert np.isclose(weight.mean(), 1.0)
    # half-way between beams, which count alike, and lengths of wall, of which the far beam sees 16 times more
    assert np.isclose(weight[1] / weight[0], 4.0)


def test_by_the_nearest_panorama_beams_go_through_walls_that_it_shows() -> None:
    lattice = Lattice.of(site(0.25).regions)
    truth = free_poses(20, 12)
    sensor = observe(scan_at(truth[0])).sensor
    beams = np.arange(0, 90, 7)
    leaves = predicted(lattice.panoramas, 91, 0.0)
    apart = np.linalg.norm(lattice.positions[None] - truth[:, None, :2], axis=2)
    nearest = apart.argmin(axis=1)
    # from a neighbour of the nearest position the nearest one is found
    around = lattice.neighbours[nearest]
    home = np.where(around[:, 1] < 0, nearest, around[:, 1])
    heading = np.rint((truth[:, 2] + sensor.angle_min) / (TURN / ANALYSIS_TURN)).astype(int)
    wall = lattice.panoramas[nearest[:, None], (heading[:, None] + beams) % ANALYSIS_TURN]
    seen = np.linspace(2.0, 8.0, len(beams), dtype=np.float32)
    found = np.empty((len(truth), len(beams)), dtype=np.float32)
    find_overshot(leaves, grid_of(lattice), home, truth, sensor.angle_min, beams, seen, cap(0.0), found)
    through = (wall < RANGE_CAP) & (seen > wall + np.float32(OVERSHOT_M))
    assert 0.05 < through.mean() < 0.95
    assert np.array_equal(found, through.astype(np.float32))


def corridor() -> GridMap:
    """10 m by 2 m of free ground between walls 0.4 m thick, and free ground again behind the upper one."""
    cells = np.full((48, 108), OCCUPIED, dtype=np.uint8)
    cells[4:24, 4:104] = FREE
    cells[28:44, 4:104] = FREE
    return GridMap(cells, 0.1, np.zeros(3))


def test_a_beam_leaves_a_wall_where_it_is_out_of_what_is_drawn() -> None:
    grid = corridor()
    field = WallField.of(DistanceField.of(grid))
    at = np.array([[5.05, 1.45]])
    entered = RayCaster.of(grid).panoramas(at, 8, 20.0)
    left = leaving(field, at, entered, 20.0)
    straight, slanted = 2, 1  # 90 and 45 degrees
    assert np.isclose(entered[0, straight], 0.95, atol=0.01)
    assert np.isclose(left[0, straight], 1.35, atol=0.06)
    # slanted, a wall is longer by itself
    assert np.isclose(left[0, slanted], 1.35 * np.sqrt(2), atol=0.09)
    # the wall below is the map's last: behind it nothing is known
    assert left[0, 6] < np.inf
    assert np.isinf(leaving(field, at, entered, 1.2)[0, straight])


def test_a_beam_that_ends_in_its_wall_or_along_it_is_not_clear_of_it() -> None:
    grid = corridor()
    field, caster = WallField.of(DistanceField.of(grid)), RayCaster.of(grid)
    pose = np.array([[2.05, 1.45, 0.0]])
    bearings = np.deg2rad([90.0, 90.0, 90.0, 8.0, 20.0])
    seen = np.array([0.9, 1.3, 2.2, 8.2, 6.0], dtype=np.float32)
    clear = clearance(field, pose, bearings, caster.cast(pose, bearings, 40.0), seen)[0]
    # before the wall; within it; well behind it; metres along it; through it at a slant into the next room
    assert clear[0] == 0.0
    assert clear[1] == 0.0
    assert clear[2] >= 0.5
    assert clear[3] < 0.05
    assert clear[4] >= 0.4
    sure = beyond_walls(clear)
    assert sure[1] == 0.0
    assert sure[2] > 0.9


def candidates_verified(built: SiteModel) -> int:
    core, grid = ready(built), built.grid
    assert core._site is not None
    seen = observe(scan_at(free_poses(1, 7, grid)[0], grid=grid))
    counts: dict[str, int] = {}

    def note(stage: str, poses: Array) -> None:
        counts[stage] = len(poses)

    find_candidates(core._site, core._site.view(seen.sensor), seen, ProjectorSettings(), note)
    return counts["verified"]


@pytest.mark.parametrize(("published", "least"), [(5, 5), (30, 30), (100, 60)])
def test_as_many_hypotheses_as_are_asked_for_are_published(published: int, least: int) -> None:
    """Where the building has so many places."""
    core, grid = ready(), office()
    built = core._site
    assert built is not None
    seen = observe(scan_at(free_poses(1, 7, grid)[0], grid=grid))
    found = find_candidates(built, built.view(seen.sensor), seen, ProjectorSettings(published=published))
    assert least <= len(found.poses) <= published
    assert found.cut == (len(found.poses) == published)


def test_what_fits_best_by_ranges_or_by_end_points_is_refined() -> None:
    core = ready()
    built = core._site
    assert built is not None
    field = DistanceField.of(office())
    for i, truth in enumerate(free_poses(5, 21)):
        seen = observe(scan_at(truth, seed=i))
        stages: dict[str, Array] = {}
        find_candidates(
            built, built.view(seen.sensor).complete(), seen, ProjectorSettings(), stages.__setitem__
        )
        off = [np.minimum(field.at(transform(pose, seen.points))[0], 1.0) for pose in stages["associated"]]
        reach = np.sqrt(np.hypot(*seen.points.T))
        cost = np.array([(d**2 / (0.25 + d**2) * reach).sum() / reach.sum() for d in off])
        kept = [tuple(pose) for pose in stages["verified"]]
        for pose in stages["associated"][np.argsort(cost)[:20]]:
            near = [np.hypot(*(pose[:2] - other[:2])) <= 0.4 for other in kept]
            assert any(near)


def test_a_large_site_keeps_more_candidates_for_more_places_look_alike() -> None:
    """A hundred rooms of one size, 1,600 m2 of them, each with a cupboard elsewhere."""
    cells = np.full((430, 430), FREE, dtype=np.uint8)
    cells[::42], cells[:, ::42] = OCCUPIED, OCCUPIED
    cells[21::42], cells[:, 21::42] = FREE, FREE  # doors
    rng = np.random.default_rng(5)
    for room in np.ndindex(10, 10):
        row, column = np.array(room) * 42 + rng.integers(4, 34, 2)
        cells[row : row + 4, column : column + 4] = OCCUPIED
    rooms = build_site(GridMap(cells, 0.1, np.zeros(3)), Plan(spacing=0.5))
    assert candidates_verified(site()) <= 200 < candidates_verified(rooms)
