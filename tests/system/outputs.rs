//! What commands write goes over nothing that they are made of.

use std::fs;
use std::path::Path;

use crate::program::plumb;

/// Runs `words`, with `@name` as the path of the file `name`.
fn run(folder: &Path, words: &str) -> (Option<i32>, String) {
    let path = |word: &str| match word.strip_prefix('@') {
        Some(name) => folder.join(name).display().to_string(),
        None => word.to_owned(),
    };
    let done = plumb(words.split_whitespace().map(path));
    (done.code, done.stderr)
}

const TARGET: &str = r#"{"kind":"chessboard","cols":9,"rows":6,"square_m":0.02}"#;
const OTHER_TARGET: &str = r#"{"kind":"chessboard","cols":8,"rows":6,"square_m":0.02}"#;

#[test]
fn nothing_that_is_read_is_written_over() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    let examples = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples");
    fs::copy(examples.join("board.jpg"), file("board.jpg")).unwrap();
    fs::write(file("walk.mcap"), "a recording").unwrap();
    fs::write(file("target.json"), TARGET).unwrap();
    fs::write(file("other.json"), OTHER_TARGET).unwrap();
    fs::write(file("scene.toml"), "frames = 2\n").unwrap();
    let commands = [
        "calibrate --board 9x6 --square 25mm --out @board.jpg @board.jpg",
        "calibrate --board 9x6 --square 25mm --out @walk.mcap @board.jpg",
        "autocalibrate --out @board.jpg @board.jpg",
        "autocalibrate --points @board.jpg @board.jpg",
        "autocalibrate --out @new --points @new @board.jpg",
        "autocalibrate --given fx=500 --given fx=600 @board.jpg",
        "uncertainty --calibration @target.json --out @target.json",
        "board --calibration @target.json --out @target.json",
        "simulate --config @scene.toml --out @scene.toml",
        "target --target @target.json --out @target.json",
        "calibrate --board 9x6 --square 25mm --rig a=@board.jpg --rig b=@board.jpg",
    ];
    let names = ["board.jpg", "walk.mcap", "target.json", "other.json", "scene.toml"];
    let contents = || names.map(|name| fs::read(file(name)).unwrap());
    let before = contents();
    for words in commands {
        let words = words.replace("=@", &format!("={}/", folder.path().display()));
        let (code, line) = run(folder.path(), &words);
        assert_eq!(code, Some(2), "{words}: {line}");
        assert!(contents() == before, "{words} has written over a file");
    }
    // The description of another board, which nothing was printed of there.
    let (code, line) = run(folder.path(), "target --target @target.json --out @other.pdf");
    assert!(code == Some(1) && line.contains("another file is there"), "{line}");
    assert!(contents() == before);
}

/// A PNG says how large it is, as PNG's specification has it (section 11.3.4.3): pixels a meter.
#[test]
fn a_printed_png_states_its_resolution() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("target.json"), TARGET).unwrap();
    let (code, line) =
        run(folder.path(), "target --target @target.json --dpi 300 --out @print.png");
    assert_eq!(code, Some(0), "{line}");
    let png = fs::read(folder.path().join("print.png")).unwrap();
    let at = png.windows(4).position(|name| name == b"pHYs").unwrap();
    let number = |from: usize| u32::from_be_bytes(png[from..from + 4].try_into().unwrap());
    // 300 dots an inch, in meters.
    assert_eq!(
        (number(at - 4), number(at + 4), number(at + 8), png[at + 12]),
        (9, 11811, 11811, 1)
    );
    let image = image::load_from_memory(&png).unwrap();
    assert!(image.width() > 2000, "the image is read all the same");
}
