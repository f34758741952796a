//! What a collapse may do: one table over point kinds, and the tests that every candidate has to pass.

use serde::{Deserialize, Serialize};

use crate::topology::PointKind;

/// Where a point may be taken by a collapse.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Moves {
    /// Onto any neighbour, of whatever kind.
    Anywhere,
    /// Onto its two neighbours on the line that it lies on.
    AlongLine,
    /// Never; others may come to it.
    Never,
}

/// The legality table, in the order of [`PointKind`]: where a point of that kind may go, and why no farther.
///
/// It needs no second column for the kind of `to`, since `to` stays: an edge from a border, seam or boundary point that is
/// not part of its line would pinch two lines together or pull a line off its place, whatever lies at its other end.
pub const MOVES: [(PointKind, Moves, &str); 6] = [
    (PointKind::Manifold, Moves::Anywhere, "nothing but a smooth patch of one chart hangs on it"),
    (PointKind::Border, Moves::AlongLine, "the open edge of the surface keeps its course"),
    (PointKind::Seam, Moves::AlongLine, "wedges on both sides find their partner only along the seam"),
    (
        PointKind::Boundary,
        Moves::AlongLine,
        "two submeshes share it; both follow along their common line (Algorithm 1)",
    ),
    (PointKind::Complex, Moves::Never, "its faces form no fan, so no local test can vouch for the result"),
    (PointKind::Locked, Moves::Never, "lines meet or end here, or the caller locked it"),
];

/// Where a point of kind `kind` may go.
#[inline]
pub fn moves(kind: PointKind) -> Moves {
    MOVES[kind as usize].1
}

/// The rule that forbids a collapse.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[repr(u8)]
pub enum Rule {
    /// The table: the point may not move at all.
    Kind,
    /// Link condition: the surface would change its topology, or two faces would come to lie on the same three points.
    Link,
    /// A wedge of `from` has no partner at `to` in the same chart, or two.
    Partner,
    /// A face would turn by more than the turn limit.
    Turn,
    /// A face would become a sliver.
    Sliver,
    /// A face would change its orientation in the UV plane.
    UvTurn,
    /// A chart's border in the shared UV layout would leave the finest level's by more than half the padding.
    UvBorder,
}

/// Number of rules.
pub const RULE_COUNT: usize = 7;

impl Rule {
    /// All rules, in order of test.
    pub const ALL: [Rule; RULE_COUNT] =
        [Rule::Kind, Rule::Link, Rule::Partner, Rule::Turn, Rule::Sliver, Rule::UvTurn, Rule::UvBorder];

    /// What it guards, as a phrase that follows "because".
    pub fn reason(self) -> &'static str {
        match self {
            Rule::Kind => "the point lies where lines meet, or its faces form no fan",
            Rule::Link => "the surface would change its topology",
            Rule::Partner => "attributes would smear across a seam",
            Rule::Turn => "a face would turn over",
            Rule::Sliver => "a face would become a sliver",
            Rule::UvTurn => "a face would turn over in the UV plane",
            Rule::UvBorder => "a chart would leave its place in the shared UV layout",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_is_in_the_order_of_the_kinds() {
        for (i, (kind, _, _)) in MOVES.iter().enumerate() {
            assert_eq!(*kind as usize, i);
        }
        for (i, rule) in Rule::ALL.iter().enumerate() {
            assert_eq!(*rule as usize, i);
        }
    }
}
