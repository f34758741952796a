//! A folder to test in: a pipeline, models, the command, and what it said.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::{env, fs};

use serde_json::Value;

/// The command under test.
pub(crate) const KILN: &str = env!("CARGO_BIN_EXE_kiln");

/// A temporary folder that goes with the value.
pub(crate) struct Space {
    folder: tempfile::TempDir,
}

/// What a run of the command came to.
#[derive(Debug)]
pub(crate) struct Ran {
    pub(crate) code: i32,
    pub(crate) stdout: String,
    pub(crate) stderr: String,
}

impl Ran {
    /// The run, if it ended with `code`; else the test fails with what was said.
    #[track_caller]
    pub(crate) fn expect(self, code: i32) -> Ran {
        assert_eq!(self.code, code, "stdout:\n{}\nstderr:\n{}", self.stdout, self.stderr);
        self
    }

    pub(crate) fn json(&self) -> Value {
        serde_json::from_str(&self.stdout).unwrap_or_else(|e| panic!("{e}: {}", self.stdout))
    }
}

/// A path below the repository's root.
pub(crate) fn repository(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(path)
}

/// `Some(value)` or a said skip, which is a failure where everything is required.
pub(crate) fn needs<T>(value: Option<T>, what: &str) -> Option<T> {
    if value.is_none() {
        assert!(env::var_os("KILN_REQUIRE_ALL").is_none(), "this test needs {what}");
        eprintln!("skipped: needs {what}");
    }
    value
}

/// A model of the corpus.
pub(crate) fn corpus(path: &str) -> Option<PathBuf> {
    let folder = env::var_os("KILN_CORPUS").map(PathBuf::from).filter(|folder| folder.is_dir());
    needs(folder.map(|folder| folder.canonicalize().unwrap().join(path)), "KILN_CORPUS")
}

/// Runs a command to its end.
pub(crate) fn finished(command: &mut Command) -> Ran {
    let output = command.output().unwrap();
    Ran {
        code: output.status.code().unwrap_or(-1),
        stdout: String::from_utf8(output.stdout).unwrap(),
        stderr: String::from_utf8_lossy(&output.stderr).into_owned(),
    }
}

/// All files under a folder, sorted.
pub(crate) fn files_under(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut open = vec![folder.to_owned()];
    while let Some(folder) = open.pop() {
        for entry in fs::read_dir(&folder).into_iter().flatten().flatten() {
            if entry.path().is_dir() { open.push(entry.path()) } else { found.push(entry.path()) }
        }
    }
    found.sort();
    found
}

impl Space {
    pub(crate) fn new() -> Space {
        Space { folder: tempfile::tempdir().unwrap() }
    }

    pub(crate) fn path(&self, path: &str) -> PathBuf {
        self.folder.path().join(path)
    }

    /// Writes a file, folders included.
    pub(crate) fn write(&self, path: &str, content: impl AsRef<[u8]>) -> PathBuf {
        let path = self.path(path);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(&path, content).unwrap();
        path
    }

    pub(crate) fn read(&self, path: &str) -> Vec<u8> {
        fs::read(self.path(path)).unwrap()
    }

    /// Copies a fixture.
    pub(crate) fn fixture(&self, name: &str) {
        self.write(name, fs::read(repository("fixtures").join(name)).unwrap());
    }

    /// Writes `NAME.gltf` and the `data.bin` beside it: one submesh of these faces, called NAME.
    pub(crate) fn gltf(&self, name: &str, positions: &[[f32; 3]], normals: Option<&[[f32; 3]]>, faces: &[[u16; 3]]) {
        let mut bytes: Vec<u8> = positions.iter().flatten().flat_map(|c| c.to_le_bytes()).collect();
        let (count, length) = (positions.len(), bytes.len());
        let bound = |start: f32, of: fn(f32, f32) -> f32| {
            [0, 1, 2].map(|k| positions.iter().map(|p| p[k]).fold(start, of)).to_vec()
        };
        let (least, greatest) = (bound(f32::MAX, f32::min), bound(f32::MIN, f32::max));
        let mut accessors = vec![serde_json::json!({
            "bufferView": 0, "componentType": 5126, "count": count, "type": "VEC3", "min": least, "max": greatest
        })];
        let mut views = vec![serde_json::json!({ "buffer": 0, "byteLength": length })];
        let mut attributes = serde_json::json!({ "POSITION": 0 });
        if let Some(normals) = normals {
            bytes.extend(normals.iter().flatten().flat_map(|c| c.to_le_bytes()));
            views.push(serde_json::json!({ "buffer": 0, "byteOffset": length, "byteLength": length }));
            let accessor =
                serde_json::json!({ "bufferView": 1, "componentType": 5126, "count": count, "type": "VEC3" });
            accessors.push(accessor);
            attributes["NORMAL"] = 1.into();
        }
        let indices = bytes.len();
        bytes.extend(faces.iter().flatten().flat_map(|v| v.to_le_bytes()));
        views.push(serde_json::json!({ "buffer": 0, "byteOffset": indices, "byteLength": 6 * faces.len() }));
        let list = views.len() - 1;
        accessors.push(
            serde_json::json!({ "bufferView": list, "componentType": 5123, "count": 3 * faces.len(), "type": "SCALAR" }),
        );
        let model = serde_json::json!({
            "asset": { "version": "2.0" }, "scene": 0, "scenes": [{ "nodes": [0] }], "nodes": [{ "name": name, "mesh": 0 }],
            "meshes": [{ "primitives": [{ "attributes": attributes, "indices": list }] }],
            "accessors": accessors, "bufferViews": views,
            "buffers": [{ "uri": "data.bin", "byteLength": bytes.len() }],
        });
        self.write(&format!("{name}.gltf"), model.to_string());
        self.write("data.bin", bytes);
    }

    /// The command with arguments, in this folder.
    pub(crate) fn command(&self, args: impl IntoIterator<Item = impl AsRef<OsStr>>) -> Command {
        let mut command = Command::new(KILN);
        command.args(args).current_dir(self.folder.path()).stdin(Stdio::null());
        command
    }

    /// Runs the command to its end.
    pub(crate) fn run(&self, args: impl IntoIterator<Item = impl AsRef<OsStr>>) -> Ran {
        finished(&mut self.command(args))
    }

    /// Builds `pipeline.toml` on the CPU backend and gives the JSON report.
    #[track_caller]
    pub(crate) fn build(&self) -> Value {
        self.run(["build", "pipeline.toml", "--backend", "cpu", "--json"]).expect(0).json()
    }

    /// Every file below the folder but for the cache, with its bytes, sorted.
    pub(crate) fn files(&self) -> Vec<(String, Vec<u8>)> {
        let mut found = Vec::new();
        let mut folders = vec![self.folder.path().to_path_buf()];
        while let Some(folder) = folders.pop() {
            for entry in fs::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                if path.is_dir() {
                    if path.file_name() != Some(OsStr::new(".kiln")) {
                        folders.push(path);
                    }
                } else {
                    let name = path.strip_prefix(self.folder.path()).unwrap().to_string_lossy().into_owned();
                    found.push((name, fs::read(&path).unwrap()));
                }
            }
        }
        found.sort();
        found
    }
}

/// The stages of the first asset that ran, by id.
pub(crate) fn ran(report: &Value) -> Vec<String> {
    stages(report, "ran")
}

fn stages(report: &Value, state: &str) -> Vec<String> {
    let all = report["assets"].as_array().unwrap().iter().flat_map(|a| a["stages"].as_array().unwrap());
    all.filter(|s| s["state"] == state).map(|s| s["stage"].as_str().unwrap().to_owned()).collect()
}

/// The common chain on a small model: quick enough for tests that build often.
pub(crate) const SMALL: &str = r#"
kiln = 1
[asset]
input = "model.glb"
output = "out/model.kiln"
[[stage]]
id = "whole"
kind = "merge"
[[stage]]
id = "base"
kind = "simplify"
levels = [{ keep = 0.25 }]
[[stage]]
kind = "atlas"
size = 256
padding = 4
[[stage]]
id = "lods"
kind = "simplify"
levels = [{ keep = 0.25 }, { keep = 0.1 }]
[[stage]]
kind = "bake"
high = "whole"
size = 256
dilation = 2
[[stage]]
kind = "pack"
"#;

/// A folder with [`SMALL`] as `pipeline.toml` and the fixture as `model.glb`.
pub(crate) fn small(fixture: &str) -> Space {
    let space = Space::new();
    space.write("pipeline.toml", SMALL);
    space.write("model.glb", fs::read(repository("fixtures").join(fixture)).unwrap());
    space
}

/// A copy of `pipelines/` and `fixtures/`, so that nothing is written into the project.
pub(crate) fn copied(pipeline: &str) -> Space {
    let space = Space::new();
    space.write(&format!("pipelines/{pipeline}"), fs::read(repository("pipelines").join(pipeline)).unwrap());
    for entry in fs::read_dir(repository("fixtures")).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|e| e == "glb") {
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            space.write(&format!("fixtures/{name}"), fs::read(&path).unwrap());
        }
    }
    space
}
