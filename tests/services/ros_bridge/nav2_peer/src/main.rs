//! A robot's ROS 2 graph with Nav2's part in it, on hiroz: another implementation of rmw_zenoh's wire.
//!
//! `nav2-peer ENDPOINT DOMAIN` reads a line of JSON for each thing to do, and prints one for each that came:
//!
//!     {"publish": "/scan", "message": {...}}
//!     {"call": "/amcl/get_state", "request": {}}       {"service": "/amcl/get_state", "response": {...}}
//!                                                      {"topic": "/amcl_pose", "message": {...}}

use hiroz::context::{ZContext, ZContextBuilder};
use hiroz::msg::{ZDeserializer, ZMessage, ZService};
use hiroz::node::ZNode;
use hiroz::qos::{QosDurability, QosHistory, QosProfile, QosReliability};
use hiroz::{Builder, Result, ServiceTypeInfo, WithTypeInfo};
use hiroz_msgs::ros::{
    diagnostic_msgs, geometry_msgs, lifecycle_msgs, nav_msgs, rcl_interfaces, sensor_msgs, std_msgs,
    std_srvs, tf2_msgs,
};
use serde::de::DeserializeOwned;
use serde::Serialize;
use serde_json::{json, Value};
use std::collections::HashMap;
use std::io::BufRead;
use std::time::Duration;

use hiroz_msgs::size_estimation;

#[allow(clippy::all, dead_code, unused, unexpected_cfgs)]
mod generated {
    include!(concat!(env!("OUT_DIR"), "/generated.rs"));
}
use generated::ros::{bond, nav2_msgs};

/// How long a service may take; then it counts as one that is not there.
const PATIENCE: Duration = Duration::from_secs(5);

type Job = Box<dyn Fn(Value) -> Result<()>>;

fn qos(depth: usize, reliable: bool, latched: bool) -> QosProfile {
    QosProfile {
        history: QosHistory::from_depth(depth),
        reliability: if reliable { QosReliability::Reliable } else { QosReliability::BestEffort },
        durability: if latched { QosDurability::TransientLocal } else { QosDurability::Volatile },
        ..Default::default()
    }
}

struct Peer {
    node: ZNode,
    runtime: tokio::runtime::Runtime,
    jobs: HashMap<String, Job>,
    open: Vec<Box<dyn std::any::Any>>,
}

impl Peer {
    fn publishes<T>(&mut self, topic: &'static str, qos: QosProfile) -> Result<()>
    where
        T: ZMessage + WithTypeInfo + DeserializeOwned + 'static,
    {
        let publisher = self.node.create_pub::<T>(topic).with_qos(qos).build()?;
        let job = move |message| publisher.publish(&serde_json::from_value::<T>(message)?);
        self.jobs.insert(topic.to_owned(), Box::new(job));
        Ok(())
    }

    fn receives<T>(&mut self, topic: &'static str, qos: QosProfile) -> Result<()>
    where
        T: ZMessage + WithTypeInfo + Serialize + Send + Sync + 'static,
        T::Serdes: for<'a> ZDeserializer<Input<'a> = &'a [u8], Output = T> + 'static,
    {
        let print = move |message: T| println!("{}", json!({"topic": topic, "message": message}));
        let subscriber = self.node.create_sub::<T>(topic).with_qos(qos).build_with_callback(print)?;
        self.open.push(Box::new(subscriber));
        Ok(())
    }

    fn calls<T>(&mut self, service: &'static str) -> Result<()>
    where
        T: ZService + ServiceTypeInfo + 'static,
        T::Request: ZMessage + DeserializeOwned,
        T::Response: ZMessage + Serialize,
        for<'a> <T::Response as ZMessage>::Serdes: ZDeserializer<Output = T::Response, Input<'a> = &'a [u8]>,
    {
        let client = self.node.create_client::<T>(service).build()?;
        let handle = self.runtime.handle().clone();
        let job = move |request| {
            let request = serde_json::from_value::<T::Request>(request)?;
            let answered = match handle.block_on(client.call_with_timeout(&request, PATIENCE)) {
                Ok(response) => json!({"service": service, "response": response}),
                Err(error) => json!({"service": service, "error": error.to_string()}),
            };
            println!("{answered}");
            Ok(())
        };
        self.jobs.insert(service.to_owned(), Box::new(job));
        Ok(())
    }

    fn joins(context: &ZContext) -> Result<Self> {
        let node = context.create_node("nav2_peer").build()?;
        let runtime = tokio::runtime::Runtime::new()?;
        let mut peer = Peer { node, runtime, jobs: HashMap::new(), open: Vec::new() };
        peer.robot()?;
        peer.nav2()?;
        Ok(peer)
    }

    /// What drivers, robot_state_publisher and RViz publish, with their quality of service.
    fn robot(&mut self) -> Result<()> {
        self.publishes::<sensor_msgs::LaserScan>("/scan", qos(5, false, false))?;
        self.publishes::<sensor_msgs::PointCloud2>("/points", qos(5, false, false))?;
        self.publishes::<nav_msgs::Odometry>("/odom", qos(10, true, false))?;
        self.publishes::<tf2_msgs::TFMessage>("/tf", qos(100, true, false))?;
        self.publishes::<tf2_msgs::TFMessage>("/tf_static", qos(1, true, true))?;
        self.publishes::<geometry_msgs::PoseWithCovarianceStamped>("/initialpose", qos(10, true, false))?;
        self.publishes::<bond::Status>("/bond", qos(10, true, false))
    }

    /// What Nav2's nodes and RViz subscribe to and call.
    fn nav2(&mut self) -> Result<()> {
        self.receives::<geometry_msgs::PoseWithCovarianceStamped>("/amcl_pose", qos(1, true, true))?;
        self.receives::<nav2_msgs::ParticleCloud>("/particle_cloud", qos(5, false, false))?;
        self.receives::<tf2_msgs::TFMessage>("/tf", qos(100, true, false))?;
        self.receives::<nav_msgs::OccupancyGrid>("/map", qos(1, true, true))?;
        self.receives::<std_msgs::String>("/floor", qos(1, true, true))?;
        self.receives::<bond::Status>("/bond", qos(10, true, false))?;
        self.receives::<diagnostic_msgs::DiagnosticArray>("/diagnostics", qos(10, true, false))?;
        self.calls::<lifecycle_msgs::srv::GetState>("/amcl/get_state")?;
        self.calls::<lifecycle_msgs::srv::ChangeState>("/amcl/change_state")?;
        self.calls::<lifecycle_msgs::srv::GetAvailableStates>("/amcl/get_available_states")?;
        self.calls::<lifecycle_msgs::srv::GetAvailableTransitions>("/amcl/get_available_transitions")?;
        self.calls::<rcl_interfaces::srv::ListParameters>("/amcl/list_parameters")?;
        self.calls::<rcl_interfaces::srv::GetParameters>("/amcl/get_parameters")?;
        self.calls::<rcl_interfaces::srv::GetParameterTypes>("/amcl/get_parameter_types")?;
        self.calls::<rcl_interfaces::srv::DescribeParameters>("/amcl/describe_parameters")?;
        self.calls::<rcl_interfaces::srv::SetParameters>("/amcl/set_parameters")?;
        self.calls::<nav2_msgs::srv::SetInitialPose>("/set_initial_pose")?;
        self.calls::<std_srvs::srv::Empty>("/reinitialize_global_localization")?;
        self.calls::<std_srvs::srv::Empty>("/request_nomotion_update")
    }
}

fn main() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let endpoint = arguments.next().ok_or("an endpoint")?;
    let domain: usize = arguments.next().ok_or("a domain")?.parse()?;
    let context = ZContextBuilder::default()
        .with_connect_endpoints([endpoint.as_str()])
        .disable_multicast_scouting()
        .with_domain_id(domain)
        .build()?;
    let peer = Peer::joins(&context)?;
    println!("{}", json!({"ready": true}));
    for line in std::io::stdin().lock().lines() {
        let mut order: Value = serde_json::from_str(&line?)?;
        let (verb, content) = if order["call"].is_null() { ("publish", "message") } else { ("call", "request") };
        let name = order[verb].as_str().unwrap_or_default().to_owned();
        let job = peer.jobs.get(&name).ok_or_else(|| format!("nothing is known of {name:?}"))?;
        job(order[content].take())?;
    }
    Ok(())
}
