//! Rules for submeshes: which rule holds for which submesh, and how many triangles it grants.
//!
//! A rule names submeshes by a glob (`*` any run of characters, `?` one) and says what they shall have; the last one that matches
//! a submesh holds for it. A share is of the submesh's own source triangles, the same at every level.
//!
//! | level of a rule | triangles of a submesh |
//! | --- | --- |
//! | `Keep(share)` | that share of its source triangles; 1.0 leaves it untouched, bit for bit |
//! | `AsLevel(n)` | what it has in level `n` of the stage without any rule |
//! | `AsIncoming` | what it has in the mesh that the stage takes: the rule was met by an earlier stage |
//! | `Relative { to, factor }` | `factor` times the share that the submeshes under rule `to` have together |

use kiln_asset::Submesh;
use serde::{Deserialize, Serialize};

use super::cut::Want;

/// What a rule grants.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PartLevel {
    /// A share of the submesh's own source triangles.
    Keep(f64),
    /// What the submesh has in this level of the stage without any rule; 0 is the finest.
    AsLevel(usize),
    /// What the submesh has in the incoming mesh.
    AsIncoming,
    /// A multiple of the share that the submeshes of another rule reached together.
    Relative {
        /// Index of that rule.
        to: usize,
        /// Unitless.
        factor: f64,
    },
}

/// A rule for submeshes.
#[derive(Clone, Debug, PartialEq)]
pub struct PartRule {
    /// Glob over their names.
    pub name: String,
    /// What it grants.
    pub level: PartLevel,
}

/// What a rule asked for and what came out, all its submeshes together.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PartReport {
    /// The rule's name.
    pub rule: String,
    /// Submeshes that it holds for.
    pub submeshes: u32,
    /// Triangles that it grants them at most.
    pub asked: u32,
    /// Triangles that they have.
    pub triangles: u32,
}

/// Whether `name` matches `glob`, in which `*` stands for any run of characters and `?` for one.
pub fn matches(glob: &str, name: &str) -> bool {
    let (glob, name): (Vec<char>, Vec<char>) = (glob.chars().collect(), name.chars().collect());
    let (mut g, mut n) = (0, 0);
    // Where to go on if the run of the last `*` has to be longer by one.
    let mut retry = None;
    while n < name.len() {
        match glob.get(g) {
            Some('*') => {
                retry = Some((g, n));
                g += 1;
            }
            Some(c) if *c == '?' || *c == name[n] => {
                g += 1;
                n += 1;
            }
            _ => {
                let Some((star, start)) = retry else { return false };
                retry = Some((star, start + 1));
                g = star + 1;
                n = start + 1;
            }
        }
    }
    glob[g..].iter().all(|c| *c == '*')
}

/// For each submesh the rule that holds for it: the last one that matches.
pub fn governing(rules: &[PartRule], submeshes: &[Submesh]) -> Vec<Option<usize>> {
    submeshes.iter().map(|s| rules.iter().rposition(|rule| matches(&rule.name, &s.name))).collect()
}

/// The rules that match no submesh at all.
pub fn unmatched(rules: &[PartRule], submeshes: &[Submesh]) -> Vec<usize> {
    (0..rules.len()).filter(|r| !submeshes.iter().any(|s| matches(&rules[*r].name, &s.name))).collect()
}

/// Triangles of each submesh in the mesh that rules are applied to, and in the source.
pub(super) struct Counts<'a> {
    pub(super) incoming: &'a [u32],
    pub(super) source: &'a [u32],
}

/// What each submesh shall have. `governed`: of [`governing`]; `at_level(n)`: triangles of each submesh in level `n` without
/// rules; `reached`: triangles that each submesh has come to so far, where a relative rule shall look at that instead of at
/// what the other rule grants.
pub(super) fn wants(
    rules: &[PartRule],
    governed: &[Option<usize>],
    counts: &Counts<'_>,
    at_level: &dyn Fn(usize) -> Vec<u32>,
    reached: Option<&[u32]>,
) -> Vec<Want> {
    let mut granted: Vec<Option<Vec<u32>>> = vec![None; rules.len()];
    // Relative rules wait for the rule that they name; each round settles one more link of the longest chain.
    for _ in 0..rules.len() {
        for r in 0..rules.len() {
            if granted[r].is_some() {
                continue;
            }
            let own = |s: usize| governed[s] == Some(r);
            let share = |s: usize, share: f64| (share * f64::from(counts.source[s]) + 1e-9).floor() as u32;
            let all = 0..governed.len();
            granted[r] = match rules[r].level {
                PartLevel::Keep(keep) => Some(all.map(|s| if own(s) { share(s, keep) } else { 0 }).collect()),
                PartLevel::AsLevel(n) => Some(at_level(n)),
                PartLevel::AsIncoming => Some(counts.incoming.to_vec()),
                PartLevel::Relative { to, factor } => granted.get(to).and_then(Option::as_ref).map(|base| {
                    let base = reached.unwrap_or(base);
                    let (mut faces, mut source) = (0_u64, 0_u64);
                    for s in all.clone().filter(|s| governed[*s] == Some(to)) {
                        faces += u64::from(base[s].min(counts.incoming[s]));
                        source += u64::from(counts.source[s]);
                    }
                    let level = if source > 0 { faces as f64 / source as f64 } else { 1.0 };
                    all.map(|s| if own(s) { share(s, factor * level) } else { 0 }).collect()
                }),
            };
        }
    }
    governed
        .iter()
        .enumerate()
        .map(|(s, rule)| match rule.and_then(|r| granted[r].as_ref()) {
            // A rule in a ring grants nothing; the language refuses rings before.
            None => Want::Free,
            Some(faces) => Want::Faces(faces[s].min(counts.incoming[s])),
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn submeshes(names: &[&str]) -> Vec<Submesh> {
        names.iter().map(|name| Submesh { name: (*name).into(), source_triangles: 100, ..Submesh::default() }).collect()
    }

    fn rule(name: &str, level: PartLevel) -> PartRule {
        PartRule { name: name.into(), level }
    }

    #[test]
    fn globs_know_stars_and_question_marks_and_nothing_else() {
        for (glob, name, fits) in [
            ("wheel*", "wheel", true),
            ("wheel*", "wheel.front", true),
            ("*wheel", "a wheelwheel", true),
            ("w?eel", "wheel", true),
            ("w?eel", "weel", false),
            ("*a*b*", "xxaxxbxx", true),
            ("*a*b", "xxaxxbxx", false),
            ("[ab]", "a", false),
            ("[ab]", "[ab]", true),
            ("", "", true),
            ("", "a", false),
            ("**", "", true),
            ("rotor?", "rotor\u{e9}", true),
        ] {
            assert_eq!(matches(glob, name), fits, "{glob} on {name}");
        }
    }

    #[test]
    fn a_long_glob_of_stars_takes_no_long_time() {
        let glob = "*a".repeat(2000) + "b";
        assert!(!matches(&glob, &"a".repeat(20_000)));
    }

    #[test]
    fn the_last_rule_that_matches_holds_and_relative_ones_follow_chains() {
        let parts = submeshes(&["tyre", "rim", "hub", "badge", "body"]);
        let rules = [
            rule("hub", PartLevel::Relative { to: 1, factor: 0.5 }),
            rule("rim", PartLevel::Relative { to: 3, factor: 0.5 }),
            rule("*", PartLevel::Keep(0.1)),
            rule("tyre", PartLevel::Keep(0.8)),
            rule("rim", PartLevel::Keep(1.0)),
        ];
        assert_eq!(governing(&rules[..2], &parts), [None, Some(1), Some(0), None, None]);
        assert_eq!(governing(&rules, &parts)[1], Some(4), "a later rule wins");
        let rules = [rules[0].clone(), rules[1].clone(), rule("none", PartLevel::Keep(0.5)), rules[3].clone()];
        assert_eq!(unmatched(&rules, &parts), [2]);
        let governed = governing(&rules, &parts);
        let counts = Counts { incoming: &[100, 100, 15, 100, 100], source: &[100; 5] };
        let wants = |reached| wants(&rules, &governed, &counts, &|_| vec![0; 5], reached);
        let faces = Want::Faces;
        assert_eq!(wants(None), [faces(80), faces(40), faces(15), Want::Free, Want::Free], "hub: 20, and it has 15");
        let reached = [90, 60, 15, 100, 100];
        assert_eq!(wants(Some(&reached)), [faces(80), faces(45), faces(15), Want::Free, Want::Free]);
    }

    #[test]
    fn rings_of_relative_rules_leave_their_submeshes_free() {
        let parts = submeshes(&["a", "b"]);
        let rules = [
            rule("a", PartLevel::Relative { to: 1, factor: 1.0 }),
            rule("b", PartLevel::Relative { to: 0, factor: 1.0 }),
        ];
        let counts = Counts { incoming: &[100; 2], source: &[100; 2] };
        let found = wants(&rules, &governing(&rules, &parts), &counts, &|_| Vec::new(), None);
        assert_eq!(found, [Want::Free; 2]);
    }
}
