//! Which submesh lies on which sheet.
//!
//! A submesh asks for area times the square of its density factor. The largest demand goes first, each to the sheet that has
//! least so far ("longest processing time": Graham, "Bounds on multiprocessing timing anomalies", SIAM Journal on Applied
//! Mathematics 17(2), 1969, DOI 10.1137/0117039; never more than 4/3 of the best possible maximum). Ties go to the lower submesh
//! and the lower sheet. Density is that of the fullest sheet, so as few sheets are used as come within [`SPARED`] of what all of
//! them would give.

use kiln_asset::{FaceId, Mesh};

use super::AtlasOptions;

/// How much fuller the fullest sheet may get for the sake of fewer sheets, unitless: 5 % of area are 2.5 % of texels per length.
const SPARED: f64 = 1.05;

/// The sheet of each submesh of `mesh`, and how many there are: at most `options.sheets`. `faces`: those with an area.
pub(super) fn distribute(mesh: &Mesh, faces: &[FaceId], options: &AtlasOptions) -> (Vec<u32>, u32) {
    if options.sheets == 1 {
        return (vec![0; mesh.submeshes.len()], 1);
    }
    let mut demand = vec![0.0f64; mesh.submeshes.len()];
    for face in faces {
        let submesh = mesh.face_submesh[face.index()].index();
        let factor = f64::from(options.density(submesh));
        let [a, b, c] = mesh.face_positions(*face).map(|p| p.as_dvec3());
        demand[submesh] += 0.5 * (b - a).cross(c - a).length() * factor * factor;
    }
    let (best, limit) = lay(&demand, options.sheets);
    let fewer = (1..options.sheets).map(|count| (lay(&demand, count), count));
    let found = fewer.into_iter().find(|((_, fullest), _)| *fullest <= limit * SPARED);
    let sheet_of = found.map_or(best, |((sheet_of, _), _)| sheet_of);
    // With fewer submeshes than sheets some stay empty, and they are the last ones.
    let used = sheet_of.iter().max().map_or(1, |last| last + 1);
    (sheet_of, used)
}

/// The sheet of each demand, and what the fullest of `count` sheets holds. What demands nothing lies on the first.
fn lay(demand: &[f64], count: u32) -> (Vec<u32>, f64) {
    let mut order: Vec<usize> = (0..demand.len()).filter(|i| demand[*i] > 0.0).collect();
    order.sort_by(|a, b| demand[*b].total_cmp(&demand[*a]).then(a.cmp(b)));
    let mut held = vec![0.0f64; count as usize];
    let mut sheet_of = vec![0; demand.len()];
    for i in order {
        let least = (1..held.len()).fold(0, |least, s| if held[s] < held[least] { s } else { least });
        held[least] += demand[i];
        sheet_of[i] = least as u32;
    }
    (sheet_of, held.iter().copied().fold(0.0, f64::max))
}

#[cfg(test)]
mod tests {
    use super::lay;

    #[test]
    fn the_largest_go_first_and_ties_to_the_lower() {
        assert_eq!(lay(&[1.0, 5.0, 4.0, 3.0, 3.0], 2), (vec![1, 0, 1, 1, 0], 8.0));
        assert_eq!(lay(&[2.0, 2.0, 2.0, 2.0], 3), (vec![0, 1, 2, 0], 4.0));
        assert_eq!(lay(&[0.0, 1.0], 2), (vec![0, 0], 1.0), "what demands nothing opens no sheet");
    }

    #[test]
    fn no_spread_is_fuller_than_graham_allows() {
        // Against the best of all spreads of seven demands over three sheets.
        for seed in 0..50u32 {
            let demand: Vec<f64> =
                (0..7).map(|i| f64::from((seed * 7 + i).wrapping_mul(2_654_435_761) >> 20) + 1.0).collect();
            let best = (0..3usize.pow(7))
                .map(|code| {
                    let mut held = [0.0; 3];
                    for (i, d) in demand.iter().enumerate() {
                        held[code / 3usize.pow(i as u32) % 3] += d;
                    }
                    held.into_iter().fold(0.0, f64::max)
                })
                .fold(f64::INFINITY, f64::min);
            assert!(lay(&demand, 3).1 <= best * (4.0 / 3.0 - 1.0 / 9.0) + 1e-9, "{demand:?}");
        }
    }
}
