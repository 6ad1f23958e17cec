//! Inside a layer, too, nothing is imported in a ring: the files of each folder of `src`, as a
//! graph of imports, have no circle, nor have the folders that lie in one folder. Read top down,
//! each file is understood from those below it.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// Folders that still have circles. It only ever gets shorter.
const CIRCLES_NOT_YET: &[&str] = &[];

/// A module by its path from the crate's root: `["geometry", "lens"]`.
type Module = Vec<String>;

#[test]
fn no_file_of_a_layer_imports_itself_by_way_of_others() {
    let files = module_files();
    let imports = imports_between(&files);
    let edges: usize = imports.values().map(BTreeSet::len).sum();
    assert!(edges > 3 * files.len(), "only {edges} imports were read: the reading is broken");

    let mut faults = Vec::new();
    for circle in circles(&imports) {
        let layer = &circle[0][0];
        if !CIRCLES_NOT_YET.contains(&layer.as_str()) {
            faults.push(described(&circle, &imports));
        }
    }
    assert!(faults.is_empty(), "{} circles:\n{}", faults.len(), faults.join("\n"));
}

#[test]
fn no_folder_imports_itself_by_way_of_its_siblings() {
    let files = module_files();
    let folders = sibling_folders(&imports_between(&files));
    let edges: usize = folders.values().map(BTreeSet::len).sum();
    assert!(edges > 10, "only {edges} imports between folders were read: the reading is broken");
    let imports = by_reference(&folders);
    let faults: Vec<String> =
        circles(&imports).iter().map(|circle| described(circle, &imports)).collect();
    assert!(faults.is_empty(), "{} circles:\n{}", faults.len(), faults.join("\n"));
}

#[test]
fn folders_that_import_each_other_by_different_files_are_a_circle() {
    let texts = [
        ("a::b::first", "use crate::a::c::second::Second;"),
        ("a::b::third", ""),
        ("a::c::second", ""),
        ("a::c::fourth", "use crate::a::b::third::Third;"),
    ];
    let files: BTreeMap<Module, String> =
        texts.iter().map(|(name, text)| (path(name), (*text).to_owned())).collect();
    let imports = imports_between(&files);
    assert!(circles(&imports).is_empty());
    let folders = sibling_folders(&imports);
    assert_eq!(circles(&by_reference(&folders)), [["a::b", "a::c"].map(path).to_vec()]);
}

#[test]
fn a_folder_without_circles_leaves_the_list() {
    let files = module_files();
    let imports = imports_between(&files);
    let circles = circles(&imports);
    for folder in CIRCLES_NOT_YET {
        let has_circle = circles.iter().any(|circle| circle[0][0] == *folder);
        assert!(has_circle, "`{folder}` has no circle any more: take it off CIRCLES_NOT_YET");
    }
}

#[test]
fn imports_are_read_in_each_of_their_forms() {
    let modules = ["a", "a::b", "a::b::c", "a::d", "e"];
    let files: BTreeMap<Module, String> =
        modules.iter().map(|name| (path(name), String::new())).collect();
    let text = "use crate::a::{self, b::{c::Deep, Inner}, d};\nuse super::e_not::X;\n\
                // use crate::e::Commented;\nfn f() -> crate::e::Y { c::deep() }\n\
                #[cfg(test)]\nmod tests {\n    use crate::f::Z;\n}\n";
    let read = imported(&path("a::b"), text, &files);
    let expected: BTreeSet<Module> = ["a", "a::b::c", "a::d", "e"].map(path).into();
    assert_eq!(read, expected);
    let test_only = "#[cfg(test)]\nmod tests {\n    use crate::e::Z;\n}\n";
    assert!(imported(&path("a::d"), test_only, &files).is_empty());
}

fn path(name: &str) -> Module {
    name.split("::").map(str::to_owned).collect()
}

/// What each module imports.
fn imports_between(files: &BTreeMap<Module, String>) -> BTreeMap<&Module, BTreeSet<Module>> {
    files.iter().map(|(module, text)| (module, imported(module, text, files))).collect()
}

/// The imports between folders that lie in the same folder, by any of their files.
fn sibling_folders(
    imports: &BTreeMap<&Module, BTreeSet<Module>>,
) -> BTreeMap<Module, BTreeSet<Module>> {
    let parents =
        imports.keys().flat_map(|module| (2..module.len()).map(move |n| module[..n].to_vec()));
    let folders: BTreeSet<Module> = parents.collect();
    let mut between: BTreeMap<Module, BTreeSet<Module>> = BTreeMap::new();
    for (from, imported) in imports {
        for to in imported {
            let common = from.iter().zip(to).take_while(|(a, b)| a == b).count();
            let (Some(from), Some(to)) = (from.get(..=common), to.get(..=common)) else { continue };
            if common > 0 && folders.contains(from) && folders.contains(to) {
                between.entry(from.to_vec()).or_default().insert(to.to_vec());
            }
        }
    }
    between
}

fn by_reference(
    imports: &BTreeMap<Module, BTreeSet<Module>>,
) -> BTreeMap<&Module, BTreeSet<Module>> {
    imports.iter().map(|(module, imported)| (module, imported.clone())).collect()
}

/// The circle's modules, and each import between them.
fn described(circle: &[Module], imports: &BTreeMap<&Module, BTreeSet<Module>>) -> String {
    let mut text = format!("{} modules of `{}`:", circle.len(), circle[0][0]);
    for module in circle {
        let inside = imports[module].iter().filter(|to| circle.contains(to));
        let names: Vec<String> = inside.map(|to| to.join("::")).collect();
        text += &format!("\n    {} -> {}", module.join("::"), names.join(", "));
    }
    text
}

/// Strongly connected components of two modules and more that lie inside one top folder.
fn circles(imports: &BTreeMap<&Module, BTreeSet<Module>>) -> Vec<Vec<Module>> {
    let reached: BTreeMap<&Module, BTreeSet<&Module>> =
        imports.keys().map(|module| (*module, reachable(module, imports))).collect();
    let mut found: Vec<Vec<Module>> = Vec::new();
    for module in imports.keys() {
        if found.iter().any(|circle| circle.contains(module)) {
            continue;
        }
        let back = reached[module].iter().filter(|other| reached[**other].contains(module));
        let circle: Vec<Module> = back.map(|other| (*other).clone()).collect();
        if circle.len() > 1 {
            found.push(circle);
        }
    }
    found
}

/// What a module reaches by imports inside its own top folder.
fn reachable<'a>(
    from: &Module,
    imports: &'a BTreeMap<&'a Module, BTreeSet<Module>>,
) -> BTreeSet<&'a Module> {
    let mut reached = BTreeSet::new();
    let mut open: Vec<&Module> = imports[from].iter().collect();
    while let Some(module) = open.pop() {
        if module[0] == from[0] && imports.contains_key(module) && reached.insert(module) {
            open.extend(&imports[module]);
        }
    }
    reached
}

/// Every module of `src` that is not for tests alone, with its text.
fn module_files() -> BTreeMap<Module, String> {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut paths = Vec::new();
    visit(&src, &mut paths);
    let mut files = BTreeMap::new();
    for file in paths {
        let relative = file.strip_prefix(&src).unwrap().with_extension("");
        let mut module: Module =
            relative.iter().map(|part| part.to_str().unwrap().to_owned()).collect();
        if module.last().is_some_and(|last| last == "mod") {
            module.pop();
        }
        let last = module.last().unwrap().as_str();
        if !last.ends_with("tests") && !["lib", "main"].contains(&last) {
            files.insert(module, fs::read_to_string(&file).unwrap());
        }
    }
    files
}

fn visit(dir: &Path, files: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(dir).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            visit(&path, files);
        } else if path.extension().is_some_and(|e| e == "rs") {
            files.push(path);
        }
    }
}

/// The modules that a file names outside of its tests and comments, itself left out.
fn imported(module: &Module, text: &str, files: &BTreeMap<Module, String>) -> BTreeSet<Module> {
    let named = paths_in(&tokens(&code_of(text))).into_iter();
    let absolute = named.filter_map(|named| absolute(module, &named, files));
    absolute.filter_map(|target| file_of(&target, files)).filter(|to| to != module).collect()
}

/// A file without its tests and comments.
fn code_of(text: &str) -> String {
    let code = text.split("#[cfg(test)]\nmod").next().unwrap();
    let code = code.split("#[cfg(test)]\n#[path").next().unwrap();
    code.lines().map(|line| line.split("//").next().unwrap()).collect::<Vec<_>>().join("\n")
}

/// Identifiers, `::`, `*` and single marks.
fn tokens(code: &str) -> Vec<String> {
    let mut tokens: Vec<String> = Vec::new();
    let mut joins = false;
    for c in code.chars() {
        let part_of_name = c.is_alphanumeric() || c == '_';
        match tokens.last_mut() {
            Some(last) if joins && part_of_name => last.push(c),
            Some(last) if c == ':' && last == ":" => last.push(c),
            _ if !c.is_whitespace() => tokens.push(c.to_string()),
            _ => {}
        }
        joins = part_of_name;
    }
    tokens
}

/// Every path of two segments and more; a tree of `use` gives one for each leaf.
fn paths_in(tokens: &[String]) -> Vec<Module> {
    let mut paths = Vec::new();
    let mut at = 0;
    while at < tokens.len() {
        // `pub(in crate::layer)` imports nothing.
        let visibility = at > 1 && tokens[at - 2..at] == ["(", "in"];
        let joined = tokens.get(at + 1).is_some_and(|next| next == "::");
        let starts = is_name(&tokens[at]) && joined && !visibility;
        at = if starts { tree(tokens, at, &[], &mut paths) } else { at + 1 };
    }
    paths
}

/// Reads a path or a tree of paths that starts `at`, under `prefix`; gives where it ends.
fn tree(tokens: &[String], mut at: usize, prefix: &[String], paths: &mut Vec<Module>) -> usize {
    let mut path = prefix.to_vec();
    while at < tokens.len() {
        if tokens[at] == "{" {
            at += 1;
            while at < tokens.len() && tokens[at] != "}" {
                let next = tree(tokens, at, &path, paths);
                at = next.max(at + 1);
            }
            return at + 1;
        }
        if !is_name(&tokens[at]) {
            break;
        }
        path.push(tokens[at].clone());
        at += 1;
        if tokens.get(at).is_none_or(|next| next != "::") {
            break;
        }
        at += 1;
    }
    if path.len() > prefix.len() {
        paths.push(path);
    }
    at
}

fn is_name(token: &str) -> bool {
    token.starts_with(|c: char| c.is_alphabetic() || c == '_')
}

/// A path as from the crate's root; none where it leads out of the crate.
fn absolute(module: &Module, named: &Module, files: &BTreeMap<Module, String>) -> Option<Module> {
    let rest = named[1..].iter().filter(|part| *part != "self").cloned();
    let child: Module = module.iter().cloned().chain([named[0].clone()]).collect();
    let base = match named[0].as_str() {
        "crate" => Vec::new(),
        "self" => module.clone(),
        "super" => module[..module.len() - 1].to_vec(),
        _ if files.contains_key(&child) => child,
        _ => return None,
    };
    Some(base.into_iter().chain(rest).collect())
}

/// The file that holds what a path names: that of its longest beginning that is a module, or the
/// one from which that module only passes the name on.
fn file_of(target: &Module, files: &BTreeMap<Module, String>) -> Option<Module> {
    let module = (1..=target.len())
        .rev()
        .map(|n| target[..n].to_vec())
        .find(|path| files.contains_key(path))?;
    let Some(name) = target.get(module.len()) else { return Some(module) };
    let passed_on = reexports(&files[&module]).into_iter().find(|path| path.last() == Some(name));
    let defined = passed_on.and_then(|path| absolute(&module, &path, files));
    defined.and_then(|path| file_of(&path, files)).or(Some(module))
}

/// The paths of a file's `pub use`.
fn reexports(text: &str) -> Vec<Module> {
    let tokens = tokens(&code_of(text));
    let mut paths = Vec::new();
    for at in 0..tokens.len() {
        let starts =
            tokens[at] == "use" && at > 0 && ["pub", ")"].contains(&tokens[at - 1].as_str());
        if starts {
            tree(&tokens, at + 1, &[], &mut paths);
        }
    }
    paths
}
