//! Pipelines: text, parent and settings in, diagnostics or a pipeline out.

use std::io;

use kiln_pipeline::language::{DirEntry, expand_inputs, has_errors, load};

/// The first part as the pipeline's text, the second as that of every parent, the third as `--set` arguments, one a line.
/// Parts that are no UTF-8 are read with replacement characters, as no text with other bytes reaches the language.
pub fn pipeline(bytes: &[u8]) {
    let [text, parent, sets] = crate::split::<3>(bytes).map(String::from_utf8_lossy);
    let sets: Vec<String> = sets.lines().map(str::to_owned).collect();
    let missing = || io::Error::from(io::ErrorKind::NotFound);
    let read = |_: &str| if parent.is_empty() { Err(missing()) } else { Ok(parent.clone().into_owned()) };
    let loaded = load("pipelines/x.toml", &text, &sets, &read);
    assert_eq!(loaded.pipeline.is_none(), has_errors(&loaded.diagnostics));
    for one in &loaded.diagnostics {
        let source = loaded.sources.of(one);
        assert!(source.is_some_and(|s| s.text.get(one.span.clone()).is_some()), "{one:?} points outside its text");
        assert!(!one.message.is_empty() && !one.message.contains('\n'), "{one:?}");
        let _ = loaded.sources.render(one);
    }
    let Some(pipeline) = loaded.pipeline else { return };
    let resolved = pipeline.to_resolved_toml();
    let _ = pipeline.to_resolved_json();
    let again = load("pipelines/x.toml", &resolved, &[], &|_| Err(missing())).pipeline;
    assert_eq!(again.map(|again| again.to_resolved_toml()).as_ref(), Some(&resolved), "the resolved form reads back");
    let list = |folder: &str| match folder.matches('/').count() {
        0..3 => Ok(vec![
            DirEntry { name: "pot.glb".into(), is_dir: false },
            DirEntry { name: "x.obj".into(), is_dir: false },
            DirEntry { name: "props".into(), is_dir: true },
        ]),
        _ => Err(missing()),
    };
    for build in expand_inputs(&pipeline, &list).builds {
        let _ = pipeline.for_asset(&build.relative);
    }
    let _ = pipeline.for_asset("props/x.glb");
}
