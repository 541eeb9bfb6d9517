//! From the beams of a driver to the beams of the contract ("What a canonical scan is").

use crate::messages::{RawScan, Scan};
use std::f64::consts::{PI, TAU};

/// rad; no lidar has a finer step.
const SMALLEST_STEP: f64 = 1e-6;
/// m; a limit or a range beyond it is none.
const FARTHEST: f64 = 1e5;
/// Share of `range_max` from which a range is no return.
const NO_RETURN_SHARE: f64 = 0.999;
/// Late scans in a row, in order among themselves, that are a clock that was set back.
const CLOCK_STEP_SCANS: u32 = 10;

/// Why a raw scan is set aside: the name of a counter.
pub type Reason = &'static str;

/// What is remembered of one lidar.
#[derive(Default)]
pub struct Lidar {
    newest: Option<i64>,
    late: u32,
    latest_late: i64,
    published: u64,
}

impl Lidar {
    /// The canonical scan of a raw one. Errors name what it is set aside for.
    pub fn normalize(&mut self, raw: RawScan, base_frame: &str) -> Result<Scan, Reason> {
        let stamp = raw.timestamp.as_ref().map_or(0, |t| t.seconds * 1_000_000_000 + i64::from(t.nanos));
        self.check_order(stamp)?;
        let mount = raw.mount.unwrap_or_default();
        if ![mount.x, mount.y, mount.theta].iter().all(|value| value.is_finite()) {
            return Err("mount_not_finite");
        }
        let (low, high) = limits(&raw)?;
        if raw.ranges.is_empty() {
            return Err("no_beams");
        }
        let (angle_min, angle_increment, reversed) = orient(&raw)?;
        let mut ranges: Vec<f32> = raw.ranges.iter().map(|&range| limit(range, low, high)).collect();
        if ranges.iter().all(|range| range.is_nan()) {
            return Err("no_valid_range");
        }
        if reversed {
            ranges.reverse();
        }
        let sequence = self.published;
        (self.newest, self.late, self.published) = (Some(stamp), 0, sequence + 1);
        Ok(Scan {
            timestamp: raw.timestamp,
            frame_id: base_frame.into(),
            mount: Some(mount),
            angle_min,
            angle_increment,
            range_min: low,
            range_max: high,
            ranges,
            sequence,
        })
    }

    fn check_order(&mut self, stamp: i64) -> Result<(), Reason> {
        match self.newest {
            Some(newest) if stamp == newest => Err("duplicate_stamp"),
            Some(newest) if stamp < newest => {
                self.late = if self.late > 0 && stamp > self.latest_late { self.late + 1 } else { 1 };
                self.latest_late = stamp;
                if self.late < CLOCK_STEP_SCANS { Err("out_of_order") } else { Ok(()) }
            }
            _ => Ok(()),
        }
    }
}

/// Both limits, m; a maximum of 0 is not stated.
fn limits(raw: &RawScan) -> Result<(f64, f64), Reason> {
    let low = raw.range_min.max(0.0);
    let high = if raw.range_max > FARTHEST { 0.0 } else { raw.range_max };
    let make_sense = !raw.range_min.is_nan() && low < FARTHEST && high >= 0.0 && (high == 0.0 || high > low);
    if make_sense { Ok((low, high)) } else { Err("limits_inconsistent") }
}

/// First angle in [-pi, pi), a step above 0 (rad), and whether the beams have to be reversed for it.
fn orient(raw: &RawScan) -> Result<(f64, f64, bool), Reason> {
    let beams = raw.ranges.len() as f64;
    let (mut first, mut step) = (raw.angle_min, raw.angle_increment);
    if !(first.is_finite() && step.is_finite()) {
        return Err("angles_not_finite");
    }
    if step.abs() < SMALLEST_STEP {
        return Err("angle_increment_zero");
    }
    if (beams - 1.5).max(2.0) * step.abs() > TAU {
        return Err("over_a_turn");
    }
    if raw.upside_down {
        (first, step) = (-first, -step);
    }
    let reversed = step < 0.0;
    if reversed {
        (first, step) = (first + (beams - 1.0) * step, -step);
    }
    if !(-PI..PI).contains(&first) {
        first %= TAU;
        first += if first < -PI { TAU } else if first >= PI { -TAU } else { 0.0 };
    }
    Ok((first, step, reversed))
}

/// A range within the limits, or +inf (no return), or NaN (missing).
fn limit(range: f32, low: f64, high: f64) -> f32 {
    let empty_from = if high > 0.0 { NO_RETURN_SHARE * high } else { FARTHEST };
    if range.is_nan() || range < low as f32 || range <= 0.0 {
        f32::NAN
    } else if range >= empty_from as f32 {
        f32::INFINITY
    } else {
        range
    }
}
