//! Progress, ends before the end, and reports of rungs that failed.

use std::sync::Mutex;
use std::sync::atomic::{AtomicU32, Ordering};

use super::*;

/// A watch that lets `calls` questions pass.
fn stopped_after(calls: u32, level: &Level, options: &AtlasOptions, first: &dyn Unwrapper) -> Option<AtlasError> {
    let asked = AtomicU32::new(0);
    let stop = || (asked.fetch_add(1, Ordering::Relaxed) >= calls).then_some(Stop::TimeLimit { seconds: 7 });
    unwrap_watched(level, options, first, &Watch::new(&|_, _| (), &stop)).err()
}

#[test]
fn a_run_that_is_told_to_stop_stops_wherever_it_is_and_names_the_alternatives() {
    let level = Shape::sphere(24, 12).and(Shape::book(5)).level();
    let mut stopped = 0;
    for calls in 0.. {
        let Some(error) = stopped_after(calls, &level, &options(256, 4), &Uvunwrap::STANDARD) else { break };
        let text = error.to_string();
        assert!(matches!(&error, AtlasError::Stopped { stop: Stop::TimeLimit { seconds: 7 }, .. }), "{text}");
        assert!(["within 7 s", "time-limit", "\"xatlas\"", "\"planar\""].iter().all(|s| text.contains(s)), "{text}");
        stopped += 1;
    }
    assert!(stopped > 10, "asked {stopped} times only");
    let planar = AtlasOptions { unwrapper: UnwrapperChoice::Planar, ..options(256, 4) };
    let text = stopped_after(0, &level, &planar, &Planar).expect("stopped").to_string();
    assert!(!text.contains("\"planar\""), "{text}");
    let never = |_: &[u8]| panic!("the worker is not started");
    let xatlas = AtlasOptions { unwrapper: UnwrapperChoice::Xatlas, ..options(256, 4) };
    let text = stopped_after(0, &level, &xatlas, &xatlas::Xatlas::new(&never)).expect("stopped").to_string();
    assert!(text.contains("\"uvunwrap\" or \"auto\""), "{text}");
}

#[test]
fn a_stop_is_no_reason_to_try_another_rung() {
    let level = Shape::cube().level();
    let stops = Canned(|_| Err(UnwrapError::Stopped(Stop::Cancelled)));
    let error = unwrap(&level, &options(256, 4), &stops).expect_err("stopped");
    assert_eq!(error, AtlasError::Stopped { stop: Stop::Cancelled, unwrapper: "canned".into() });
    assert_eq!(error.to_string(), "cancelled");
}

#[test]
fn whoever_looks_on_hears_shares_that_grow_and_changes_nothing() {
    let parts = [Shape::sphere(24, 12), Shape::open_cylinder().scaled(1.0, Vec3::X * 5.0)];
    let level = Shape::submeshes(&parts);
    let options = AtlasOptions { sheets: 2, ..options(256, 4) };
    let heard = Mutex::new(Vec::new());
    let progress = |done: f32, doing: &str| heard.lock().expect("sound").push((done, doing.to_owned()));
    let (seen, ..) =
        unwrap_watched(&level, &options, &Uvunwrap::STANDARD, &Watch::new(&progress, &|| None)).expect("unwraps");
    let (unseen, ..) = unwrap(&level, &options, &Uvunwrap::STANDARD).expect("unwraps");
    assert!(seen.mesh.to_blob() == unseen.mesh.to_blob());
    let heard = heard.into_inner().expect("sound");
    assert!(heard.iter().all(|(done, _)| (0.0..=1.0).contains(done)), "{heard:?}");
    // The second sheet begins where the first ends; within packing the number of trials is a guess.
    let starts: Vec<f32> = heard.iter().filter(|(_, doing)| doing == "growing charts").map(|(done, _)| *done).collect();
    assert!(starts.len() >= 2 && starts[1] > 0.4, "{heard:?}");
    for doing in ["flattening charts", "packing charts", "placing charts", "checking charts"] {
        assert!(heard.iter().any(|(_, d)| d == doing), "nothing heard of {doing}");
    }
}

#[test]
fn reports_say_which_rung_was_taken_and_why_sheet_by_sheet() {
    let level = Shape::cube().level();
    let (_, _, report) = unwrap(&level, &options(256, 4), &Canned(all_in_one_place)).expect("next rung");
    let warnings = report.warnings();
    assert_eq!(warnings.len(), 1, "{warnings:?}");
    let text = &warnings[0];
    assert!(text.starts_with("charts are by uvunwrap-strict") && text.contains("canned:") && text.contains("overlap"));
    let (_, _, report) = unwrap(&level, &options(256, 4), &Uvunwrap::STANDARD).expect("first rung");
    assert!(report.warnings().is_empty());

    // Fails on the larger of two sheets only.
    let picky = Canned(|input| match input.triangles.len() {
        12 => Uvunwrap::STANDARD.unwrap(input, &Watch::NOBODY),
        _ => Err(UnwrapError::Refused("not a cube".into())),
    });
    let parts = [Shape::cube(), Shape::sphere(12, 6).scaled(1.0, Vec3::X * 4.0)];
    let options = AtlasOptions { sheets: 2, ..options(256, 4) };
    let (_, layout, report) = unwrap(&Shape::submeshes(&parts), &options, &picky).expect("next rung");
    assert_eq!((layout.sheets, report.unwrapper.as_str()), (2, "uvunwrap-strict"));
    let warnings = report.warnings();
    assert_eq!(warnings.len(), 1, "{warnings:?}");
    assert!(warnings[0].contains("charts are by uvunwrap-strict") && warnings[0].contains("canned: not a cube"));
}

#[test]
fn a_sheet_that_cannot_be_laid_at_the_common_density_is_reported_and_kept() {
    let picky = Canned(|input| match input.density {
        None => Uvunwrap::STANDARD.unwrap(input, &Watch::NOBODY),
        Some(_) => Err(UnwrapError::DoesNotFit { charts: 1, size: input.size, padding: input.padding }),
    });
    let sphere = Shape::sphere(16, 8);
    let parts = [sphere.scaled(2.0, Vec3::ZERO), sphere.scaled(1.0, Vec3::X * 4.0)];
    let options = AtlasOptions { sheets: 2, ..options(256, 4) };
    let (_, layout, report) = unwrap(&Shape::submeshes(&parts), &options, &picky).expect("unwraps");
    assert_eq!((layout.sheets, &report.uneven[..]), (2, &[1][..]));
    assert!(report.warnings().iter().any(|w| w.contains("sheet 1 could not")), "{:?}", report.warnings());
}
