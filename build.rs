//! Keeps to ourselves what our C libraries define.
//!
//! Intel's librealsense2 has an LZ4 and an XXH32 of its own, of another version, under the names of
//! those that read our recordings. A linker exports from a program whatever a shared library of it
//! defines too, and the program's comes first: the library would then unpack its .bag files by our
//! functions, and fail. `--exclude-libs` exports none.

fn main() {
    let is = |name: &str| std::env::var_os(name).is_some();
    let target = std::env::var("CARGO_CFG_TARGET_OS").unwrap_or_default();
    if is("CARGO_FEATURE_REALSENSE") && target == "linux" {
        println!("cargo::rustc-link-arg=-Wl,--exclude-libs,ALL");
    }
    println!("cargo::rerun-if-changed=build.rs");
}
