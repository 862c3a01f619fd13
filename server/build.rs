//! Makes the binary follow the web client that it embeds.

fn main() {
    let dist = concat!(env!("CARGO_MANIFEST_DIR"), "/../web/dist");
    // An empty folder until the client is built: cargo watches a folder that exists for new files, whereas a missing
    // one would make every build start over. If it cannot be made, the binary serves its placeholder page.
    if std::fs::create_dir_all(dist).is_ok() {
        println!("cargo::rerun-if-changed={dist}");
    } else {
        println!("cargo::rerun-if-changed=build.rs");
    }
}
