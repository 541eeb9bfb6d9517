"""What is compiled before the first scan is what a scan needs."""

import subprocess
import sys

import numpy as np
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.warm_up import warm_up

from tests.services.projector.office import free_poses, ready, receive, scan_at


def test_both_scans_are_answered() -> None:
    # hypotheses and obstacles of each
    assert warm_up(ProjectorSettings()) == 4


def test_a_real_scan_compiles_nothing_more() -> None:
    # in a process of its own: other tests have compiled much
    ran = subprocess.run([sys.executable, "-m", __name__], capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stdout + ran.stderr


def _compiled() -> dict[str, int]:
    """Signatures of each compiled function of the projector."""
    return {
        f"{module}.{name}": len(value.signatures)
        for module, content in list(sys.modules.items())
        if module.startswith("eigenscan.projector.")
        for name, value in vars(content).items()
        if hasattr(value, "signatures")
    }


def _check() -> None:
    from tests.services.projector.office import site

    built = site(0.25)
    warm_up(ProjectorSettings())
    before = _compiled()
    core = ready(built)
    for i, truth in enumerate(free_poses(4, 1)):
        receive(core, scan_at(truth, field_of_view=np.deg2rad(90.0 * (i + 1)), seed=i))
    more = sorted(name for name, count in _compiled().items() if count > before.get(name, 0))
    assert before
    assert not more, f"compiled at a scan: {', '.join(more)}"


if __name__ == "__main__":
    _check()
