//! Bad input: each with its one clear line and the right exit code, and nothing gathered is lost.

use std::fs;
use std::net::TcpListener;
use std::path::{Path, PathBuf};

use image::{GrayImage, ImageFormat, Luma};

use crate::program::plumb;

/// A folder with one file of every kind that can be wrong.
struct BadFiles {
    folder: tempfile::TempDir,
}

impl BadFiles {
    fn new() -> Self {
        let files = Self { folder: tempfile::tempdir().unwrap() };
        let gray = GrayImage::from_fn(320, 240, |x, y| Luma([(x / 2 + y / 4) as u8]));
        let jpeg = encoded(&gray, ImageFormat::Jpeg);
        files.write("gray.jpg", &jpeg);
        files.write("cut.jpg", &jpeg[..jpeg.len() / 2]);
        files.write("empty.png", b"");
        files.write("dot.png", &encoded(&GrayImage::new(1, 1), ImageFormat::Png));
        files.write("huge.png", &png_header(20_000, 10_000));
        files.write("words.png", b"no image at all");
        files.write("cut.mcap", b"\x89MCAP0\r\n\x01\x20\x00\x00");
        files.write("words.mcap", b"no recording at all");
        files.write("nothing/readme.txt", b"no images here");
        files.write("small/other.png", &encoded(&GrayImage::new(64, 48), ImageFormat::Png));
        let point = |pixel: &str| {
            format!(
                r#"{{"image_size":[640,480],"views":[{{"object":[[0,0,0]],"image":[{pixel}]}}]}}"#
            )
        };
        files.write("nan.json", point("[1,NaN]").as_bytes());
        files.write("few.json", point("[1,2]").as_bytes());
        files.write("marked.json", format!("\u{feff}{}", point("[1,2]")).as_bytes());
        let telescope = point("[1,2]").replace("\"views\"", "\"given\":{\"fx\":1e9},\"views\"");
        files.write("telescope.json", telescope.as_bytes());
        files.write("fields.json", br#"{"image_size":[640,480],"views":[{"object":[[0,0,0]]}]}"#);
        files.write("size.json", br#"{"image_size":[0,480],"views":[]}"#);
        files.write("syntax.json", br#"{"image_size":[640,480],"#);
        files.write(
            "dlt.json",
            point("[1,2]").replace("\"views\"", "\"method\":\"dlt\",\"views\"").as_bytes(),
        );
        files.write("board.toml", b"kind = \"chessboard\"\ncols = 9\nrows = 6\nsquare_m = 0.02\n");
        files.write("nothing.toml", b"");
        files.write(
            "back.toml",
            b"[[camera]]\nname = \"back\"\nsource = { kind = \"simulator\" }\n",
        );
        files.write("key.toml", b"[server]\nportt = 3\n");
        files.write(
            "camera.toml",
            b"[[camera]]\nname = \"front\"\nsource = { kind = \"teleporter\" }\n",
        );
        files
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn write(&self, name: &str, bytes: &[u8]) {
        let path = self.path(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, bytes).unwrap();
    }

    /// `words`, with `@name` as the path of the file `name`.
    fn arguments(&self, words: &str) -> Vec<String> {
        let path =
            |word: &str| word.strip_prefix('@').map(|name| self.path(name).display().to_string());
        words.split_whitespace().map(|word| path(word).unwrap_or_else(|| word.to_owned())).collect()
    }
}

fn encoded(image: &GrayImage, format: ImageFormat) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    image.write_to(&mut bytes, format).unwrap();
    bytes.into_inner()
}

/// A PNG that ends after its header.
fn png_header(width: u32, height: u32) -> Vec<u8> {
    let mut header = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR".to_vec();
    header.extend(width.to_be_bytes());
    header.extend(height.to_be_bytes());
    header.extend(b"\x08\x00\x00\x00\x00\0\0\0\0");
    header
}

/// Command, exit code, and words that the one line must hold.
const TABLE: &[(&str, i32, &[&str])] = &[
    ("", 2, &["a command is missing", "--help"]),
    ("calibrat", 2, &["calibrat", "--help"]),
    ("detect @gray.jpg", 2, &["--board"]),
    ("detect --board 9x6", 2, &["PATH"]),
    ("detect --board 9 @gray.jpg", 2, &["`9`", "COLSxROWS", "9x6"]),
    ("detect --board 2x2 @gray.jpg", 2, &["2x2", "3 to 100", "inner corners"]),
    ("detect --board 9x6 --repeat 0 @gray.jpg", 2, &["--repeat"]),
    ("detect --board 9x6 --json @gone.jpg", 1, &["gone.jpg", "cannot be read", "check the path"]),
    ("detect --board 9x6 --json @cut.jpg", 1, &["cut.jpg", "cut off"]),
    ("detect --board 9x6 --json @empty.png", 1, &["empty.png", "0 bytes"]),
    ("detect --board 9x6 --json @huge.png", 1, &["huge.png", "20000x10000", "120 megapixels"]),
    ("detect --board 9x6 --json @words.png", 1, &["words.png", "not an image"]),
    ("detect --board 9x6 --json @nothing", 1, &["nothing", "no images in this folder"]),
    ("detect --board 9x6 --json @*.bmp", 1, &["*.bmp", "no file has such a name"]),
    (
        "detect --board 9x6 --json @cut.jpg @empty.png",
        1,
        &["2 images could not be read", "cut.jpg"],
    ),
    ("calibrate --board 9x6 @gray.jpg", 2, &["--square"]),
    ("calibrate --board 9x6 --square 25 @gray.jpg", 2, &["`25`", "25mm"]),
    ("calibrate --board 9x6 --square 50m @gray.jpg", 2, &["50 m", "25mm"]),
    ("calibrate --board 2x2 --square 25mm @gray.jpg", 2, &["2x2", "3 to 100"]),
    (
        "calibrate --board 9x6 --square 25mm --lens fisheye @gray.jpg",
        2,
        &["fisheye", "kannala_brandt"],
    ),
    ("calibrate --board 9x6 --square 25mm --json --format ros @gray.jpg", 2, &["--out"]),
    (
        "calibrate --board 9x6 --square 25mm @gone.jpg @gray.jpg",
        1,
        &["gone.jpg", "no such file", "check the path"],
    ),
    ("calibrate --board 9x6 --square 25mm @nothing", 1, &["nothing", "no images in this folder"]),
    ("calibrate --board 9x6 --square 25mm @cut.mcap", 1, &["cut.mcap"]),
    ("calibrate --board 9x6 --square 25mm @words.mcap", 1, &["words.mcap"]),
    ("calibrate --board 9x6 --square 25mm @cut.jpg", 1, &["cut.jpg", "cut off"]),
    ("calibrate --board 9x6 --square 25mm @empty.png", 1, &["empty.png", "0 bytes"]),
    ("calibrate --board 9x6 --square 25mm @dot.png", 1, &["dot.png", "1x1", "too small"]),
    ("calibrate --board 9x6 --square 25mm @huge.png", 1, &["huge.png", "120 megapixels"]),
    ("calibrate --board 9x6 --square 25mm @gray.jpg", 1, &["gray.jpg", "board"]),
    (
        "calibrate --board 9x6 --square 25mm @gray.jpg @gray.jpg",
        1,
        &["no 9x6 chessboard", "any of 2 images", "gray.jpg"],
    ),
    (
        "calibrate --board 9x6 --square 25mm @gray.jpg @small",
        1,
        &["64x48", "320x240", "each image size"],
    ),
    ("solve", 2, &["PROBLEM.json"]),
    ("solve @gone.json", 1, &["gone.json", "cannot be read"]),
    ("solve @nan.json", 1, &["nan.json", "views[0].image[0][1]", "NaN", "finite"]),
    ("solve @few.json", 1, &["few.json", "view"]),
    ("solve @marked.json", 1, &["marked.json", "view"]),
    ("solve @telescope.json", 1, &["telescope.json: given: fx", "0.01 degrees", "640x480"]),
    (
        "solve --given cx=9999 @few.json",
        2,
        &["--given: cx = 9999 px is impossible", "-6400 to 7040 px"],
    ),
    ("solve @fields.json", 1, &["fields.json", "views[0].image", "missing"]),
    ("solve @size.json", 1, &["size.json", "image_size"]),
    ("solve @syntax.json", 1, &["syntax.json", "not JSON at line 1"]),
    ("solve --skew @dlt.json", 2, &["the method dlt", "leave out --lens"]),
    (
        "target --target @board.toml --out @syntax.pdf",
        1,
        &["syntax.json", "another file is there", "another name"],
    ),
    ("verify --calibration @few.json --board 9x6 @gray.jpg", 1, &["few.json", "missing"]),
    ("verify --calibration @gone.json --board 9x6 @gray.jpg", 1, &["gone.json", "cannot be read"]),
    ("record --camera front --out @new.mcap --config @gone.toml", 2, &["gone.toml"]),
    (
        "record --camera front --out @new.mcap --config @back.toml",
        2,
        &["back.toml", "front", "back"],
    ),
    (
        "record --camera back --out @new.mcap --config @back.toml --seconds 0",
        2,
        &["--seconds", "above 0"],
    ),
    ("record --camera back --out @none/new.mcap --config @back.toml", 1, &["new.mcap"]),
    ("focus --focal 8 --f-number 2 --pixel 3.45um --focus 1m", 2, &["`8`", "25mm"]),
    ("focus --focal 8mm --f-number 0 --pixel 3.45um --focus 1m", 2, &["f-number", "positive"]),
    ("focus --focal 8mm --f-number 2 --pixel 3.45um --focus 10mm", 2, &["focus", "focal length"]),
    ("serve --config @gone.toml", 2, &["gone.toml"]),
    ("serve --config @key.toml", 2, &["key.toml:2", "portt", "unknown"]),
    ("serve --config @camera.toml", 2, &["camera.toml:3", "teleporter"]),
    ("serve --listen 8600", 2, &["8600"]),
    ("export --calibration @gone.json --format ros", 1, &["gone.json", "cannot be read"]),
    ("export --calibration @few.json --format ros", 1, &["few.json", "id", "missing"]),
    ("export --calibration @few.json --format ros --width 320", 2, &["--height"]),
    ("export --calibration @few.json --format matlab", 2, &["matlab", "kalibr"]),
];

#[test]
fn each_has_its_one_line_and_its_exit_code() {
    let files = BadFiles::new();
    for (words, code, fragments) in TABLE {
        let finished = plumb(files.arguments(words));
        let line = one_line(words, &finished.stderr);
        assert_eq!(finished.code, Some(*code), "`plumb {words}`: {line}");
        for fragment in *fragments {
            assert!(line.contains(fragment), "`plumb {words}` does not say `{fragment}`: {line}");
        }
    }
}

/// The line, which must be the only one, of a length that a person reads.
fn one_line<'a>(words: &str, stderr: &'a str) -> &'a str {
    let lines: Vec<&str> = stderr.lines().collect();
    let [line] = lines.as_slice() else { panic!("`plumb {words}` says not one line: {stderr}") };
    assert!(line.starts_with("plumb: ") && line.len() < 500, "`plumb {words}`: {line}");
    line
}

#[test]
fn a_port_in_use() {
    let files = BadFiles::new();
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    let finished =
        plumb(files.arguments(&format!("serve --config @nothing.toml --listen {address}")));
    let line = one_line("serve", &finished.stderr);
    assert_eq!(finished.code, Some(1), "{line}");
    assert!(line.contains(&address) && line.contains("--listen"), "{line}");
}

#[test]
fn a_bad_image_among_good_ones_costs_only_itself() {
    let files = BadFiles::new();
    let finished =
        plumb(files.arguments("detect --board 9x6 --json @cut.jpg @gray.jpg @gone.jpg @dot.png"));
    assert_eq!(finished.code, Some(1));
    let lines: Vec<serde_json::Value> =
        finished.stdout.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let names: Vec<&str> =
        lines.iter().map(|line| file_name(line["path"].as_str().unwrap())).collect();
    assert_eq!(names, ["cut.jpg", "gray.jpg", "gone.jpg", "dot.png"]);
    for line in &lines {
        assert!(line["found"] == false && line["reason"].is_string(), "{line}");
    }
    assert_eq!((&lines[1]["width"], &lines[1]["height"]), (&320.into(), &240.into()));
}

fn file_name(path: &str) -> &str {
    Path::new(path).file_name().unwrap().to_str().unwrap()
}
