from pathlib import Path

import numpy as np
from eigenscan.workbench.evaluation.log import read_log
from eigenscan.workbench.evaluation.reference import NS, read_trajectory
from eigenscan.workbench.logs import LogOptions


def test_a_reference_follows_the_scans_whose_stamps_were_repaired(tmp_path: Path) -> None:
    # the third line was stamped 0.5 s late; the robot drives 1 m/s
    stamps, drove = [10.0, 10.2, 10.9, 10.6, 10.8], [0.0, 0.2, 0.4, 0.6, 0.8]
    lines = [
        f"FLASER 3 1.0 2.0 3.0 {x} 0 0 {x} 0 0 {t:.6f} host 0\n" for t, x in zip(stamps, drove, strict=True)
    ]
    (tmp_path / "a.clf").write_text("".join(lines))
    rows = [f"{t:.6f} {x} 0 0 0 0 0 1\n" for t, x in zip(stamps, drove, strict=True)]
    (tmp_path / "a.tum").write_text("".join(rows))
    log = read_log(tmp_path / "a.clf", LogOptions(), lambda share: None)
    reference = read_trajectory(tmp_path / "a.tum").restamped(log.logged)
    poses, known = reference.at(log.scans)
    assert known.all()
    np.testing.assert_allclose(poses[:, 0], drove, atol=1e-9)
    np.testing.assert_allclose(log.scans / NS, [10.0, 10.2, 10.4, 10.6, 10.8], atol=1e-6)
