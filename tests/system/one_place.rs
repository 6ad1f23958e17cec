//! What is a list is named where it is listed, and nowhere else: a new lens model is one file and
//! its line, a new kind of sensor its lines in one file.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// The lens models: the type, and the name in documents.
const LENS_MODELS: &[(&str, &str)] = &[
    ("Pinhole", "pinhole"),
    ("Radial", "radial"),
    ("DoubleSphere", "double_sphere"),
    ("Eucm", "eucm"),
    ("KannalaBrandt", "kannala_brandt"),
    ("Brown", "brown"),
    ("Rational", "rational"),
];

/// Where they are listed.
const LENS_LIST: &str = "src/geometry/lens/mod.rs";

/// Files that work with one model, and would not change for another. It only ever gets shorter.
const USE_ONE_MODEL: &[(&str, &str)] = &[
    ("src/calibration/information/camera_information.rs", "Brown"),
    ("src/calibration/information/camera_information.rs", "KannalaBrandt"),
    // The lenses of simulated sessions.
    ("src/cli/simulate/operated.rs", "Brown"),
    ("src/cli/simulate/operated.rs", "KannalaBrandt"),
    ("src/estimation/dlt.rs", "Pinhole"),
    ("src/estimation/scene/hypotheses.rs", "Radial"),
    ("src/estimation/scene/rotation_only.rs", "Radial"),
    ("src/export/refit.rs", "Brown"),
    // What Kalibr calls its plain camera.
    ("src/geometry/lens/model.rs", "Pinhole"),
    ("src/simulation/rgbd_world.rs", "Brown"),
    ("src/simulation/world.rs", "Brown"),
];

#[test]
fn a_lens_model_is_one_file_and_one_line() {
    let mut named: BTreeMap<PathBuf, Vec<&str>> = BTreeMap::new();
    for (file, code) in production_code() {
        let models = LENS_MODELS.iter().filter(|(model, name)| names_model(&code, model, name));
        let models: Vec<&str> = models.map(|(model, _)| *model).collect();
        if !models.is_empty() {
            named.insert(file, models);
        }
    }
    let mut faults = Vec::new();
    for (file, models) in &named {
        let own = |model: &&str| *file == own_file(model);
        let used = |model: &&str| USE_ONE_MODEL.contains(&(file.to_str().unwrap(), *model));
        let listed = file == Path::new(LENS_LIST);
        let others: Vec<_> =
            models.iter().filter(|model| !(listed || own(model) || used(model))).collect();
        if !others.is_empty() {
            faults.push(format!("{} names {others:?}", file.display()));
        }
    }
    assert!(
        faults.is_empty(),
        "make it a fact of the model (src/geometry/lens/model.rs):\n{}",
        faults.join("\n")
    );
    for (model, _) in LENS_MODELS {
        let files = named.values().filter(|models| models.contains(model)).count();
        let uses = USE_ONE_MODEL.iter().filter(|(_, used)| used == model).count();
        assert_eq!(files, 2 + uses, "{model}: its file, the list, and {uses} that use it alone");
    }
}

#[test]
fn the_list_of_lens_models_is_whole() {
    let models = plumb::geometry::lens::LensModel::ALL;
    let listed = models.map(|model| (format!("{model:?}"), model.name().to_owned()));
    let known = LENS_MODELS.iter().map(|(model, name)| ((*model).to_owned(), (*name).to_owned()));
    assert_eq!(listed.to_vec(), known.collect::<Vec<_>>(), "LENS_MODELS of this test is not whole");
}

fn own_file(model: &str) -> PathBuf {
    let (_, name) = LENS_MODELS.iter().find(|(other, _)| *other == model).unwrap();
    PathBuf::from(format!("src/geometry/lens/{name}.rs"))
}

/// Whether code names the model by its type, or by its name in documents as a string.
fn names_model(code: &str, model: &str, name: &str) -> bool {
    // Another library's list of models is not ours.
    let code = code.replace("Rs2DistortionModel::", "_");
    let mut words = code.split(|c: char| !c.is_alphanumeric() && c != '_');
    words.any(|word| word == model) || code.contains(&format!("\"{name}\""))
}

/// Files that name the second infrared sensor: the list of kinds, and what devices and messages
/// call it.
const NAME_SECOND_INFRARED: &[&str] = &[
    "src/capture/realsense/camera.rs",
    "src/capture/realsense/factory.rs",
    "src/imaging/frame.rs",
    "src/recording/bag/topics.rs",
    "src/recording/ros2_messages.rs",
];

#[test]
fn a_kind_of_sensor_is_one_line_where_it_is_listed() {
    let names = |code: &str| code.contains("Infrared2") || code.contains("infrared2");
    let named = production_code().into_iter().filter(|(_, code)| names(code));
    let files: Vec<String> = named.map(|(file, _)| file.display().to_string()).collect();
    assert_eq!(files, NAME_SECOND_INFRARED, "take the kind from `SensorKind::ALL`");
}

/// Every file of `src` without tests and comments.
fn production_code() -> Vec<(PathBuf, String)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut files = Vec::new();
    visit(&root.join("src"), &mut files);
    files.sort();
    let is_test = |file: &PathBuf| file.to_str().is_some_and(|name| name.ends_with("tests.rs"));
    let read = |file: PathBuf| {
        let text = fs::read_to_string(&file).unwrap();
        let code = text.split("#[cfg(test)]\n").next().unwrap();
        let code: Vec<&str> = code.lines().map(|line| line.split("//").next().unwrap()).collect();
        (file.strip_prefix(root).unwrap().to_owned(), code.join("\n"))
    };
    files.into_iter().filter(|file| !is_test(file)).map(read).collect()
}

fn visit(folder: &Path, files: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            visit(&path, files);
        } else if path.extension().is_some_and(|ending| ending == "rs") {
            files.push(path);
        }
    }
}
