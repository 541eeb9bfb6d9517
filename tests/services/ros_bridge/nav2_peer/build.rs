//! Rust types of the messages that hiroz does not bring: Nav2's and bond's.

use std::path::PathBuf;

fn main() -> anyhow::Result<()> {
    let msgs = PathBuf::from(std::env::var("CARGO_MANIFEST_DIR")?).join("msgs");
    let paths = ["nav2_msgs", "bond"].map(|name| msgs.join(name).display().to_string());
    println!("cargo:rerun-if-changed={}", msgs.display());
    std::env::set_var("HIROZ_MSG_PATH", paths.join(":"));
    let humble = std::env::var("CARGO_FEATURE_HUMBLE").is_ok();
    hiroz_codegen::generate_user_messages(&PathBuf::from(std::env::var("OUT_DIR")?), humble)
}
