//! scan-ingest in Rust, from docs/contract.md alone: raw scans in, canonical scans out.
//!
//! Settings are in the environment: EIGENSCAN_ZENOH (JSON5 file; without it an embedded peer), EIGENSCAN_SITE,
//! EIGENSCAN_ROBOT, EIGENSCAN_INSTANCE, EIGENSCAN_BASE_FRAME.

mod normalize;

pub mod messages {
    include!(concat!(env!("OUT_DIR"), "/eigenscan.rs"));
}

use messages::{health::Status, Health, RawScan, Scan};
use normalize::Lidar;
use prost::Message;
use std::collections::{BTreeMap, HashMap};
use std::sync::{atomic::AtomicBool, atomic::Ordering::Relaxed, Arc};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};
use zenoh::bytes::Encoding;
use zenoh::handlers::RingChannel;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::sample::{Sample, SampleKind};
use zenoh::{Session, Wait};

type Anything = Box<dyn std::error::Error + Send + Sync>;

const RAW_SCAN: &str = "application/protobuf;eigenscan.RawScan/1";
const SCAN: &str = "application/protobuf;eigenscan.Scan/1";
const HEALTH: &str = "application/protobuf;eigenscan.Health/1";
/// Encodings that leave the schema to the key.
const UNDECLARED: [&str; 4] = ["", "zenoh/bytes", "application/octet-stream", "application/protobuf"];
const WAITING_SCANS: usize = 64;
const MOST_LIDARS: usize = 4096;

struct Settings {
    site: String,
    robot: String,
    instance: String,
    base_frame: String,
}

fn setting(name: &str, default: &str) -> String {
    std::env::var(format!("EIGENSCAN_{name}")).ok().filter(|text| !text.is_empty()).unwrap_or(default.into())
}

struct Ingest {
    settings: Settings,
    session: Session,
    lidars: HashMap<String, Lidar>,
    counters: BTreeMap<String, u64>,
}

impl Ingest {
    fn count(&mut self, what: &str) {
        *self.counters.entry(what.into()).or_default() += 1;
    }

    fn take(&mut self, sample: &Sample) -> Result<(), Anything> {
        if sample.kind() != SampleKind::Put {
            return Ok(());
        }
        let declared = sample.encoding().to_string();
        let known = declared == RAW_SCAN || UNDECLARED.contains(&declared.as_str());
        let Some(raw) = RawScan::decode(&*sample.payload().to_bytes()).ok().filter(|_| known) else {
            self.count("undecodable");
            return Ok(());
        };
        self.count("heard_scan_raw");
        let key = sample.key_expr().as_str().replace("/scan/raw/", "/scan/");
        if self.lidars.len() >= MOST_LIDARS && !self.lidars.contains_key(&key) {
            self.count("set_aside_too_many_lidars");
            return Ok(());
        }
        match self.lidars.entry(key.clone()).or_default().normalize(raw, &self.settings.base_frame) {
            Ok(scan) => self.publish(&key, &scan),
            Err(reason) => {
                self.count(&format!("set_aside_{reason}"));
                Ok(())
            }
        }
    }

    fn publish(&mut self, key: &str, scan: &Scan) -> Result<(), Anything> {
        self.session
            .put(key, scan.encode_to_vec())
            .encoding(Encoding::from(SCAN))
            .priority(Priority::RealTime)
            .congestion_control(CongestionControl::Drop)
            .express(true)
            .wait()?;
        self.count("said_scan");
        Ok(())
    }

    fn tell_health(&self) -> Result<(), Anything> {
        let now = SystemTime::now().duration_since(UNIX_EPOCH)?;
        let has_scans = self.counters.get("heard_scan_raw").is_some();
        let Settings { site, robot, instance, base_frame } = &self.settings;
        let health = Health {
            timestamp: Some(prost_types::Timestamp {
                seconds: now.as_secs() as i64,
                nanos: now.subsec_nanos() as i32,
            }),
            service: "scan-ingest".into(),
            instance: instance.clone(),
            status: if has_scans { Status::Ok } else { Status::Waiting }.into(),
            detail: if has_scans { "" } else { "no scan received yet" }.into(),
            counters: self.counters.clone().into_iter().collect(),
            package_version: env!("CARGO_PKG_VERSION").into(),
            settings: format!(r#"{{"site": {site:?}, "robot": {robot:?}, "base_frame": {base_frame:?}}}"#),
        };
        self.session
            .put(format!("{site}/health/scan-ingest/{instance}"), health.encode_to_vec())
            .encoding(Encoding::from(HEALTH))
            .priority(Priority::Background)
            .congestion_control(CongestionControl::Drop)
            .wait()?;
        Ok(())
    }
}

fn main() -> Result<(), Anything> {
    let over = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT] {
        signal_hook::flag::register(signal, over.clone())?;
    }
    let config = match setting("ZENOH", "") {
        path if path.is_empty() => zenoh::Config::default(),
        path => zenoh::Config::from_file(path)?,
    };
    let robot = setting("ROBOT", "robot");
    let settings = Settings {
        site: setting("SITE", "site"),
        instance: setting("INSTANCE", if robot == "*" { "0" } else { &robot }),
        base_frame: setting("BASE_FRAME", "base_link"),
        robot,
    };
    let session = zenoh::open(config).wait()?;
    let raw_scans = format!("{}/robot/{}/scan/raw/*", settings.site, settings.robot);
    let subscriber = session.declare_subscriber(raw_scans).with(RingChannel::new(WAITING_SCANS)).wait()?;
    let alive = format!("{}/alive/scan-ingest/{}/1", settings.site, settings.instance);
    let token = session.liveliness().declare_token(alive).wait()?;
    let counters = BTreeMap::from([("undecodable".to_string(), 0)]);
    let mut ingest = Ingest { settings, session: session.clone(), lidars: HashMap::new(), counters };
    let mut told = Instant::now() - Duration::from_secs(2);
    while !over.load(Relaxed) {
        if told.elapsed() >= Duration::from_secs(1) {
            told = Instant::now();
            ingest.tell_health()?;
        }
        if let Ok(Some(sample)) = subscriber.recv_timeout(Duration::from_millis(50)) {
            ingest.take(&sample)?;
        }
    }
    token.undeclare().wait()?;
    session.close().wait()?;
    Ok(())
}
