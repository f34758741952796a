//! What no compiler checks: arrows between crates point down, no default dependency wants a system tool, every shader has a
//! twin, every fixture is in the table, every pipeline is built by a test, no machine's path is in a file.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::fs;
use std::path::Path;
use std::process::Command;

use cargo_metadata::{DependencyKind, Metadata, MetadataCommand, PackageId};

/// What each crate of the house may use (DESIGN's table, as ARCHITECTURE.md tells it). A crate that is not listed may not exist.
const LAYERS: &[(&str, &[&str])] = &[
    ("kiln-geom", &[]),
    ("kiln-asset", &["kiln-oiio"]),
    ("kiln-format", &[]),
    ("kiln-gpu", &[]),
    ("kiln-engine", &[]),
    ("kiln-shaders", &[]),
    ("kiln-oiio", &[]),
    ("kiln-xatlas", &[]),
    ("kiln-lod", &["kiln-geom", "kiln-asset", "kiln-gpu", "kiln-shaders"]),
    ("kiln-bake", &["kiln-geom", "kiln-asset", "kiln-gpu", "kiln-shaders", "kiln-xatlas"]),
    ("kiln-measure", &["kiln-geom", "kiln-asset", "kiln-gpu", "kiln-shaders"]),
    ("kiln-runtime", &["kiln-format", "kiln-gpu", "kiln-shaders"]),
    ("kiln-capi", &["kiln-format", "kiln-runtime"]),
    ("kiln-pack", &["kiln-asset", "kiln-format", "kiln-lod", "kiln-geom", "kiln-runtime"]),
    (
        "kiln-pipeline",
        &[
            "kiln-asset",
            "kiln-bake",
            "kiln-engine",
            "kiln-format",
            "kiln-geom",
            "kiln-gpu",
            "kiln-lod",
            "kiln-measure",
            "kiln-oiio",
            "kiln-pack",
            "kiln-runtime",
            "kiln-shaders",
        ],
    ),
    ("kiln-fuzz", &["kiln-asset", "kiln-format", "kiln-pipeline", "kiln-runtime"]),
    (
        "kiln",
        &[
            "kiln-asset",
            "kiln-engine",
            "kiln-format",
            "kiln-gpu",
            "kiln-measure",
            "kiln-oiio",
            "kiln-pack",
            "kiln-pipeline",
            "kiln-runtime",
            "kiln-xatlas",
        ],
    ),
];

/// Packages that need a program or a library beside gcc, g++ and cargo when they are built.
const SYSTEM_BUILDERS: &[&str] =
    &["bindgen", "clang-sys", "cmake", "pkg-config", "nasm-rs", "openssl-sys", "openssl", "vcpkg", "system-deps"];

/// Runs all checks and reports every finding.
pub(crate) fn run(root: &Path) -> Result<(), String> {
    let metadata = MetadataCommand::new()
        .manifest_path(root.join("Cargo.toml"))
        .other_options(vec!["--locked".into()])
        .exec()
        .map_err(|e| format!("cargo metadata: {e}"))?;
    let mut findings = Vec::new();
    layering(&metadata, &mut findings);
    default_dependencies(&metadata, &mut findings);
    shader_twins(root, &mut findings);
    pipelines(root, &mut findings);
    machine_paths(root, &mut findings);
    if let Err(message) = xtask::fixtures::check(root) {
        findings.push(message);
    }
    if findings.is_empty() {
        eprintln!("tidy: layering, default dependencies, shader twins, fixtures, pipelines and paths are in order");
        Ok(())
    } else {
        Err(findings.iter().map(|f| format!("tidy: {f}")).collect::<Vec<_>>().join("\n"))
    }
}

fn layering(metadata: &Metadata, findings: &mut Vec<String>) {
    let allowed: BTreeMap<&str, &[&str]> = LAYERS.iter().copied().collect();
    for package in metadata.workspace_packages() {
        if ["xtask", "kiln-bench", "kiln-tests"].contains(&package.name.as_str()) {
            continue; // chores, benchmarks and tests stand outside the house
        }
        let Some(allowed) = allowed.get(package.name.as_str()) else {
            findings.push(format!("crate {} is not in the layer table", package.name));
            continue;
        };
        for dependency in &package.dependencies {
            let ours = dependency.name == "kiln" || dependency.name.starts_with("kiln-");
            if ours && dependency.kind == DependencyKind::Normal && !allowed.contains(&dependency.name.as_str()) {
                findings.push(format!("{} may not use {}", package.name, dependency.name));
            }
        }
    }
}

/// Walks what `cargo run` and `cargo test --workspace` build by default, all targets' dependencies included.
fn default_dependencies(metadata: &Metadata, findings: &mut Vec<String>) {
    let Some(resolve) = &metadata.resolve else { return };
    let nodes: BTreeMap<&PackageId, _> = resolve.nodes.iter().map(|n| (&n.id, n)).collect();
    let mut seen: BTreeSet<&PackageId> = metadata.workspace_members.iter().collect();
    let mut queue: VecDeque<&PackageId> = seen.iter().copied().collect();
    while let Some(id) = queue.pop_front() {
        let package = &metadata[id];
        if SYSTEM_BUILDERS.contains(&package.name.as_str()) {
            findings.push(format!("default dependency {} {} wants a system tool", package.name, package.version));
        }
        for dependency in nodes.get(id).map(|n| n.deps.as_slice()).unwrap_or_default() {
            // It has its sources with it and asks for the system's library only where an environment variable says so.
            let unused = package.name.as_str() == "zstd-sys" && metadata[&dependency.pkg].name.as_str() == "pkg-config";
            if !unused && seen.insert(&dependency.pkg) {
                queue.push_back(&dependency.pkg);
            }
        }
    }
}

/// Every `shaders/NAME.wgsl` names its twin's path in its opening comment, that file exists and has the same stem or names the shader.
fn shader_twins(root: &Path, findings: &mut Vec<String>) {
    for path in files(&root.join("shaders"), "wgsl") {
        let text = fs::read_to_string(&path).unwrap_or_default();
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let opening = text.lines().take_while(|l| l.starts_with("//")).collect::<Vec<_>>().join(" ");
        let twin =
            opening.split_whitespace().map(|w| w.trim_matches(['`', '.', ',', ';'])).find(|w| w.ends_with(".rs"));
        match twin {
            Some(twin) => match fs::read_to_string(root.join(twin)) {
                Err(_) => findings.push(format!("shader {stem}: no twin at {twin}")),
                Ok(text)
                    if !twin.ends_with(&format!("/{stem}.rs")) && !text.contains(&format!("shaders/{stem}.wgsl")) =>
                {
                    findings.push(format!("shader {stem}: its twin {twin} has another stem and does not name it"));
                }
                Ok(_) => {}
            },
            None => findings.push(format!("shader {stem}: its opening comment names no twin")),
        }
    }
}

/// Every example pipeline is named by an integration test, which builds it.
fn pipelines(root: &Path, findings: &mut Vec<String>) {
    let tests: String = files(&root.join("tests"), "rs").iter().filter_map(|p| fs::read_to_string(p).ok()).collect();
    for path in files(&root.join("pipelines"), "toml") {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if !tests.contains(&name) {
            findings.push(format!("pipelines/{name} is built by no test"));
        }
    }
}

/// No tracked text file names a folder of somebody's machine.
fn machine_paths(root: &Path, findings: &mut Vec<String>) {
    let Ok(output) = Command::new("git").arg("-C").arg(root).args(["ls-files", "-z"]).output() else { return };
    // In two halves, so that this file does not find itself.
    let needles = [["/wor", "k/"], ["/ho", "me/"], ["/roo", "t/"], ["/Use", "rs/"]].map(|halves| halves.concat());
    for name in String::from_utf8_lossy(&output.stdout).split('\0').filter(|n| !n.is_empty()) {
        let Ok(text) = fs::read_to_string(root.join(name)) else { continue };
        for (number, line) in text.lines().enumerate() {
            if needles.iter().any(|n| line.contains(n.as_str())) {
                findings.push(format!("{name}:{}: a path of one machine", number + 1));
            }
        }
    }
}

/// Files with an extension below a folder, sorted.
fn files(folder: &Path, extension: &str) -> Vec<std::path::PathBuf> {
    let mut found = Vec::new();
    let mut folders = vec![folder.to_path_buf()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
            let path = entry.path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == extension) {
                found.push(path);
            }
        }
    }
    found.sort();
    found
}
