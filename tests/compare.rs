//! `kiln compare`: what it says of known pairs, thresholds and exit codes, the sheet, and agreement with an independent
//! implementation.

use std::env;
use std::path::PathBuf;
use std::process::Command;

use serde_json::Value;

use crate::space::{KILN, Space, repository};

/// Coarse enough for a test that runs the command often.
const QUICK: [&str; 6] = ["--views", "4", "--size", "96", "--samples", "20000"];

/// Levels with the source's own UVs and textures: no bake.
const LEVELS: &str = r#"kiln = 1
[asset]
input = "pot.glb"
output = "pot.kiln"
[[stage]]
kind = "merge"
[[stage]]
kind = "simplify"
levels = [{ keep = 0.5 }, { keep = 0.2 }, { keep = 0.08 }]
[[stage]]
kind = "pack"
"#;

/// A folder with the fixture pot and its container.
fn pot() -> Space {
    let space = Space::new();
    space.fixture("pot.glb");
    space.write("pot.toml", LEVELS);
    space.run(["build", "pot.toml", "--backend", "cpu"]).expect(0);
    space
}

/// A square of side 2 at height `z`, facing +Z.
fn square(z: &str) -> String {
    format!("v -1 -1 {z}\nv 1 -1 {z}\nv 1 1 {z}\nv -1 1 {z}\nf 1 2 3\nf 1 3 4\n")
}

fn squares() -> Space {
    let space = Space::new();
    space.write("low.obj", square("0"));
    space.write("high.obj", square("0.25"));
    space
}

fn json(space: &Space, reference: &str, other: &str) -> Value {
    space.run(["compare", reference, other, "--json"].into_iter().chain(QUICK)).expect(0).json()
}

fn figure(report: &Value, path: &str) -> f64 {
    report.pointer(path).and_then(Value::as_f64).unwrap_or_else(|| panic!("{path} is no number in {report:#}"))
}

#[test]
fn a_model_is_nowhere_different_from_itself() {
    let space = Space::new();
    space.fixture("pot.glb");
    let report = json(&space, "pot.glb", "pot.glb");
    for mode in ["flat", "lit", "normals", "material"] {
        for (name, expected) in
            [("rmse", 0.0), ("rmse_object", 0.0), ("rmse_both", 0.0), ("rmse_worst", 0.0), ("ssim/all", 1.0)]
        {
            assert_eq!(figure(&report, &format!("/{mode}/{name}")), expected, "{mode} {name}");
        }
        assert_eq!(figure(&report, &format!("/{mode}/ssim/object")), 1.0);
        assert_eq!(figure(&report, &format!("/{mode}/flip/object")), 0.0);
        assert_eq!(report[mode]["psnr"], Value::Null, "infinite");
        assert_eq!(report[mode]["per_view"].as_array().unwrap().len(), 4);
    }
    assert_eq!(figure(&report, "/silhouette/iou"), 1.0);
    assert_eq!(figure(&report, "/border_kept"), 1.0);
    assert!(figure(&report, "/relative_distance/hausdorff") < 1e-6);
    assert_eq!(report["reference"], report["other"]);
    let text = space.run(["compare", "pot.glb", "pot.glb"].into_iter().chain(QUICK)).expect(0);
    assert!(text.stdout.contains("100.00 % kept") && text.stdout.contains("inf"), "{}", text.stdout);
    assert_eq!(text.stderr, "", "nothing but the table");
}

#[test]
fn errors_grow_with_the_level_of_a_container() {
    let space = pot();
    let reports: Vec<Value> = (0..3).map(|level| json(&space, "pot.glb", &format!("pot.kiln#{level}"))).collect();
    for path in [
        "/relative_distance/mean",
        "/relative_distance/rms",
        "/distance/normal_degrees",
        "/flat/rmse_object",
        "/lit/rmse_object",
        "/lit/flip/object",
        "/normals/rmse_object",
        "/material/rmse_both",
        "/silhouette/xor",
    ] {
        let figures: Vec<f64> = reports.iter().map(|report| figure(report, path)).collect();
        assert!(figures.windows(2).all(|w| w[0] < w[1]) && figures[0] > 0.0, "{path}: {figures:?}");
    }
    let ssim: Vec<f64> = reports.iter().map(|report| figure(report, "/lit/ssim/object")).collect();
    assert!(ssim.windows(2).all(|w| w[0] > w[1]) && ssim[0] < 1.0, "{ssim:?}");
    assert_eq!(json(&space, "pot.glb", "pot.kiln")["flat"], reports[0]["flat"], "level 0 without a number");
    let between = json(&space, "pot.kiln#1", "pot.kiln#1");
    assert_eq!(figure(&between, "/lit/rmse"), 0.0);
}

#[test]
fn a_moved_square_is_its_height_away() {
    let space = squares();
    let report = json(&space, "low.obj", "high.obj");
    for name in ["mean", "rms", "p99", "hausdorff"] {
        assert!((figure(&report, &format!("/distance/{name}")) - 0.25).abs() < 1e-6, "{name}");
        assert!((figure(&report, &format!("/relative_distance/{name}")) - 0.25 / 8f64.sqrt()).abs() < 1e-6);
    }
    assert!(figure(&report, "/distance/normal_degrees") < 1e-3);
    assert_eq!(figure(&report, "/reference/border/length"), 8.0);
    assert_eq!(figure(&report, "/reference/triangles"), 2.0);
    // Area 4 over 20,000 points, in diagonals of sqrt 8.
    assert!((figure(&report, "/relative_spacing") - (4.0f64 / 20_000.0).sqrt() / 8f64.sqrt()).abs() < 1e-9);
}

#[test]
fn a_threshold_that_is_missed_ends_with_1_and_is_named() {
    let space = squares();
    let run = |limits: &[&str]| {
        space.run(["compare", "low.obj", "high.obj"].into_iter().chain(QUICK).chain(limits.iter().copied()))
    };
    let held =
        ["--max-rmse", "255", "--max-distance", "0.1 diag", "--max-flip", "1", "--min-ssim=-1", "--min-iou", "0.1"];
    assert!(run(&held).expect(0).stdout.contains("held       --max-distance"));
    run(&["--max-distance", "251 mm"]).expect(0);
    for (option, limit) in [
        ("--max-rmse", "0.5"),
        ("--max-distance", "249 mm"),
        ("--max-distance", "0.08 diag"),
        ("--max-flip", "0.001"),
        ("--min-ssim", "0.9999"),
        ("--min-iou", "0.999"),
    ] {
        let said = run(&[option, limit]).expect(1);
        assert!(said.stderr.contains(&format!("missed: {option}")), "{}", said.stderr);
        assert!(said.stdout.contains("missed     ") && said.stdout.contains("distance"), "the table stands too");
    }
    let report = run(&["--max-rmse", "0.5", "--min-iou", "0.1", "--json"]).expect(1).json();
    let thresholds = report["thresholds"].as_array().unwrap();
    assert_eq!((&thresholds[0]["option"], &thresholds[0]["held"]), (&"--max-rmse".into(), &false.into()));
    assert_eq!((&thresholds[1]["option"], &thresholds[1]["held"]), (&"--min-iou".into(), &true.into()));
    assert_eq!(thresholds.len(), 2);
}

#[test]
fn what_cannot_be_read_ends_with_2_and_what_makes_no_sense_with_64() {
    let space = squares();
    space.fixture("cube.glb");
    space.write("torn.glb", &space.read("cube.glb")[..600]);
    space.write("broken.kiln", "no container");
    space.write("flat.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n");
    for (other, word) in [
        ("absent.glb", "absent.glb"),
        ("torn.glb", "torn.glb"),
        ("broken.kiln#1", "broken.kiln"),
        ("absent.kiln", "absent.kiln"),
        ("flat.obj", "no triangle with an area"),
    ] {
        let said = space.run(["compare", "low.obj", other].into_iter().chain(QUICK)).expect(2).stderr;
        assert!(said.contains(word), "{other}: {said}");
    }
    for bad in [
        vec!["low.obj"],
        vec!["low.obj", "high.kiln#one"],
        vec!["low.obj", "high.obj", "--max-distance", "3"],
        vec!["low.obj", "high.obj", "--max-rmse", "nan"],
        vec!["low.obj", "high.obj", "--size", "4"],
        vec!["low.obj", "high.obj", "--views", "0"],
    ] {
        space.run(["compare"].into_iter().chain(bad)).expect(64);
    }
    let said = space.run(["compare", "low.obj", "high.obj", "--sheet", "no/such/folder.png"].into_iter().chain(QUICK));
    assert!(said.expect(2).stderr.contains("folder.png"));
}

#[test]
fn a_level_that_is_not_there_is_refused_with_how_many_there_are() {
    let space = pot();
    let said = space.run(["compare", "pot.glb", "pot.kiln#3"].into_iter().chain(QUICK)).expect(2).stderr;
    assert!(said.contains("no level 3: there are 3"), "{said}");
}

#[test]
fn the_sheet_is_a_picture_and_the_same_on_every_run() {
    let space = squares();
    let draw = |name: &str| {
        let sheet = ["compare", "low.obj", "high.obj", "--rows", "2", "--sheet", name];
        space.run(sheet.into_iter().chain(QUICK)).expect(0);
        space.read(name)
    };
    let png = draw("a.png");
    let size = image::load_from_memory(&png).unwrap().to_rgba8().dimensions();
    assert!(size.0 > 3 * 96 && size.1 > 2 * 96, "{size:?}");
    assert_eq!(png, draw("b.png"));
    assert!(!space.files().iter().any(|(name, _)| name.ends_with(".part")));
}

/// Needs `KILN_MEASURE`, the folder of the other implementation, and Python with its packages (`KILN_PYTHON`, else `python3`);
/// without them it says so, also where nothing else may be skipped, since no product of kiln needs Python.
#[test]
fn the_figures_agree_with_an_independent_implementation() {
    let Some(measure) = env::var_os("KILN_MEASURE").map(PathBuf::from).filter(|folder| folder.is_dir()) else {
        eprintln!("skipped: KILN_MEASURE names no folder");
        return;
    };
    let space = pot();
    space.run(["export", "pot.kiln", "--level", "1", "-o", "level.glb"]).expect(0);
    let python = env::var_os("KILN_PYTHON").unwrap_or_else(|| "python3".into());
    let mut command = Command::new(&python);
    command.arg(repository("tests/measure/agree.py")).arg(KILN).arg(measure.canonicalize().unwrap());
    command.args([space.path("pot.glb"), space.path("level.glb")]).args(["--views", "6", "--samples", "200000"]);
    match command.output() {
        Err(error) => eprintln!("skipped: {}: {error}", python.display()),
        Ok(said) if said.status.code() == Some(3) => eprint!("{}", String::from_utf8_lossy(&said.stdout)),
        Ok(said) => {
            let (out, err) = (String::from_utf8_lossy(&said.stdout), String::from_utf8_lossy(&said.stderr));
            assert!(said.status.success(), "{out}{err}");
        }
    }
}
