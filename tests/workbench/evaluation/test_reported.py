"""For how long health reports what while a log is played."""

from eigenscan.workbench.evaluation.report import _windows
from eigenscan.workbench.evaluation.reported import Reported

S = 1_000_000_000


def run(*words: str, hz: int = 10) -> Reported:
    """One word a second, looked at more often."""
    found = Reported()
    for tick in range(hz * len(words)):
        found.look(tick * S // hz, lambda tick=tick: words[tick // hz])  # type: ignore[misc]
    return found


def test_what_comes_and_goes_is_counted_by_the_second() -> None:
    figures = run("", "lidar covered", "lidar covered", "", "lidar frozen", "").figures()
    assert figures == {
        "lidar covered": {"seconds": 2.0, "runs": 1},
        "lidar frozen": {"seconds": 1.0, "runs": 1},
    }


def test_health_is_not_asked_between_two_looks() -> None:
    asked, found = list[int](), Reported()

    def words(stamp: int) -> str:
        asked.append(stamp)
        return ""

    for stamp in range(0, 2 * S, S // 100):
        found.look(stamp, lambda stamp=stamp: words(stamp))  # type: ignore[misc]
    assert asked == [0, S]


def test_a_clock_that_is_set_back_hides_no_fault() -> None:
    found = Reported()
    for stamp in (3600 * S, 3601 * S, 0, S, 2 * S):
        found.look(stamp, lambda stamp=stamp: "clock set back" if stamp < 3600 * S else "")  # type: ignore[misc]
    assert found.figures() == {"clock set back": {"seconds": 3.0, "runs": 1}}


def test_words_that_differ_in_numbers_are_one_fault_over_all_runs() -> None:
    found = Reported()
    found.add(run("scans come 0.5 s late", "scans come 2 s late", ""))
    found.add(run("scans come 11.25 s late", "odometry stands"))
    found.add(run(""))
    assert found.figures() == {
        "scans come 0.5 s late": {"seconds": 3.0, "runs": 2},
        "odometry stands": {"seconds": 1.0, "runs": 1},
    }


def test_a_share_of_all_poses_is_no_share_of_claims_by_its_heading() -> None:
    """A window whose poses were right and never claimed read as one of right claims."""
    words = {"success": "success", "right": "right", "false": "false", "off": "error"}
    headings = [str(column.header) for column in _windows([], words).columns]
    assert headings[-4:] == ["false claims", "right poses", "localized", "last error"]
