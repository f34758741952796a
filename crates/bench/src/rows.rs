//! A page of results: printed while it grows, and written to a file at the end.

use std::fs;
use std::path::PathBuf;
use std::process::Command;

/// Lines that go to standard output at once and to `out` when the page is done.
#[derive(Debug, Default)]
pub struct Page {
    text: String,
    out: Option<PathBuf>,
}

impl Page {
    /// A page for standard output, and for the file `out` if there is one.
    pub fn new(out: Option<PathBuf>) -> Page {
        Page { text: String::new(), out }
    }

    /// One more line.
    #[allow(clippy::print_stdout, reason = "the page is the programs' output")]
    pub fn line(&mut self, line: &str) {
        println!("{line}");
        self.text.push_str(line);
        self.text.push('\n');
    }

    /// The head of a table: the names, `:` in front of those whose cells are aligned to the right.
    pub fn head(&mut self, columns: &[&str]) {
        let names: Vec<&str> = columns.iter().map(|c| c.trim_start_matches(':')).collect();
        let rules: Vec<&str> = columns.iter().map(|c| if c.starts_with(':') { "--:" } else { "---" }).collect();
        self.row(&names);
        self.row(&rules);
    }

    /// A row of a table.
    pub fn row<S: AsRef<str>>(&mut self, cells: &[S]) {
        let cells: Vec<&str> = cells.iter().map(AsRef::as_ref).collect();
        self.line(&format!("| {} |", cells.join(" | ")));
    }

    /// Writes the file, if one was asked for: `before`, then all lines.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn finish(self) -> Result<(), String> {
        match self.out {
            Some(out) => fs::write(&out, self.text).map_err(|e| format!("{}: {e}", out.display())),
            None => Ok(()),
        }
    }
}

/// "By `command` on date at commit": when and from what a page was made.
pub fn stamp(command: &str) -> String {
    let said = |program: &str, args: &[&str]| {
        let output = Command::new(program).args(args).output().ok();
        output.map(|o| String::from_utf8_lossy(&o.stdout).trim().to_owned()).unwrap_or_default()
    };
    let changed = match said("git", &["status", "--porcelain", "--untracked-files=no"]).is_empty() {
        true => "",
        false => " with changes",
    };
    let (date, commit) = (said("date", &["-I"]), said("git", &["rev-parse", "--short", "HEAD"]));
    format!("By `{command}` on {date} at commit {commit}{changed}.")
}
