//! A robot's driver in Rust, from docs/contract.md alone: publishes what the devices measure, prints the pose.
//!
//! `eigenscan-driver-rust [SITE [ROBOT [ENDPOINT]]]` reads a line for each measurement from standard input:
//!
//!     lidar ANGLE_MIN ANGLE_INCREMENT RANGE_MIN RANGE_MAX MOUNT_X MOUNT_Y MOUNT_THETA
//!     scan STAMP_NS RANGE RANGE ...
//!     odometry STAMP_NS X Y HEADING

pub mod eigenscan {
    include!(concat!(env!("OUT_DIR"), "/eigenscan.rs"));
}

pub mod foxglove {
    include!(concat!(env!("OUT_DIR"), "/foxglove.rs"));
}

use eigenscan::{Pose2, PoseEstimate, RawScan};
use foxglove::{Odometry, Pose, Quaternion, Vector3};
use prost::Message;
use prost_types::Timestamp;
use std::io::BufRead;
use zenoh::bytes::Encoding;
use zenoh::qos::Priority;
use zenoh::sample::Sample;
use zenoh::{Session, Wait};

type Anything = Box<dyn std::error::Error + Send + Sync>;

fn print_pose(sample: Sample) {
    if let Ok(estimate) = PoseEstimate::decode(&*sample.payload().to_bytes()) {
        let Pose2 { x, y, theta } = estimate.pose.unwrap_or_default();
        println!("{} {x} {y} {theta} {}", estimate.state().as_str_name(), estimate.confidence);
    }
}

fn publish(session: &Session, key: String, schema: &str, payload: Vec<u8>) -> Result<(), Anything> {
    session
        .put(key, payload)
        .encoding(Encoding::from(format!("application/protobuf;{schema}/1")))
        .priority(Priority::RealTime)
        .express(true)
        .wait()
}

fn stamp(ns: &str) -> Result<Option<Timestamp>, Anything> {
    let ns: i64 = ns.parse()?;
    Ok(Some(Timestamp { seconds: ns / 1_000_000_000, nanos: (ns % 1_000_000_000) as i32 }))
}

fn numbers(words: &[&str], count: usize) -> Result<Vec<f64>, Anything> {
    let found: Result<Vec<f64>, _> = words.iter().map(|word| word.parse()).collect();
    let found = found?;
    if found.len() < count {
        return Err(format!("{} numbers where {count} must be", found.len()).into());
    }
    Ok(found)
}

fn odometry(words: &[&str]) -> Result<Odometry, Anything> {
    let measured = numbers(words, 3)?;
    let (sin, cos) = (measured[2] / 2.0).sin_cos();
    Ok(Odometry {
        frame_id: "odom".into(),
        body_frame_id: "base_link".into(),
        pose: Some(Pose {
            position: Some(Vector3 { x: measured[0], y: measured[1], z: 0.0 }),
            orientation: Some(Quaternion { x: 0.0, y: 0.0, z: sin, w: cos }),
        }),
        ..Default::default()
    })
}

fn lidar(words: &[&str]) -> Result<RawScan, Anything> {
    let told = numbers(words, 7)?;
    Ok(RawScan {
        angle_min: told[0],
        angle_increment: told[1],
        range_min: told[2],
        range_max: told[3],
        mount: Some(Pose2 { x: told[4], y: told[5], theta: told[6] }),
        ..Default::default()
    })
}

fn main() -> Result<(), Anything> {
    let given: Vec<String> = std::env::args().skip(1).collect();
    let word = |place: usize, otherwise: &str| given.get(place).cloned().unwrap_or(otherwise.into());
    let robot = format!("{}/robot/{}", word(0, "site"), word(1, "robot"));
    let mut config = zenoh::Config::default();
    config.insert_json5("mode", r#""client""#)?;
    config.insert_json5("connect/endpoints", &format!(r#"["{}"]"#, word(2, "tcp/127.0.0.1:7448")))?;
    config.insert_json5("scouting/multicast/enabled", "false")?;
    let session = zenoh::open(config).wait()?;
    let _poses = session.declare_subscriber(format!("{robot}/pose")).callback(print_pose).wait()?;
    let mut scan = RawScan::default();
    for line in std::io::stdin().lock().lines() {
        let line = line?;
        let words: Vec<&str> = line.split_whitespace().collect();
        match words.as_slice() {
            ["lidar", told @ ..] => scan = lidar(told)?,
            ["scan", ns, ranges @ ..] => {
                scan.timestamp = stamp(ns)?;
                scan.ranges = ranges.iter().map(|word| word.parse()).collect::<Result<_, _>>()?;
                publish(&session, format!("{robot}/scan/raw/front"), "eigenscan.RawScan", scan.encode_to_vec())?;
            }
            ["odometry", ns, measured @ ..] => {
                let message = Odometry { timestamp: stamp(ns)?, ..odometry(measured)? };
                publish(&session, format!("{robot}/odom"), "foxglove.Odometry", message.encode_to_vec())?;
            }
            _ => return Err(format!("{line:?}: is no lidar, scan or odometry").into()),
        }
    }
    Ok(())
}
