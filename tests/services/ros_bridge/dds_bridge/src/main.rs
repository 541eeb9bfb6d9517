//! Eclipse's zenoh-plugin-ros2dds as a program, with the configuration that its argument names.

use zenoh::internal::{plugins::PluginsManager, runtime::RuntimeBuilder};

#[tokio::main]
async fn main() {
    zenoh::init_log_from_env_or("info");
    let path = std::env::args().nth(1).expect("a Zenoh configuration");
    let config = zenoh::Config::from_file(path).expect("a Zenoh configuration");
    let mut plugins = PluginsManager::static_plugins_only();
    plugins.declare_static_plugin::<zenoh_plugin_ros2dds::ROS2Plugin, &str>("ros2dds", true);
    let mut runtime = RuntimeBuilder::new(config)
        .plugins_manager(plugins)
        .build()
        .await
        .expect("a Zenoh runtime");
    runtime.start().await.expect("a Zenoh runtime");
    std::future::pending::<()>().await;
}
