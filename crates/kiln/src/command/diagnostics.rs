//! The language's diagnostics with the place in the text they are about.

use std::io::IsTerminal;
use std::sync::Arc;

use kiln_pipeline::language::{Diagnostic, Severity, Sources};
use miette::{GraphicalReportHandler, GraphicalTheme, LabeledSpan, MietteDiagnostic, NamedSource, Report};

/// Prints every diagnostic: drawn on a terminal, plain lines with a caret elsewhere.
pub(super) fn show(diagnostics: &[Diagnostic], sources: &Arc<Sources>) {
    let drawn = std::io::stderr().is_terminal();
    for diagnostic in diagnostics {
        if !drawn {
            eprintln!("{}", sources.render(diagnostic));
            continue;
        }
        let severity = match diagnostic.severity {
            Severity::Error => miette::Severity::Error,
            Severity::Warning => miette::Severity::Warning,
        };
        let mut shown = MietteDiagnostic::new(diagnostic.message.clone())
            .with_code(diagnostic.code.as_str())
            .with_severity(severity)
            .with_label(LabeledSpan::at(diagnostic.span.clone(), diagnostic.label.clone()));
        if let Some(help) = &diagnostic.help {
            shown = shown.with_help(help.clone());
        }
        let text = sources.of(diagnostic).map_or_else(String::new, |source| source.text.clone());
        let report = Report::new(shown).with_source_code(NamedSource::new(&diagnostic.file, text));
        let mut out = String::new();
        let handler = GraphicalReportHandler::new_themed(GraphicalTheme::unicode());
        match handler.render_report(&mut out, report.as_ref()) {
            Ok(()) => eprintln!("{out}"),
            Err(_) => eprintln!("{}", sources.render(diagnostic)),
        }
    }
}
