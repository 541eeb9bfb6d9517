"""A folder of recordings as a test suite."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from xml.etree import ElementTree

from eigenscan.runtime.errors import UsageError, by_users, one_line
from eigenscan.workbench.pool import Pool
from eigenscan.workbench.replay.casting import cast
from eigenscan.workbench.replay.comparison import Terms
from eigenscan.workbench.replay.playing import Event, Side, play
from eigenscan.workbench.replay.reference import SUFFIX, Reference, open_beside, write_beside
from eigenscan.workbench.replay.report import report, summary
from eigenscan.workbench.replay.services import ARRIVAL, CHOICES, PIPELINE, published_by
from eigenscan.workbench.replay.survey import Survey, survey
from eigenscan.workbench.replay.trial import Trial, picture, picture_beside, run

PASSED, DIFFERENT, BAD = "same", "different", "bad input"


@dataclass(frozen=True)
class Case:
    """The result for one recording and one choice of services."""

    recording: Path
    choice: str
    result: str
    line: str
    text: str = ""
    took_s: float = 0.0


@dataclass(frozen=True)
class Plan:
    """Options for every recording. Without choices, all services that a recording allows."""

    choices: tuple[str, ...] = ()
    tolerant: bool = False
    least: int = Terms.least


def recordings(folder: Path) -> list[Path]:
    """The recordings of a folder. Raises UsageError if there are none, or a reference has none."""
    if not folder.is_dir():
        raise UsageError(f"{folder}: is no folder: give one that holds recordings")
    files = sorted(folder.glob("*.mcap"))
    found = [path for path in files if not path.name.endswith(SUFFIX)]
    if not found:
        raise UsageError(f"{folder}: holds no .mcap: put recordings there")
    names = {path.stem for path in found}
    for path in files:
        if path.name.endswith(SUFFIX) and path.name.removesuffix(SUFFIX) not in names:
            raise UsageError(f"{path}: its recording is gone: remove it, or bring the recording back")
    return found


def judge(recording: Path, plan: Plan) -> Iterator[Case]:
    """A case for each choice of services. Bad input makes a case, not an exception."""
    try:
        found, reference = survey(recording), open_beside(recording)
        choices = _choices(found, reference, plan)
    except Exception as error:
        yield _bad(recording, "recording", error)
        return
    for choice in choices:
        kept = reference if reference and choice in reference.choices else None
        terms = Terms(plan.tolerant, unjudged={} if kept else ARRIVAL, least=plan.least)
        try:
            trial = Trial(CHOICES[choice], terms, reference=kept)
            outcome = run(trial, found)
        except Exception as error:
            yield _bad(recording, choice, error)
            continue
        result = DIFFERENT if outcome.comparison.problems else PASSED
        made = f"\nreference made with {kept.made_with}" if kept else ""
        text, target = report(outcome) + made, picture_beside(recording, choice)
        with suppress(OSError):  # where it cannot be written, the verdict holds without it
            if result == DIFFERENT and picture(trial, outcome, text, target):
                text += f"\nboth sides: {target}"
        yield Case(recording, choice, result, summary(outcome), text, outcome.took_s)


def update(recording: Path, plan: Plan) -> Case:
    """Makes the cores' present answers the reference of a recording."""
    try:
        found = survey(recording)
        choices = plan.choices or _spoken(found) or (PIPELINE,)
        parts: dict[str, Iterable[Event]] = {
            choice: play(found, CHOICES[choice], cast(found, CHOICES[choice], {})) for choice in choices
        }
        count = write_beside(recording, _kept(recording, choices) | parts)
    except Exception as error:
        return _bad(recording, "recording", error)
    return Case(recording, " ".join(choices), PASSED, f"{count} messages are the reference now")


def _kept(recording: Path, choices: tuple[str, ...]) -> dict[str, Iterable[Event]]:
    """The present reference's messages of services other than `choices`."""
    try:
        present = open_beside(recording)
    except ValueError:  # of another recording, or damaged: it is replaced
        return {}
    again = {channel for choice in choices for channel in published_by(CHOICES[choice])}
    others = (
        [name for name in present.choices if again.isdisjoint(published_by(CHOICES[name]))] if present else []
    )
    return (
        {name: present.words(Side.REPLAYED, published_by(CHOICES[name])) for name in others}
        if present
        else {}
    )


def _choices(found: Survey, reference: Reference | None, plan: Plan) -> tuple[str, ...]:
    kept = reference.choices if reference else ()
    choices = plan.choices or tuple(dict.fromkeys([*kept, *_spoken(found)]))
    if not choices:
        raise UsageError(f"{found.path}: holds no answers: --update keeps those of today as reference")
    return choices


def _spoken(found: Survey) -> tuple[str, ...]:
    """Services with recorded messages."""
    return tuple(
        name
        for name, services in CHOICES.items()
        if len(services) == 1 and any(found.counts[channel] for channel in services[0].outputs)
    )


def _bad(recording: Path, choice: str, error: Exception) -> Case:
    if not by_users(error):
        raise error
    return Case(recording, choice, BAD, one_line(error))


def junit(cases: Sequence[Case], name: str = "eigenscan replay-test") -> str:
    """The cases as JUnit XML, a suite called `name`."""
    root = ElementTree.Element(
        "testsuite",
        name=name,
        tests=str(len(cases)),
        failures=str(sum(case.result == DIFFERENT for case in cases)),
        errors=str(sum(case.result == BAD for case in cases)),
        time=f"{sum(case.took_s for case in cases):.3f}",
    )
    for case in cases:
        node = ElementTree.SubElement(
            root, "testcase", classname=case.recording.name, name=case.choice, time=f"{case.took_s:.3f}"
        )
        if case.result != PASSED:
            kind = "failure" if case.result == DIFFERENT else "error"
            ElementTree.SubElement(node, kind, message=case.line).text = case.text or case.line
        else:
            ElementTree.SubElement(node, "system-out").text = case.text
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def run_all(
    files: Sequence[Path], plan: Plan, published: Callable[[Case], None], jobs: int = 1
) -> list[Case]:
    """The cases of all files, `jobs` files at a time; `published` is called with each, in order."""
    cases = []
    for found in _judged(files, plan, min(jobs, len(files))):
        for case in found:
            published(case)
            cases.append(case)
    return cases


def _judged(files: Sequence[Path], plan: Plan, jobs: int) -> Iterator[Iterable[Case]]:
    if jobs <= 1:
        yield from (judge(path, plan) for path in files)
        return
    with Pool(jobs) as pool:
        yield from pool.map(partial(_all_of, plan=plan), files)


def _all_of(recording: Path, plan: Plan) -> list[Case]:
    return list(judge(recording, plan))
