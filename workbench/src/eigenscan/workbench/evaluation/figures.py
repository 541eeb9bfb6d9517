"""The figures of an evaluation as JSON values: a missing figure is None."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from eigenscan.schemas.tracking_pb2 import STATE_AMBIGUOUS, STATE_LOST
from eigenscan.tracker.settings import TrackerSettings
from eigenscan.workbench.evaluation.consistency import consistency
from eigenscan.workbench.evaluation.frames import other_frame
from eigenscan.workbench.evaluation.kidnap import Outcome
from eigenscan.workbench.evaluation.metrics import (
    Judged,
    calibration,
    calibration_error,
    errors,
    normalised_errors,
    rate,
    right,
    seconds,
    summary,
)
from eigenscan.workbench.evaluation.reference import NS
from eigenscan.workbench.evaluation.windows import Window
from numpy.typing import NDArray

Figures = dict[str, Any]


def finite(figures: Figures) -> Figures:
    """The same without numbers that JSON does not have: they are None."""
    plain: Figures = _finite(figures)
    return plain


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _finite(inner) for name, inner in value.items()}
    if isinstance(value, list):
        return [_finite(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def window_row(window: Window, judged: Judged, cpu_ms: NDArray[np.float64]) -> Figures:
    """Results of one window: its verdict, when it converged, and its errors."""
    stream, found = judged.stream, judged.converged
    first = next(iter(np.flatnonzero(judged.right_claims).tolist()), None)
    wrong = np.flatnonzero(judged.false_claims)
    return {
        "start": window.start / NS,
        "end": window.end / NS,
        "scans": len(cpu_ms),
        "judged": len(stream),
        "metres": float(judged.metres[-1] - judged.metres[0]) if len(stream) else 0.0,
        "success": found is not None,
        "false_claims": len(wrong),
        "false_claim_stamps": (stream.stamps[wrong[:5]] / NS).tolist(),
        "localized_share": rate(stream.localized),
        "ambiguous_share": rate(stream.states == STATE_AMBIGUOUS),
        "lost_share": rate(stream.states == STATE_LOST),
        "right_share": rate(judged.right),
        "first_right_claim": _reached(judged, window, first),
        "to_localize": _reached(judged, window, found),
        "error": _errors(judged, found),
        "worst": _worst(judged, found),
        "last": _last(judged),
        "cpu_ms_per_scan": summary(cpu_ms, 99),
    }


def _reached(judged: Judged, window: Window, found: int | None) -> Figures | None:
    """Time, distance and scans until row `found`."""
    if found is None:
        return None
    stream = judged.stream
    return {
        "scans": int(stream.scans[found]),
        "metres": float(judged.metres[found] - judged.metres[0]),
        "seconds": float(seconds(stream.stamps[found : found + 1], window.start)[0]),
        "cpu_s": float(stream.cpu_s[found]),
    }


def _errors(judged: Judged, found: int | None) -> Figures | None:
    if found is None:
        return None
    return {
        "position_m": summary(judged.position_m[found:]),
        "heading_deg": summary(np.degrees(judged.heading_rad[found:])),
    }


def _worst(judged: Judged, found: int | None) -> Figures | None:
    if found is None:
        return None
    index = found + int(np.argmax(judged.position_m[found:]))
    return {
        "time": float(judged.stream.stamps[index] / NS),
        "position_m": float(judged.position_m[index]),
        "heading_deg": float(np.degrees(judged.heading_rad[index])),
    }


def _last(judged: Judged) -> Figures | None:
    if not len(judged.stream):
        return None
    return {
        "position_m": float(judged.position_m[-1]),
        "heading_deg": float(np.degrees(judged.heading_rad[-1])),
        "state": int(judged.stream.states[-1]),
        "confidence": float(judged.stream.confidence[-1]),
    }


def windows_figures(judged: Sequence[Judged], rows: Sequence[Figures]) -> Figures:
    """The figures over all windows.

    Errors count from a window's convergence, confidence wherever there is a pose.
    """
    converged = [(j, j.converged) for j in judged]
    settled = [(j, slice(found, None)) for j, found in converged if found is not None]
    position = np.concatenate([np.empty(0), *(j.position_m[after] for j, after in settled)])
    heading = np.concatenate([np.empty(0), *(j.heading_rad[after] for j, after in settled)])
    nees = np.concatenate(
        [np.empty(0), *(normalised_errors(j.offsets[s], j.stream.covariances[s]) for j, s in settled)]
    )
    way = np.concatenate([np.empty(0), *(j.metres[after] for j, after in settled)])
    nis = np.concatenate([np.empty(0), *(j.stream.nis[after] for j, after in settled)])
    given = [(j, j.stream.tracked) for j in judged]
    diagram = calibration(
        np.concatenate([np.empty(0), *(j.stream.confidence[tracked] for j, tracked in given)]),
        np.concatenate([np.empty(0, dtype=np.bool_), *(j.right[tracked] for j, tracked in given)]),
    )
    claims = sum(int(j.stream.localized.sum()) for j in judged)
    return {
        "windows": len(rows),
        "success_rate": rate([row["success"] for row in rows]),
        "false_claim_rate": rate([row["false_claims"] > 0 for row in rows]),
        "false_share_of_claims": sum(row["false_claims"] for row in rows) / claims if claims else None,
        "elsewhere_share_of_claims": (
            sum(int(j.elsewhere_claims.sum()) for j in judged) / claims if claims else None
        ),
        "reference_frame": other_frame(judged),
        "right_claim_rate": rate([row["first_right_claim"] is not None for row in rows]),
        "to_localize": _all_reached(rows, "to_localize"),
        "first_right_claim": _all_reached(rows, "first_right_claim"),
        "error": {"position_m": summary(position), "heading_deg": summary(np.degrees(heading))},
        "normalised_error_squared": _normalised(nees, way),
        "normalised_innovation_squared": _normalised(nis, way),
        "calibration_error": calibration_error(diagram),
        "calibration": [vars(entry) for entry in diagram],
    }


def _all_reached(rows: Sequence[Figures], what: str) -> Figures:
    """Median and 95th percentile over the windows that reached `what`."""
    reached = [row[what] for row in rows if row[what]]
    return {name: summary(row[name] for row in reached) for name in ("scans", "metres", "seconds", "cpu_s")}


def _normalised(squares: NDArray[np.float64], way: NDArray[np.float64]) -> Figures:
    """Tests normalised squares (n,) at distances (n,), m: their size, and the size expected."""
    sound = squares[np.isfinite(squares)]
    return summary(sound) | {
        "mean": float(sound.mean()) if len(sound) else None,
        "consistency": vars(consistency(squares, way, TrackerSettings().independence_m)),
    }


def kidnap_figures(outcomes: Sequence[Outcome]) -> Figures:
    """How soon kidnaps were noticed and the robot found again."""
    return {
        "noticed_s": summary(outcome.noticed_s for outcome in outcomes),
        "recovered_s": summary(outcome.recovered_s for outcome in outcomes),
        "first_right_s": summary(outcome.first_right_s for outcome in outcomes),
        "first_right_within_3_s": rate([_is_soon(o.first_right_s) for o in outcomes]),
        "recovered_rate": rate([outcome.recovered_s is not None for outcome in outcomes]),
        "kidnaps": len(outcomes),
        "claimed_before": sum(outcome.claimed_before for outcome in outcomes),
        "noticed_within_1_s": rate(
            [o.noticed_s is not None and o.noticed_s <= 1.0 for o in outcomes if o.claimed_before]
        ),
        "recovered_within_3_s": rate([_is_soon(o.recovered_s) for o in outcomes]),
        "decided": sum(outcome.decided is True for outcome in outcomes),
        "recovered_within_3_s_of_decided": rate([_is_soon(o.recovered_s) for o in outcomes if o.decided]),
        "per_kidnap": [vars(outcome) for outcome in outcomes],
    }


def _is_soon(seconds: float | None) -> bool:
    return seconds is not None and seconds <= 3.0


def single_figures(rows: Sequence[Figures]) -> Figures:
    """Success of one scan alone, and of the exhaustive comparison of the same scans."""
    searched = [row for row in rows if row["exhaustive"] is not None]
    return {
        "n": len(rows),
        "top1": rate([row["top1"] for row in rows]),
        "in_list": rate([row["in_list"] for row in rows]),
        "list_length": float(np.mean([row["list_length"] for row in rows])) if rows else None,
        "cpu_ms": summary((row["cpu_ms"] for row in rows), 99),
        "error_of_right": {
            "position_m": summary(row["position_m"] for row in rows if row["top1"]),
            "heading_deg": summary(row["heading_deg"] for row in rows if row["top1"]),
        },
        "exhaustive_n": len(searched),
        "exhaustive_top1": rate([row["exhaustive"] for row in searched]),
        "exhaustive_cpu_ms": summary((row["exhaustive_cpu_ms"] for row in searched), 99),
        "per_scan": list(rows),
    }


def single_row(
    time_s: float, lidar: str, poses: NDArray[np.float64], truth: NDArray[np.float64], cpu_ms: float
) -> Figures:
    """One scan's answer beside the truth (3,); `poses` (n, 3), most likely first."""
    position, heading = errors(poses, np.broadcast_to(truth, poses.shape))
    hits = np.flatnonzero(right(position, heading))
    return {
        "time": time_s,
        "lidar": lidar,
        "top1": bool(len(hits) and hits[0] == 0),
        "in_list": bool(len(hits)),
        "rank": int(hits[0]) if len(hits) else None,
        "list_length": len(poses),
        "position_m": float(position[0]) if len(poses) else None,
        "heading_deg": float(np.degrees(heading[0])) if len(poses) else None,
        "cpu_ms": cpu_ms,
        "exhaustive": None,
        "exhaustive_cpu_ms": None,
    }
