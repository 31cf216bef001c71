//! The folder tree is the architecture: who may use whom, which crates stay in which folder, and that every
//! shared constant has one home. Read from the source text, so that no feature has to be built.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// Used by everybody, and using nobody but each other as listed.
const LEAVES: [&str; 6] = ["error", "limits", "config", "math", "stages", "threads"];

/// Every module of the crate and what it may use besides [`LEAVES`]. DESIGN: dependencies point one way, and
/// `cpu` and `gpu` never see each other.
const MAY_USE: &[(&str, &[&str])] = &[
    ("error", &[]),
    ("limits", &[]),
    ("config", &[]),
    ("math", &[]),
    ("stages", &[]),
    ("threads", &[]),
    ("model", &[]),
    ("mesh", &["model"]),
    ("measure", &[]),
    ("layout", &["model"]),
    ("build", &["model", "mesh", "measure", "layout"]),
    ("external", &["model", "mesh", "layout", "build"]),
    ("lod", &["model"]),
    ("finish", &["model", "mesh", "measure", "build", "lod"]),
    ("decimate", &["model", "mesh", "build", "lod"]),
    ("tile", &["model", "lod"]),
    ("format", &["model", "layout"]),
    ("stream", &["model", "format"]),
    ("read", &[]),
    ("gpu_types", &[]),
    ("processor", &[]),
    ("scene", &["model"]),
    ("displace", &["scene"]),
    ("views", &["model", "scene", "stream"]),
    ("shadow", &["model", "scene", "stream"]),
    ("cpu", &["model", "lod", "gpu_types", "scene", "stream", "views", "shadow"]),
    ("gpu", &["model", "gpu_types", "scene", "stream", "views"]),
    ("render", &["model", "lod", "gpu_types", "scene", "stream", "views", "shadow", "cpu", "gpu"]),
    (
        "python",
        &[
            "model",
            "mesh",
            "measure",
            "build",
            "external",
            "lod",
            "finish",
            "decimate",
            "displace",
            "tile",
            "format",
            "stream",
            "read",
            "gpu_types",
            "scene",
            "views",
            "render",
            "processor",
        ],
    ),
];

/// What the leaves may use of each other.
const LEAF_MAY_USE: &[(&str, &[&str])] = &[
    ("error", &[]),
    ("limits", &[]),
    ("math", &[]),
    ("config", &["error", "limits", "stages"]),
    ("stages", &[]),
    ("threads", &["error"]),
];

/// Crates that stay in one folder.
const CONFINED: &[(&str, &str)] =
    &[("pyo3", "python"), ("numpy", "python"), ("wgpu", "gpu"), ("metis", "build")];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("src")
}

fn rust_files(folder: &Path, out: &mut Vec<PathBuf>) {
    let mut entries: Vec<_> = fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    entries.sort();
    for path in entries {
        if path.is_dir() {
            rust_files(&path, out);
        } else if path.extension().is_some_and(|e| e == "rs") {
            out.push(path);
        }
    }
}

/// One line of code, without comments and strings.
struct Line {
    file: String,
    number: usize,
    module: String,
    code: String,
}

impl Line {
    fn place(&self) -> String {
        format!("src/{}:{}: {}", self.file, self.number, self.code.trim())
    }
}

/// All code lines of the crate, up to each file's unit tests.
fn code() -> Vec<Line> {
    let mut files = Vec::new();
    rust_files(&root(), &mut files);
    let mut out = Vec::new();
    for path in files {
        let relative = path.strip_prefix(root()).unwrap().to_str().unwrap().replace('\\', "/");
        if relative == "lib.rs" {
            continue;
        }
        let module = relative.split('/').next().unwrap().trim_end_matches(".rs").to_owned();
        let text = fs::read_to_string(&path).unwrap();
        for (number, line) in text.lines().enumerate() {
            if line.trim() == "#[cfg(test)]" {
                break;
            }
            let code = without_strings(line.split("//").next().unwrap());
            out.push(Line { file: relative.clone(), number: number + 1, module: module.clone(), code });
        }
    }
    out
}

fn without_strings(code: &str) -> String {
    code.split('"').step_by(2).collect()
}

fn is_word(c: char) -> bool {
    c.is_alphanumeric() || c == '_'
}

/// Identifiers and numbers of a line.
fn words(code: &str) -> impl Iterator<Item = &str> {
    code.split(|c| !is_word(c)).filter(|w| !w.is_empty())
}

/// What follows each `crate::` in a line; a brace list counts each of its entries.
fn crate_paths(code: &str) -> Vec<String> {
    let mut out = Vec::new();
    for rest in code.split("crate::").skip(1) {
        let names = match rest.strip_prefix('{') {
            Some(list) => list.split(',').collect(),
            None => vec![rest],
        };
        out.extend(names.iter().filter_map(|n| words(n).next()).map(str::to_owned));
    }
    out
}

#[test]
fn dependencies_point_one_way() {
    let allowed: BTreeMap<&str, &[&str]> = MAY_USE.iter().copied().collect();
    let leaf_allowed: BTreeMap<&str, &[&str]> = LEAF_MAY_USE.iter().copied().collect();
    let mut violations = Vec::new();
    let mut seen = 0;
    for line in code() {
        for path in crate_paths(&line.code) {
            // Re-exports at the crate root: Error and Result.
            let used = if path.starts_with(char::is_uppercase) { "error" } else { path.as_str() };
            let module = line.module.as_str();
            if used == module {
                continue;
            }
            seen += 1;
            let fine = match leaf_allowed.get(module) {
                Some(list) => list.contains(&used),
                None => LEAVES.contains(&used) || allowed.get(module).is_some_and(|l| l.contains(&used)),
            };
            if !fine {
                violations.push(format!("{module} may not use {used}: {}", line.place()));
            }
        }
    }
    assert!(seen > 40, "the test reads the use lines of the crate");
    assert!(violations.is_empty(), "\n{}", violations.join("\n"));
}

#[test]
fn modules_reach_each_other_only_by_crate_paths() {
    let violations: Vec<_> = code()
        .iter()
        .filter(|line| {
            let depth = line.file.matches('/').count();
            let ups = line.code.matches("super::").count();
            // `super` from src/a/b.rs stays in a; once more leaves it.
            line.code.contains("super::super::") && ups > depth.max(1)
        })
        .map(Line::place)
        .collect();
    assert!(violations.is_empty(), "\n{}", violations.join("\n"));
}

#[test]
fn every_module_stands_in_the_table() {
    let text = fs::read_to_string(root().join("lib.rs")).unwrap();
    let declared: Vec<&str> = text
        .lines()
        .filter_map(|l| l.trim().trim_start_matches("pub ").strip_prefix("mod ")?.strip_suffix(';'))
        .collect();
    assert!(declared.len() >= 8, "{declared:?}");
    for module in declared {
        assert!(MAY_USE.iter().any(|(name, _)| *name == module), "{module} is in no row of MAY_USE");
    }
}

#[test]
fn confined_crates_stay_home() {
    let violations: Vec<_> = code()
        .iter()
        .flat_map(|line| CONFINED.iter().map(move |c| (line, c)))
        .filter(|(line, (name, home))| line.module != *home && words(&line.code).any(|w| w == *name))
        .map(|(line, (name, home))| format!("{name} belongs under src/{home}/: {}", line.place()))
        .collect();
    assert!(violations.is_empty(), "\n{}", violations.join("\n"));
}

/// Numbers that are limits of clusters, groups and pages: written out nowhere but in limits.rs.
#[test]
fn limits_have_one_home() {
    let violations: Vec<_> = code()
        .iter()
        .filter(|line| line.module != "limits")
        .filter(|line| {
            words(&line.code).any(|w| {
                let digits = w.replace('_', "");
                let digits = digits.trim_end_matches("usize").trim_end_matches("u32");
                ["128", "131072", "33554432"].contains(&digits)
            }) || line.code.contains("<< 7")
                || line.code.contains("<< 25")
        })
        .map(Line::place)
        .collect();
    assert!(violations.is_empty(), "use a constant of limits.rs:\n{}", violations.join("\n"));
}

#[test]
fn no_public_constant_is_declared_twice() {
    let mut homes: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for line in code() {
        let code = line.code.trim_start();
        if let Some((before, after)) = code.split_once("const ")
            // Private ones are a file's own affair, such as the size of a chunk of work.
            && before.starts_with("pub")
            && let Some((name, _)) = after.split_once(':')
            && name.chars().all(|c| c.is_ascii_uppercase() || c.is_ascii_digit() || c == '_')
            && name.len() > 1
            // Associated constants such as `Aabb::EMPTY` are indented and named by their type.
            && !line.code.starts_with(' ')
        {
            homes.entry(name.to_owned()).or_default().push(line.place());
        }
    }
    assert!(homes.len() > 10, "the test finds the constants");
    let twice: Vec<_> = homes.values().filter(|places| places.len() > 1).map(|p| p.join("\n")).collect();
    assert!(twice.is_empty(), "\n{}", twice.join("\n"));
}

/// Folders whose files import each other in one direction only. In the others a file may use what its folder shares.
const WITHOUT_CYCLES: &[&str] = &[
    "cpu", "decimate", "displace", "finish", "gpu", "layout", "lod", "math", "read", "scene", "stream",
    "views",
];

/// The files of a folder that each of its files uses by `super::`.
fn imports(folder: &str) -> BTreeMap<String, Vec<String>> {
    let mut sources: BTreeMap<String, String> = BTreeMap::new();
    for line in code() {
        if let Some(file) = line.file.strip_prefix(&format!("{folder}/")).and_then(|f| f.strip_suffix(".rs"))
            && !file.contains('/')
            && file != "mod"
        {
            sources.entry(file.to_owned()).or_default().push_str(&(line.code + "\n"));
        }
    }
    let used = |source: &str| -> Vec<String> {
        let mut names = Vec::new();
        for rest in source.split("super::").skip(1) {
            let list = rest.strip_prefix('{').map_or(rest, |list| list.split(';').next().unwrap_or_default());
            let entries = if rest.starts_with('{') { list.split(',').collect() } else { vec![list] };
            names.extend(entries.iter().filter_map(|entry| words(entry).next()).map(str::to_owned));
        }
        names.retain(|name| sources.contains_key(name));
        names
    };
    sources.iter().map(|(file, source)| (file.clone(), used(source))).collect()
}

/// A cycle among imports, if there is one: files that remain when those that use no remaining file are taken away.
fn cycle(mut imports: BTreeMap<String, Vec<String>>) -> Vec<String> {
    loop {
        let known: Vec<String> = imports.keys().cloned().collect();
        let before = known.len();
        imports.retain(|file, used| used.iter().any(|name| name != file && known.contains(name)));
        if imports.len() == before {
            return known;
        }
    }
}

#[test]
fn files_of_a_folder_import_each_other_one_way() {
    for folder in WITHOUT_CYCLES {
        let imports = imports(folder);
        assert!(!imports.is_empty(), "src/{folder} has no files");
        assert_eq!(cycle(imports), Vec::<String>::new(), "an import cycle in src/{folder}");
    }
    assert!(imports("gpu").values().map(Vec::len).sum::<usize>() > 60, "the test reads the use lines");
}

#[test]
fn a_cycle_would_be_seen() {
    let graph = |edges: &[(&str, &[&str])]| {
        edges
            .iter()
            .map(|(file, used)| ((*file).to_owned(), used.iter().map(|u| (*u).to_owned()).collect()))
            .collect()
    };
    assert!(cycle(graph(&[("a", &["b", "c"]), ("b", &["c"]), ("c", &[])])).is_empty());
    assert_eq!(cycle(graph(&[("a", &["b"]), ("b", &["c"]), ("c", &["b"])])), ["a", "b", "c"]);
}

#[test]
fn a_fault_would_be_seen() {
    assert_eq!(crate_paths("use crate::{lod, model::Dag};"), ["lod", "model"]);
    assert_eq!(crate_paths("let x: crate::cpu::Stage = crate::Error::x();"), ["cpu", "Error"]);
    assert_eq!(without_strings(r#"let a = "crate::gpu"; b"#), "let a = ; b");
}
