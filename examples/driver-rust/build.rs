//! The contract's messages as Rust, from the .proto files alone.

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let protos = ["eigenscan/schemas/scan.proto", "eigenscan/schemas/tracking.proto", "foxglove/Odometry.proto"];
    let root = "../../schemas/proto";
    println!("cargo:rerun-if-changed={root}");
    prost_build::Config::new().compile_fds(protox::compile(protos, [root])?)?;
    Ok(())
}
