//! The script of an array's elements, and the lines that it reads.

use std::ffi::OsStr;
use std::fmt::Write as _;

use super::super::Task;

/// Runs the tasks of one element, one after another, and leaves their exit codes. It ends with 0 whatever they end with: see the
/// page of [`super`]. An element that Slurm takes up again begins anew; what was done finds itself fresh.
pub(super) const SCRIPT: &str = r#"#!/bin/sh
# kiln: one element of a job array. run.sh RUN ARRAY COMMAND...: the lines of RUN/tasks/ARRAY that begin with its number.
run=$1 array=$2
shift 2
element=$SLURM_ARRAY_TASK_ID
status=$run/status/$array/$element
tab=$(printf '\t')
nl='
'
if ! [ -f "$run/tasks/$array" ]; then
  echo "kiln: $(hostname) does not see $run: the cache must be a folder that all nodes share" >&2
  exit 1
fi
if [ -n "$SLURM_CPUS_PER_TASK" ]; then export RAYON_NUM_THREADS="$SLURM_CPUS_PER_TASK"; fi
: > "$status.part" || exit 1
grep "^$element$tab" "$run/tasks/$array" | while IFS=$tab read -r _ task line; do
  echo "== task $task on $(hostname)"
  eval "\"\$@\" $line" < /dev/null 2>&1
  echo "$task $?" >> "$status.part"
done
mv "$status.part" "$status"
"#;

/// A line for each task.
pub(super) fn lines(tasks: &[Task], elements: &[Vec<usize>]) -> String {
    let mut lines = String::new();
    for (element, of_element) in elements.iter().enumerate() {
        for &task in of_element {
            let arguments: Vec<String> = tasks[task].arguments.iter().map(|argument| quoted(argument)).collect();
            let _ = writeln!(lines, "{element}\t{task}\t{}", arguments.join(" "));
        }
    }
    lines
}

/// An argument for the shell; on one line, whatever is in it.
pub(super) fn quoted(argument: &OsStr) -> String {
    let text = argument.to_string_lossy();
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./=:,+@%".contains(c);
    if !text.is_empty() && text.chars().all(plain) {
        return text.into_owned();
    }
    // The script sets $nl.
    format!("'{}'", text.replace('\'', r"'\''").replace('\n', r#"'"$nl"'"#))
}

#[cfg(test)]
mod tests {
    use std::process::Command;

    use super::*;

    #[test]
    fn a_line_gives_the_shell_what_was_meant() {
        let awkward = ["plain/a-1.glb", "", "a b", "it's", "$HOME `id` \\ \"x\"", "two\nlines\n", "tab\t", "*"];
        let line: Vec<String> = awkward.iter().map(|argument| quoted(OsStr::new(argument))).collect();
        let line = line.join(" ");
        assert!(!line.contains('\n') && !line.ends_with('\t'));
        let script = "nl='\n'\neval \"\\\"\\$@\\\" $LINE\"";
        let output =
            Command::new("sh").args(["-c", script, "sh", "printf", "<%s>"]).env("LINE", line).output().unwrap();
        let expected: String = awkward.iter().map(|argument| format!("<{argument}>")).collect();
        assert_eq!(String::from_utf8_lossy(&output.stdout), expected);
    }
}
