//! Everything in `tests/fuzz/corpus`, and a round of mutations of it that is the same each time:
//! none panics. `make fuzz` is what searches for more.

use std::fs;
use std::path::Path;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

#[path = "../fuzz/targets.rs"]
mod targets;

use targets::Target;

/// Mutations of each file.
const MUTATIONS: u64 = 60;
/// Of each recording: of the seven ROS bags together 3,500.
const MUTATIONS_OF_RECORDINGS: u64 = 500;
/// Numbers that lengths and counts go wrong with.
const EXTREMES: [u64; 8] = [0, 1, 0x7f, 0xff, 0x7fff_ffff, 0xffff_ffff, u64::MAX >> 1, u64::MAX];

fn corpus(target: &Target) -> Vec<(String, Vec<u8>)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fuzz/corpus").join(target.name);
    let mut files: Vec<_> =
        fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    assert!(!files.is_empty(), "{} has no seeds", target.name);
    files.iter().map(|file| (file.display().to_string(), fs::read(file).unwrap())).collect()
}

/// The input with one to four places changed: a bit, a number, a cut, a piece of another input.
fn mutated(input: &[u8], other: &[u8], random: &mut ChaCha8Rng) -> Vec<u8> {
    let mut bytes = input.to_vec();
    for _ in 0..random.random_range(1..=4) {
        if bytes.is_empty() {
            return bytes;
        }
        let at = random.random_range(0..bytes.len());
        match random.random_range(0..5) {
            0 => bytes[at] ^= 1 << random.random_range(0..8),
            1 => bytes[at] = random.random(),
            2 => {
                let number = EXTREMES[random.random_range(0..EXTREMES.len())].to_le_bytes();
                let width = [1, 2, 4, 8][random.random_range(0..4)].min(bytes.len() - at);
                bytes[at..at + width].copy_from_slice(&number[..width]);
            }
            3 => bytes.truncate(at),
            _ => {
                let from = random.random_range(0..=other.len());
                let length = random.random_range(0..=(other.len() - from).min(64));
                bytes.splice(at..at, other[from..from + length].iter().copied());
            }
        }
    }
    bytes
}

fn replay(name: &str, mutations: u64) {
    let target = targets::ALL.iter().find(|target| target.name == name).unwrap();
    let files = corpus(target);
    for (_, input) in &files {
        (target.run)(input);
    }
    for (k, (_, input)) in files.iter().enumerate() {
        let mut random = ChaCha8Rng::seed_from_u64(k as u64);
        let other = &files[(k + 1) % files.len()].1;
        for _ in 0..mutations {
            (target.run)(&mutated(input, other, &mut random));
        }
    }
}

#[test]
fn every_target_has_its_test() {
    let names = targets::ALL.map(|target| target.name);
    assert_eq!(names, ["image", "mcap", "bag1", "db3", "config", "document", "http"]);
}

#[test]
fn images() {
    replay("image", MUTATIONS);
}

#[test]
fn recordings_of_plumb_and_foxglove() {
    replay("mcap", MUTATIONS_OF_RECORDINGS);
}

#[test]
fn bags_of_ros_1() {
    replay("bag1", MUTATIONS_OF_RECORDINGS);
}

#[test]
fn bags_in_sqlite() {
    replay("db3", MUTATIONS_OF_RECORDINGS);
}

#[test]
fn configurations() {
    replay("config", MUTATIONS);
}

#[test]
fn documents() {
    replay("document", MUTATIONS);
}

#[test]
fn requests() {
    replay("http", MUTATIONS);
}
