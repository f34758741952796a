//! Every check of the format as one row of one table, and the error that names it.

use crate::prelude::*;

/// Declares [`Code`] and its table out of one list, so that neither can miss a row.
macro_rules! codes {
    ($($name:ident $number:literal $word:literal $sentence:literal)*) => {
        /// One check of the format. Numbers are never used again for another check.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum Code {
            $(#[doc = $sentence] $name),*
        }

        impl Code {
            /// Every code in the order of the specification's table.
            pub const ALL: &'static [Code] = &[$(Code::$name),*];

            /// The number: `K109`.
            pub fn number(self) -> &'static str {
                match self { $(Code::$name => $number),* }
            }

            /// The name: `header-hash`.
            pub fn name(self) -> &'static str {
                match self { $(Code::$name => $word),* }
            }

            /// What is checked, one sentence.
            pub fn sentence(self) -> &'static str {
                match self { $(Code::$name => $sentence),* }
            }
        }
    };
}

codes! {
    TooShort "K101" "too-short" "The bytes hold a whole header and table."
    Magic "K102" "magic" "The first eight bytes are the magic."
    Endian "K103" "endian" "The endian marker reads 0x01020304 in little-endian order."
    Major "K104" "major" "The major version is the reader's own."
    FileLength "K105" "file-length" "The header's file length is the number of bytes (for a prefix: not exceeded by it)."
    TableOffset "K106" "table-offset" "The section table lies directly behind the header."
    SectionCount "K107" "section-count" "The section count is within its maximum and the table within the file."
    Reserved "K108" "reserved" "Reserved bytes of the header, the table and all tables are zero (unless the minor version is newer than the reader)."
    HeaderHash "K109" "header-hash" "The hash over header and table agrees."
    Unaligned "K110" "unaligned" "The bytes lie in memory on a multiple of 16 (a matter of the caller, not of the file)."
    Kind "K201" "kind" "A section kind is four ASCII letters or digits that start with a letter."
    UnknownRequired "K202" "unknown-required" "A required section is of a kind that the reader knows."
    SectionVersion "K203" "section-version" "A required section's version is one that the reader knows."
    Flags "K204" "flags" "Flag bits are assigned ones, and a registered kind carries its registered flag."
    Codec "K205" "codec" "The codec is one that the reader has."
    Alignment "K206" "alignment" "The alignment is 16 or 256, and a registered kind carries its registered one."
    Misaligned "K207" "misaligned" "A section's offset is a multiple of its alignment."
    Bounds "K208" "bounds" "A section lies inside the file."
    Overlap "K209" "overlap" "A section starts behind the end of the one before it."
    Hole "K210" "hole" "A section starts at the first multiple of its alignment behind the one before it."
    Padding "K211" "padding" "Padding between sections and between arrays is zero."
    Trailing "K212" "trailing" "The last section ends where the file ends."
    RawLength "K213" "raw-length" "Stored and raw length agree with the codec (none: equal)."
    StoredHash "K214" "stored-hash" "The hash of a section's stored bytes agrees."
    RawHash "K215" "raw-hash" "The hash of a section's raw bytes agrees."
    Duplicate "K216" "duplicate" "A table occurs once."
    Missing "K217" "missing" "Every required table is there."
    Order "K218" "order" "Sections stand in canonical order: tables, then coarse to fine, layouts, large mips last."
    Decode "K219" "decode" "A coded section decodes to as many bytes as its entry says."
    TableLength "K301" "table-length" "A table is exactly as long as its counts say."
    Count "K302" "count" "A count is within its maximum."
    Text "K303" "text" "A string is UTF-8 in normalisation form C and at most 65,535 bytes long."
    Reference "K304" "reference" "An index into another table or a section number is in range and of the right kind."
    Unreferenced "K305" "unreferenced" "Every payload section of a registered kind is used by a table."
    NotFinite "K306" "not-finite" "Numbers in tables, vertex arrays and float textures are finite."
    Value "K307" "value" "A value with a registry or a domain is one of it."
    LevelError "K308" "level-error" "Errors are not negative and do not fall from a finer to a coarser level."
    Needs "K309" "needs" "A level's list of needed sections is what its geometry and materials need."
    Ranges "K310" "ranges" "Draw ranges follow each other without gap, hold whole triangles and cover all indices."
    IndexWidth "K311" "index-width" "Indices take 2 bytes up to 65,535 vertices, else 4."
    IndexRange "K312" "index-range" "An index is below the vertex count and inside its draw range's vertices."
    Arrays "K313" "arrays" "Arrays tile their payload or are the first elements of level 0's: registered semantics ascending, positions first, each on a multiple of 256."
    Box "K314" "box" "A bounding box is the smallest one."
    Mips "K315" "mips" "Mip sizes halve, rounding down, and each mip lies where its record says."
    Role "K316" "role" "A texture's format suits its roles; these are those of its users or, where no material uses it, one extra."
    LayoutLength "K317" "layout-length" "A layout section is exactly as long as its counts say; LEAF is there if and only if TREE is."
    LayoutCount "K318" "layout-count" "A layout's counts are level 0's where they name its vertices and triangles, and within their maxima."
    Checkpoints "K319" "checkpoints" "Checkpoints run from the finest detail to the coarsest, with the vertices and triangles alive there; triangles do not rise, errors do not fall, and a level that one names has as many triangles."
    Points "K320" "points" "Starts of points are bits of vertices, the first one set, and as many points as collapses lie at and behind the base vertices."
    Parents "K321" "parents" "All vertices of a point go to one point before it; those below the base vertices stay."
    Vanishing "K322" "vanishing" "All triangles are alive at LOD 0, and in each draw range the last to vanish stand first."
    TreeRows "K323" "tree-rows" "Row starts rise from 0 to the node count; a child's row is behind its parent's."
    TreeTexels "K324" "tree-texels" "Columns hold a path each, from the root, rows without a node filled from below, q being k / n; all else is zero."
    Terminals "K325" "terminals" "A leaf texel is its vertex' position with the texel of a node in that node's own row; a terminal is a node."
    FaceCounts "K326" "face-counts" "Face counts are the triangles alive at each threshold, the last one all."
    ClusterRanges "K327" "cluster-ranges" "References, corners and clusters follow each other without gap; groups stand by level."
    ClusterCorners "K328" "cluster-corners" "References are below the vertex count, corners below their cluster's vertices, submeshes are there."
    ClusterGroups "K329" "cluster-groups" "A cluster stands in its group, on its level, and was made by a group of a finer level; none made those of level 0."
    ClusterErrors "K330" "cluster-errors" "A group's error is at least those of the groups that made its clusters; a group that nothing replaces has the greatest finite one."
    ClusterSpheres "K331" "cluster-spheres" "Spheres hold their clusters' vertices, their groups' clusters and the groups that made those."
    ClusterTriangles "K332" "cluster-triangles" "The clusters of level 0 hold each of level 0's triangles once, in its submesh."
}

/// A check that failed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FormatError {
    /// Which check.
    pub code: Code,
    /// Where: `header.magic`, `section 7 (VERT).offset`, `levels[2].bounds`.
    pub place: String,
    /// What would be right.
    pub expected: String,
    /// What is there.
    pub found: String,
}

impl core::fmt::Display for FormatError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let FormatError { code, place, expected, found } = self;
        write!(f, "{} {}: {place}: expected {expected}, found {found}", code.number(), code.name())
    }
}

impl core::error::Error for FormatError {}

impl FormatError {
    pub(crate) fn new(
        code: Code,
        place: impl Into<String>,
        expected: impl ToString,
        found: impl ToString,
    ) -> FormatError {
        FormatError { code, place: place.into(), expected: expected.to_string(), found: found.to_string() }
    }
}

/// Most findings that one report lists; the rest is counted.
pub const FINDING_LIMIT: usize = 1000;

/// What [`crate::check`] found.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CheckReport {
    /// The first [`FINDING_LIMIT`] failed checks, in file order.
    pub findings: Vec<FormatError>,
    /// Failed checks beyond those.
    pub more: usize,
    /// Optional sections of unknown kind or version, by name, that were skipped.
    pub skipped: Vec<String>,
}

impl CheckReport {
    /// Whether every check passed.
    pub fn is_sound(&self) -> bool {
        self.findings.is_empty()
    }

    pub(crate) fn push(&mut self, error: FormatError) {
        if self.findings.len() < FINDING_LIMIT {
            self.findings.push(error);
        } else {
            self.more += 1;
        }
    }

    /// Number of failed checks so far.
    pub(crate) fn count(&self) -> usize {
        self.findings.len() + self.more
    }
}
