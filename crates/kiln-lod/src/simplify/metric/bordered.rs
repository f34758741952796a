//! The texture-border extension of any metric ([`crate::simplify::texture_border`]): a surcharge on collapses near a border.
//!
//! It may fall when a star changes, so all neighbours of a kept point are priced anew.

use glam::DVec3;
use kiln_asset::Mesh;

use super::Metric;
use crate::simplify::texture_border::{Surcharge, TextureBorders};
use crate::simplify::working::Working;
use crate::topology::NONE;

/// A metric with the surcharge.
pub(in crate::simplify) struct Bordered<'a, M> {
    base: M,
    surcharge: Surcharge<'a>,
    /// The surcharge is measured against costs in the quadric metric's unit.
    unit: f32,
    mesh: &'a Mesh,
    /// `[point_count]`: whether an edge at the point crossed a border when it was priced last.
    near: Vec<bool>,
}

impl<'a, M: Metric> Bordered<'a, M> {
    pub(in crate::simplify) fn new(
        base: M,
        mesh: &'a Mesh,
        borders: &'a TextureBorders,
        work: &Working<'_>,
    ) -> Bordered<'a, M> {
        let surcharge = Surcharge::new(borders, mesh);
        let near = (0..work.points.len() as u32).map(|p| surcharge.near(mesh, work.star(p, NONE))).collect();
        Bordered { unit: base.quadric_unit(), base, surcharge, mesh, near }
    }
}

impl<M: Metric> Metric for Bordered<'_, M> {
    const FALLS: bool = true;
    const PLACES: bool = M::PLACES;

    fn cost(&self, work: &Working<'_>, from: u32, to: u32, corner: u32) -> f32 {
        let base = self.base.cost(work, from, to, corner) * self.unit;
        if !self.near[from as usize] {
            return base;
        }
        self.surcharge.cost(self.mesh, f64::from(base), true, work.star(from, to)) as f32
    }

    fn surcharge(&self, work: &Working<'_>, from: u32, to: u32) -> f64 {
        if self.near[from as usize] { self.surcharge.alone(self.mesh, work.star(from, to)) } else { 0.0 }
    }

    fn offers(&self, work: &Working<'_>, from: u32, to: u32) -> bool {
        self.base.offers(work, from, to)
    }

    fn place(&self, work: &Working<'_>, from: u32, to: u32) -> Option<DVec3> {
        self.base.place(work, from, to)
    }

    fn star_changed(&mut self, work: &Working<'_>, p: u32) {
        self.base.star_changed(work, p);
        self.near[p as usize] = self.surcharge.near(self.mesh, work.star(p, NONE));
    }

    fn merge(&mut self, work: &mut Working<'_>, from: u32, to: u32, place: Option<DVec3>) -> f64 {
        self.base.merge(work, from, to, place)
    }
}
