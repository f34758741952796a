//! What is wrong with a pipeline, where, and what to do about it.

use std::fmt;
use std::ops::Range;
use std::sync::Arc;

/// Whether a pipeline with this diagnostic may run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// The pipeline does not run.
    Error,
    /// It runs; `--deny warnings` makes it exit 1.
    Warning,
}

/// Whose fault it is; decides the tone of the message and, with the file, the exit code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Family {
    /// The pipeline says something that can never be right: exit 2.
    Invalid,
    /// The pipeline is right, this version cannot do it: exit 2.
    Unsupported,
    /// The system refused to read something: exit 2.
    Io,
    /// A `--set` names nothing or is malformed: exit 64.
    Usage,
    /// Not wrong, but probably not meant.
    Doubt,
}

macro_rules! codes {
    ($( $variant:ident $text:literal $family:ident $sentence:literal )*) => {
        /// Stable name of a kind of defect.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
        pub enum Code {
            $( #[doc = $sentence] $variant, )*
        }

        impl Code {
            /// Every code, in the order of the table.
            pub const ALL: &'static [Code] = &[$( Code::$variant, )*];

            /// The name that is printed, `[a-z.-]`.
            pub fn as_str(self) -> &'static str {
                match self { $( Code::$variant => $text, )* }
            }

            /// Whose fault it is.
            pub fn family(self) -> Family {
                match self { $( Code::$variant => Family::$family, )* }
            }

            /// What the code means, one sentence.
            pub fn sentence(self) -> &'static str {
                match self { $( Code::$variant => $sentence, )* }
            }
        }
    };
}

codes! {
    Syntax            "toml.syntax"          Invalid     "The file is not TOML here."
    VersionMissing    "version.missing"      Invalid     "The file does not say which version of the language it is written in."
    VersionInvalid    "version.invalid"      Invalid     "The version is not a number that any kiln ever had."
    VersionNewer      "version.newer"        Unsupported "The file is written in a newer version of the language than this kiln reads."
    BaseUnreadable    "base.unreadable"      Io          "The parent named by `base` could not be read."
    BaseCycle         "base.cycle"           Invalid     "A file is its own parent, directly or through others."
    KeyUnknown        "key.unknown"          Invalid     "No such key exists in this place."
    KeyMisplaced      "key.misplaced"        Invalid     "The key exists, but stands after a sub-table's header and so belongs to that sub-table."
    KeyMissing        "key.missing"          Invalid     "A key without a default is not given."
    KeyUnsupported    "key.unsupported"      Unsupported "The key is part of the language, but this version does not implement it."
    ValueType         "value.type"           Invalid     "The value has another type than the key takes."
    ValueLength       "value.length"         Invalid     "A length is not a number followed by a unit."
    ValueUnknown      "value.unknown"        Invalid     "The value is none of the names that the key takes."
    ValueUnsupported  "value.unsupported"    Unsupported "The value is part of the language, but this version does not implement it."
    ValueRange        "value.range"          Invalid     "The number lies outside the key's range."
    ValueEmpty        "value.empty"          Invalid     "The value is empty where something is needed."
    ValueRepeated     "value.repeated"       Invalid     "A list names the same thing twice."
    LevelShape        "level.shape"          Invalid     "A level does not have exactly one of keep, triangles and error."
    LevelOrder        "level.order"          Invalid     "A level is not coarser than the one before it."
    LevelAbove        "level.above"          Invalid     "A level asks for more than the incoming mesh has left."
    RuleShape         "rule.shape"           Invalid     "A submesh rule does not have exactly one of keep, level, and relative-to with factor."
    RuleLevel         "rule.level"           Invalid     "A submesh rule names a level that its stage does not have."
    RuleUnknown       "rule.unknown"         Invalid     "`relative-to` names no rule."
    RuleCycle         "rule.cycle"           Invalid     "A submesh rule is relative to itself, directly or through others."
    StageNone         "stage.none"           Invalid     "The pipeline has no stage."
    StageId           "stage.id"             Invalid     "A stage id is not made of lower-case letters, digits and hyphens, a letter first."
    StageIdMissing    "stage.id-missing"     Invalid     "Two stages have the same kind, so each needs an id of its own."
    StageIdRepeated   "stage.id-repeated"    Invalid     "Two stages have the same id."
    StageKindChanged  "stage.kind-changed"   Invalid     "A stage changes the kind of the parent's stage of the same id."
    ChainFrom         "chain.from"           Invalid     "`from` names no stage."
    ChainForward      "chain.forward"        Invalid     "A stage refers to itself or to a later stage."
    ChainInput        "chain.input"          Invalid     "A stage cannot take what the stage before it gives."
    ChainOrder        "chain.order"          Unsupported "The order of stages makes sense, but this version does not implement it."
    ChainLevels       "chain.levels"         Invalid     "Several levels come in where a stage starts from exactly one."
    ChainHigh         "chain.high"           Invalid     "`high` names no earlier stage that yields a mesh."
    ChainAtlasUnbaked "chain.atlas-unbaked"  Invalid     "An atlas is made and no bake writes textures for it."
    ChainBakeUnlaid   "chain.bake-unlaid"    Invalid     "A bake has no atlas before it to write into."
    ChainPack         "chain.pack"           Invalid     "The pipeline does not end in exactly one pack."
    ChainNormals      "chain.normals"        Invalid     "Normals would be rebuilt under a tangent-space map that belongs to the old ones."
    ChainPlacement    "chain.placement"      Invalid     "A metric that places points itself is asked to leave them where they are."
    ChainLayout       "chain.layout"         Invalid     "A layout needs levels that are cut another way."
    ChainUnused       "chain.unused"         Doubt       "No later stage takes what this stage makes."
    TemplateUnknown   "template.unknown"     Invalid     "An output template names something other than {path} and {name}."
    GlobSyntax        "glob.syntax"          Invalid     "A glob is malformed."
    InputMissing      "input.missing"        Invalid     "No model matches the input."
    InputUnreadable   "input.unreadable"     Io          "A folder of the input could not be listed."
    OutputRepeated    "output.repeated"      Invalid     "Two models would write the same output."
    OutputIsInput     "output.is-input"      Invalid     "An output would replace an input model."
    OverridePath      "override.path"        Invalid     "An override sets something other than a stage's key."
    OverrideUnmatched "override.unmatched"   Doubt       "An override matches no model."
    SetSyntax         "set.syntax"           Usage       "A --set is not KEY=VALUE, or its value is not TOML."
    SetUnknown        "set.unknown"          Usage       "A --set names no key of the pipeline."
}

impl fmt::Display for Code {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// The table of codes as markdown.
pub fn code_reference() -> String {
    let mut out = String::from("| code | family | meaning |\n| --- | --- | --- |\n");
    for code in Code::ALL {
        out.push_str(&format!("| `{code}` | {:?} | {} |\n", code.family(), code.sentence()));
    }
    out
}

/// Place in one of the texts that a pipeline was read from.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Origin {
    /// Index into [`Sources`].
    pub source: usize,
    /// Byte offsets into that text.
    pub span: Range<usize>,
}

impl Origin {
    /// A place in source number `source`.
    pub fn new(source: usize, span: Range<usize>) -> Origin {
        Origin { source, span }
    }
}

/// One text that diagnostics point into.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Source {
    /// File name as it was given, `/`-separated; `--set` for a command-line setting.
    pub name: String,
    /// The whole text.
    pub text: String,
    /// True for a `--set`: its text stands on the command line.
    pub command_line: bool,
}

/// All texts of one pipeline: the file first, then its parents, then each `--set`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Sources(pub Vec<Source>);

impl Sources {
    /// The text that a diagnostic points into.
    pub fn of(&self, diagnostic: &Diagnostic) -> Option<&Source> {
        self.0.get(diagnostic.source)
    }

    /// [`render_plain`] with the text looked up.
    pub fn render(&self, diagnostic: &Diagnostic) -> String {
        render_plain(self.of(diagnostic).map_or("", |source| source.text.as_str()), diagnostic)
    }
}

/// One defect of a pipeline.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Diagnostic {
    /// Whether the pipeline may run.
    pub severity: Severity,
    /// Stable name of the kind of defect.
    pub code: Code,
    /// What is wrong, one line.
    pub message: String,
    /// Name of the text it points into.
    pub file: String,
    /// Index of that text in [`Sources`].
    pub source: usize,
    /// Byte offsets into that text; empty at the place where something is missing.
    pub span: Range<usize>,
    /// What stands at the caret, a few words; may be empty.
    pub label: String,
    /// What to do next.
    pub help: Option<String>,
    /// True if it is the command line's fault (exit 64) and no file's.
    pub usage: bool,
}

impl fmt::Display for Diagnostic {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {} [{}]", self.file, self.message, self.code)
    }
}

impl std::error::Error for Diagnostic {}

/// True if any of them keeps the pipeline from running.
pub fn has_errors(diagnostics: &[Diagnostic]) -> bool {
    diagnostics.iter().any(|diagnostic| diagnostic.severity == Severity::Error)
}

/// Collects defects while a pipeline is read.
#[derive(Debug, Default)]
pub(crate) struct Report {
    pub(crate) sources: Arc<Sources>,
    found: Vec<Diagnostic>,
}

impl Report {
    pub(crate) fn new(sources: Arc<Sources>) -> Report {
        Report { sources, found: Vec::new() }
    }

    /// Takes up a text to point into and gives its number.
    pub(crate) fn add_source(&mut self, name: &str, text: &str, command_line: bool) -> usize {
        let sources = &mut Arc::make_mut(&mut self.sources).0;
        sources.push(Source { name: name.to_owned(), text: text.to_owned(), command_line });
        sources.len() - 1
    }

    /// Adds one defect; its severity follows from the code's family.
    pub(crate) fn add(
        &mut self,
        code: Code,
        origin: &Origin,
        message: impl Into<String>,
        label: impl Into<String>,
        help: impl Into<Option<String>>,
    ) {
        let source = self.sources.0.get(origin.source);
        let severity = if code.family() == Family::Doubt { Severity::Warning } else { Severity::Error };
        let command_line = source.is_some_and(|source| source.command_line);
        self.found.push(Diagnostic {
            severity,
            code,
            message: one_line(message.into()),
            file: source.map_or_else(String::new, |source| source.name.clone()),
            source: origin.source,
            span: origin.span.clone(),
            label: one_line(label.into()),
            help: help.into().map(one_line),
            usage: code.family() == Family::Usage || (command_line && code.family() == Family::Invalid),
        });
    }

    pub(crate) fn len(&self) -> usize {
        self.found.len()
    }

    /// What was found so far, in the order in which it was found.
    pub(crate) fn found(&self) -> &[Diagnostic] {
        &self.found
    }

    /// Forgets what does not satisfy the condition.
    pub(crate) fn retain(&mut self, keep: impl FnMut(&Diagnostic) -> bool) {
        self.found.retain(keep);
    }

    pub(crate) fn extend(&mut self, more: impl IntoIterator<Item = Diagnostic>) {
        self.found.extend(more);
    }

    /// `file:line:column` of a place, for messages that name a second one.
    pub(crate) fn place(&self, origin: &Origin) -> String {
        let Some(source) = self.sources.0.get(origin.source) else { return String::from("elsewhere") };
        let (line, column) = line_and_column(&source.text, origin.span.start);
        if source.command_line { source.name.clone() } else { format!("{}:{line}:{column}", source.name) }
    }

    /// All defects, each once, sorted by text and position.
    pub(crate) fn finish(mut self) -> Vec<Diagnostic> {
        self.found.sort_by(|a, b| {
            (a.source, a.span.start, a.span.end, a.code, &a.message).cmp(&(
                b.source,
                b.span.start,
                b.span.end,
                b.code,
                &b.message,
            ))
        });
        self.found.dedup();
        self.found
    }
}

/// Names from the file are quoted in messages: whatever they hold, a message stays one line.
fn one_line(text: String) -> String {
    if !text.contains(char::is_control) {
        return text;
    }
    text.chars().map(|c| if c.is_control() { c.escape_default().to_string() } else { c.to_string() }).collect()
}

/// Line and column, both from 1, of a byte offset; columns count characters.
pub fn line_and_column(text: &str, offset: usize) -> (usize, usize) {
    let offset = floor_boundary(text, offset);
    let before = &text[..offset];
    let line_start = before.rfind('\n').map_or(0, |at| at + 1);
    (before.bytes().filter(|byte| *byte == b'\n').count() + 1, before[line_start..].chars().count() + 1)
}

/// The greatest character boundary of `text` at or below `offset`.
fn floor_boundary(text: &str, offset: usize) -> usize {
    let mut at = offset.min(text.len());
    while !text.is_char_boundary(at) {
        at -= 1;
    }
    at
}

/// The diagnostic as plain text: `file:line:column`, the line itself, a caret under the span, the help. Ends in a newline.
pub fn render_plain(source: &str, diagnostic: &Diagnostic) -> String {
    let severity = match diagnostic.severity {
        Severity::Error => "error",
        Severity::Warning => "warning",
    };
    let start = floor_boundary(source, diagnostic.span.start);
    let end = floor_boundary(source, diagnostic.span.end).max(start);
    let (line, column) = line_and_column(source, start);
    let line_start = source[..start].rfind('\n').map_or(0, |at| at + 1);
    let line_end = source[start..].find('\n').map_or(source.len(), |at| start + at);
    let text = source[line_start..line_end].trim_end_matches('\r');
    let (before, marked) = (&source[line_start..start], &source[start..end.min(line_end)]);

    let number = line.to_string();
    let gutter = " ".repeat(number.len());
    let mut out =
        format!("{}:{line}:{column}: {severity}[{}]: {}\n", diagnostic.file, diagnostic.code, diagnostic.message);
    // A tab before the caret stays a tab, so that the caret stands under its text whatever a tab's width.
    let indent: String = before.chars().map(|c| if c == '\t' { '\t' } else { ' ' }).collect();
    let carets = "^".repeat(marked.trim_end().chars().count().max(1));
    out.push_str(&format!(" {gutter} |\n {number} | {text}\n {gutter} | {indent}{carets}"));
    if !diagnostic.label.is_empty() {
        out.push(' ');
        out.push_str(&diagnostic.label);
    }
    out.push('\n');
    if let Some(help) = &diagnostic.help {
        out.push_str(&format!(" {gutter} = help: {help}\n"));
    }
    out
}

/// The candidate nearest to a misspelt name, if one is near enough to be meant.
pub fn nearest<'c>(name: &str, candidates: impl IntoIterator<Item = &'c str>) -> Option<&'c str> {
    let lower = name.to_lowercase();
    let limit = (name.chars().count() / 3).max(2);
    let mut best: Option<(usize, &str)> = None;
    for candidate in candidates {
        let distance = strsim::damerau_levenshtein(&lower, candidate);
        // A word that continues or abbreviates the other is meant more often than its edit distance says.
        let related = lower.len() >= 3 && (candidate.starts_with(&lower) || lower.starts_with(candidate));
        let distance = if related { distance.min(limit) } else { distance };
        // A replacement of every letter is no likeness.
        if distance <= limit && distance < candidate.chars().count() && best.is_none_or(|(least, _)| distance < least) {
            best = Some((distance, candidate));
        }
    }
    best.map(|(_, candidate)| candidate)
}

/// "did you mean `x`?" or the list of what would be valid.
pub(crate) fn suggest(what: &str, name: &str, candidates: &[&str]) -> Option<String> {
    match nearest(name, candidates.iter().copied()) {
        Some(near) => Some(format!("did you mean `{near}`?")),
        None if candidates.is_empty() => None,
        None => Some(format!("{what}: {}", candidates.join(", "))),
    }
}
