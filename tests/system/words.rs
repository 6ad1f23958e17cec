//! The vocabulary, as a test: the field's terms in identifiers, comments and messages, US spelling,
//! and no type name defined twice. `src/lib.rs` has the glossary.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// Words that no identifier, comment or message may contain, and what to write instead.
const DENIED: &[(&[&str], &str)] = &[
    (&["sight", "sights", "sighting", "sightings"], "observation"),
    (&["look", "looks", "looked", "looking"], "detect, measure, sample, search"),
    (&["tell", "tells", "telling", "told"], "report, indicate, determine"),
    (&["foretell", "foretells", "foretold", "foretelling", "foreseen"], "predict"),
    (&["companion", "companions"], "auxiliary sensor"),
    (&["lend", "lends", "lending", "lent"], "acquire, lease"),
    (&["astray"], "outlier"),
    (&["lonely"], "isolated"),
    (&["unlikelihood"], "negative log-likelihood"),
    (&["strain", "strains", "strained"], "rms ratio"),
    (&["wish", "wishes", "wished"], "suggested pose, request"),
    (&["witness", "witnesses"], "reference"),
    (&["slack"], "pose jitter, tolerance"),
    (&["usual"], "median, ordinary"),
    (&["agreeing"], "inlier"),
    (&["bend", "bends"], "distortion, curvature"),
    (&["apart"], "distance, difference, separate"),
    (&["picture", "pictures"], "image"),
    (&["turn", "turns", "turned", "turning"], "rotation, roll; becomes; rejected"),
    (SHIFTS, "translation, offset"),
];
const SHIFTS: &[&str] = &["shift", "shifts", "shifted", "shifting"];

/// Inputs of tests.
const OTHERS: &[&str] = &["tests/fuzz/corpus"];

/// Phrases, likewise.
const DENIED_PHRASES: &[(&str, &str)] = &[
    ("take part", "is an inlier, is in use"),
    ("takes part", "is an inlier, is in use"),
    ("took part", "was an inlier, was in use"),
    ("a cover ", "an occluder"),
    ("the cover ", "the occluder"),
];

/// Where a word means what it says: lists and labels that are shifted by whole places.
const SHIFTED_BY_PLACES: &[&str] = &["list_shift", "view_fault", "solve_rig", "bad_views"];

/// Where a denied word stands for now. It only ever gets shorter: `picture` is a column of the
/// store, with what reads it.
const NOT_YET: &[(&str, &[&str])] = &[
    ("picture", &["src/store", "src/pipeline", "src/http/views.rs"]),
    ("pictures", &["src/store"]),
];

/// Spellings that are not US English, as parts of words.
const SPELLINGS: &[(&str, &str)] = &[
    ("colour", "color"),
    ("grey", "gray"),
    ("centre", "center"),
    ("neighbour", "neighbor"),
    ("metre", "meter"),
    ("normalis", "normaliz"),
    ("linearis", "lineariz"),
    ("minimis", "minimiz"),
    ("recognis", "recogniz"),
    ("labell", "label"),
    ("licence", "license"),
    ("behaviour", "behavior"),
];

/// Where a denied word or spelling is the right one: another program's name, or the field's term.
const ALLOWED_TEXT: &[&str] = &[
    "line of sight",
    "lines of sight",
    "line_of_sight",
    "GREY",
    "METRES",
    "older.companions",
    "\"picture\"",
    "mod list_shift;",
    "HALF_TURN",
    "HalfTurn",
    "half_turn",
    "half turn",
    "half a turn",
    "uarter turn",
    "quarter_turns",
    "turn it clockwise",
    "turn it counterclockwise",
    "turn the camera",
    "turn it by 90",
    "view.picture",
    "aria-labelledby",
];

/// Names that mean the same in every file: the arguments of one command.
const TYPES_PER_FILE: &[&str] = &["Args"];

/// Names that two builds define, each in its own file: with and without a feature or a system.
const TYPES_PER_BUILD: &[&str] = &["RealsenseCamera"];

#[test]
fn the_vocabulary_is_the_fields() {
    let mut faults = Vec::new();
    for (file, text) in sources(&["rs", "md", "py", "toml", "js", "html", "css"]) {
        if file.ends_with("words.rs") || OTHERS.iter().any(|folder| file.starts_with(folder)) {
            continue;
        }
        for (number, line) in text.lines().enumerate() {
            let line =
                ALLOWED_TEXT.iter().fold(line.to_owned(), |line, text| line.replace(text, ""));
            let fault = |word: &str, instead: &str| {
                format!("{}:{}: `{word}`: write {instead}", file.display(), number + 1)
            };
            for (phrase, instead) in DENIED_PHRASES {
                faults.extend(line.contains(phrase).then(|| fault(phrase, instead)));
            }
            let by_places =
                SHIFTED_BY_PLACES.iter().any(|name| file.to_string_lossy().contains(name));
            for word in words(&line) {
                let denied = DENIED.iter().find(|(denied, _)| denied.contains(&word.as_str()));
                let denied = denied.filter(|_| !(by_places && SHIFTS.contains(&word.as_str())));
                let allowed = |(later, paths): &(&str, &[&str])| {
                    *later == word && paths.iter().any(|path| file.starts_with(path))
                };
                let denied = denied.filter(|_| !NOT_YET.iter().any(allowed));
                faults.extend(denied.map(|(_, instead)| fault(&word, instead)));
            }
            for (british, us) in SPELLINGS {
                let spelled = words(&line).into_iter().find(|word| word.contains(british));
                faults.extend(spelled.map(|_| fault(british, us)));
            }
        }
    }
    assert!(faults.is_empty(), "{} words:\n{}", faults.len(), faults.join("\n"));
}

#[test]
fn no_type_name_is_defined_twice() {
    let mut files_of: BTreeMap<String, Vec<PathBuf>> = BTreeMap::new();
    for (file, text) in sources(&["rs"]) {
        let is_test = file.to_str().is_some_and(|name| name.ends_with("_tests.rs"));
        if !file.starts_with("src") || is_test {
            continue;
        }
        let code = text.split("#[cfg(test)]\nmod").next().unwrap_or_default();
        for name in code.lines().filter_map(defined_type) {
            files_of.entry(name.to_owned()).or_default().push(file.clone());
        }
    }
    let allowed = [TYPES_PER_FILE, TYPES_PER_BUILD].concat();
    let repeated = files_of
        .iter()
        .filter(|(name, files)| files.len() > 1 && !allowed.contains(&name.as_str()));
    let repeated: Vec<_> = repeated.map(|(name, files)| format!("{name}: {files:?}")).collect();
    assert!(repeated.is_empty(), "defined more than once:\n{}", repeated.join("\n"));
}

/// The name of the type that a line at a file's top level defines.
fn defined_type(line: &str) -> Option<&str> {
    let line = match line.strip_prefix("pub") {
        Some(rest) if rest.starts_with('(') => rest.split_once(") ")?.1,
        Some(rest) => rest.trim_start(),
        None => line,
    };
    let kinds = ["struct ", "enum ", "trait ", "type "];
    let rest = kinds.iter().find_map(|kind| line.strip_prefix(kind))?;
    rest.split(|c: char| !c.is_alphanumeric() && c != '_').next()
}

/// The words of a line in lower case, those inside identifiers among them: `BoardPose` and
/// `board_pose` are both `board` and `pose`.
fn words(line: &str) -> Vec<String> {
    let mut words = vec![String::new()];
    let mut after_lower = false;
    for c in line.chars() {
        if !c.is_ascii_alphabetic() || (c.is_ascii_uppercase() && after_lower) {
            words.push(String::new());
        }
        if c.is_ascii_alphabetic()
            && let Some(word) = words.last_mut()
        {
            word.push(c.to_ascii_lowercase());
        }
        after_lower = c.is_ascii_lowercase();
    }
    words
}

/// Every file of the project with one of these endings: its path from the root, and its text.
fn sources(endings: &[&str]) -> Vec<(PathBuf, String)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut found = Vec::new();
    let folders = [
        "src",
        "tests",
        "benches",
        "examples",
        "docs",
        "recordings",
        "config",
        "demo",
        "packaging",
    ];
    folders.iter().for_each(|folder| visit(&root.join(folder), &mut found));
    for file in fs::read_dir(root).unwrap() {
        found.push(file.unwrap().path());
    }
    let ends =
        |path: &PathBuf| path.extension().is_some_and(|e| endings.iter().any(|known| e == *known));
    let mut files: Vec<_> = found.into_iter().filter(ends).collect();
    files.sort();
    let read = |path: PathBuf| {
        let text = fs::read_to_string(&path).unwrap();
        (path.strip_prefix(root).unwrap().to_owned(), text)
    };
    files.into_iter().map(read).collect()
}

fn visit(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            visit(&path, found);
        } else {
            found.push(path);
        }
    }
}
