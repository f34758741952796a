//! Attribute forms: how far texture, shading and colour would slide over the surface (Hoppe).
//!
//! **Problem.** A collapse that keeps the surface can still drag the texture along it.
//!
//! **Method.** Over a face each attribute is a linear function of the place, so "attributes `s` at place `x`" is off by
//! `g.x + d - s`. A wedge adds up the squares of that over the faces it stands for, weighted by area:
//! ```text
//! E(x, s) = x'Mx + 2 m.x + c - 2 sum_j s_j (G_j.x + D_j) + W sum_j s_j^2
//! ```
//! kept about the wedge's own place and attributes, so that what is subtracted is small and single precision does.
//!
//! **Scale**, with nothing to tune: all attributes are brought to lengths. A texture coordinate counts as the length over which its
//! texture slides, times [`TEXTURE`]: one factor a submesh, the root of its surface by its area in the texture. A normal counts [`NORMAL`] of the
//! diagonal a radian, a colour [`COLOR`] of it from black to white.
//!
//! **Limits.** A point with several wedges is priced by those next to the edge; the others follow unpriced.
//!
//! **Sources.** H. Hoppe, "New quadric metric for simplifying meshes with appearance attributes", IEEE Visualization 1999,
//! doi:10.1109/VISUAL.1999.809869.

use glam::{Vec2, Vec3};
use kiln_asset::Mesh;

/// What a slide of the texture counts beside an equal distance to the surface. Mean image error of eight models at a quarter of their
/// triangles with 0.2, 0.35, 0.5, 1 and 2.5: 9.58, 9.43, 9.35, 9.63, 9.89.
const TEXTURE: f64 = 0.5;
/// Share of the diagonal that a radian of shading counts.
const NORMAL: f64 = 0.002;
/// Share of the diagonal that a colour counts from none to full.
const COLOR: f64 = 0.02;
/// Floats of a form beside those of its attributes.
const FIXED: usize = 11;
/// Most attributes: two for texture, three for normals, four for colour.
const MOST: usize = 9;

/// The forms of all wedges.
pub(crate) struct AttributeForms {
    /// Attributes a wedge.
    count: usize,
    /// 1 / diagonal: all lengths are shares of it, so that models of any size fit single precision.
    inverse: f32,
    /// `[vertex_count] x count`, as lengths.
    values: Vec<f32>,
    /// `[vertex_count] x (FIXED + 4 count)`: M (xx, xy, xz, yy, yz, zz), m, c, W, then G and D of each attribute.
    forms: Vec<f32>,
}

impl AttributeForms {
    /// Those of `mesh`; `None` where it has no attributes.
    pub(crate) fn new(mesh: &Mesh) -> Option<AttributeForms> {
        let uv = mesh.atlas_uv.as_deref().or(mesh.uv0.as_deref());
        let uv_scale = uv.map(|uv| texture_lengths(mesh, uv));
        let (normal, color) = (NORMAL as f32, COLOR as f32);
        let inverse = mesh.diagonal().recip();
        let count = [(uv.is_some(), 2), (mesh.normals.is_some(), 3), (mesh.colors.is_some(), 4)]
            .iter()
            .map(|(there, n)| if *there { *n } else { 0 })
            .sum::<usize>();
        if count == 0 || mesh.face_count() == 0 || !inverse.is_finite() {
            return None;
        }
        let mut submesh = vec![0; mesh.vertex_count()];
        for (triangle, s) in mesh.triangles.iter().zip(&mesh.face_submesh) {
            for v in triangle {
                submesh[*v as usize] = s.index();
            }
        }
        let mut values = Vec::with_capacity(count * mesh.vertex_count());
        for v in 0..mesh.vertex_count() {
            if let (Some(uv), Some(scale)) = (uv, &uv_scale) {
                values.extend((uv[v] * scale[submesh[v]] * inverse).to_array());
            }
            if let Some(normals) = &mesh.normals {
                values.extend((normals[v] * normal).to_array());
            }
            if let Some(colors) = &mesh.colors {
                values.extend((colors[v] * color).to_array());
            }
        }
        let stride = FIXED + 4 * count;
        let mut own = AttributeForms { count, inverse, values, forms: vec![0.0; stride * mesh.vertex_count()] };
        for triangle in &mesh.triangles {
            own.add_face(mesh, triangle);
        }
        Some(own)
    }

    /// Those of `wedges`, in that order.
    pub(crate) fn part(&self, wedges: &[u32]) -> AttributeForms {
        let pick = |values: &[f32], stride: usize| {
            wedges.iter().flat_map(|w| &values[*w as usize * stride..][..stride]).copied().collect()
        };
        AttributeForms {
            count: self.count,
            inverse: self.inverse,
            values: pick(&self.values, self.count),
            forms: pick(&self.forms, FIXED + 4 * self.count),
        }
    }

    /// Takes the forms of `wedges` back from [`AttributeForms::part`].
    pub(crate) fn take_back(&mut self, part: &AttributeForms, wedges: &[u32]) {
        for (w, form) in wedges.iter().zip(part.forms.chunks_exact(FIXED + 4 * self.count)) {
            form_mut(&mut self.forms, self.count, *w).copy_from_slice(form);
        }
    }

    fn add_face(&mut self, mesh: &Mesh, triangle: &[u32; 3]) {
        let [a, b, c] = triangle.map(|v| mesh.positions[v as usize]);
        let (ab, ac) = ((b - a) * self.inverse, (c - a) * self.inverse);
        let (bb, bc, cc) = (ab.length_squared(), ab.dot(ac), ac.length_squared());
        let determinant = bb * cc - bc * bc;
        // A needle has a gradient along itself only, and little area to count.
        if determinant.is_nan() || determinant <= 1e-6 * bb * cc {
            return;
        }
        let weight = determinant.sqrt() / 6.0;
        let mut gradients = [Vec3::ZERO; MOST];
        for (j, gradient) in gradients.iter_mut().take(self.count).enumerate() {
            let [p, q, r] = triangle.map(|v| self.values[v as usize * self.count + j]);
            let (pq, pr) = (q - p, r - p);
            *gradient = (ab * (cc * pq - bc * pr) + ac * (bb * pr - bc * pq)) / determinant;
        }
        if !gradients.iter().all(|g| g.is_finite()) {
            return;
        }
        for v in triangle {
            let form = form_mut(&mut self.forms, self.count, *v);
            for (j, g) in gradients.iter().take(self.count).enumerate() {
                let m = *g * weight;
                for (slot, product) in
                    form.iter_mut().zip([m.x * g.x, m.x * g.y, m.x * g.z, m.y * g.y, m.y * g.z, m.z * g.z])
                {
                    *slot += product;
                }
                for (slot, own) in form[FIXED + 4 * j..].iter_mut().zip(m.to_array()) {
                    *slot += own;
                }
            }
            form[10] += weight;
        }
    }

    /// What it costs to give the faces of `wedge` the attributes of `partner`, `step` away: by the diagonal to the fourth.
    #[inline]
    pub(crate) fn cost(&self, wedge: u32, partner: u32, step: Vec3) -> f32 {
        let step = step * self.inverse;
        let (w, p) = (wedge as usize * self.count, partner as usize * self.count);
        let form = &self.forms[wedge as usize * (FIXED + 4 * self.count)..][..FIXED + 4 * self.count];
        let moved = matrix_times(form, step) + Vec3::new(form[6], form[7], form[8]) * 2.0;
        let mut error = moved.dot(step) + form[9];
        for (j, g) in form[FIXED..].chunks_exact(4).enumerate() {
            let s = self.values[p + j] - self.values[w + j];
            error += s * (form[10] * s - 2.0 * (Vec3::new(g[0], g[1], g[2]).dot(step) + g[3]));
        }
        error.max(0.0)
    }

    /// Gives what `wedge` stands for to `partner`, `step` away.
    pub(crate) fn merge(&mut self, wedge: u32, partner: u32, step: Vec3) {
        let stride = FIXED + 4 * self.count;
        let mut moved = [0.0; FIXED + 4 * MOST];
        let error = self.cost(wedge, partner, step);
        let step = step * self.inverse;
        let form = &self.forms[wedge as usize * stride..][..stride];
        let (w, p) = (wedge as usize * self.count, partner as usize * self.count);
        moved[..stride].copy_from_slice(form);
        let mut linear = matrix_times(form, step) + Vec3::new(form[6], form[7], form[8]);
        for j in 0..self.count {
            let s = self.values[p + j] - self.values[w + j];
            let g = &mut moved[FIXED + 4 * j..FIXED + 4 * j + 4];
            let gradient = Vec3::new(g[0], g[1], g[2]);
            linear -= gradient * s;
            g[3] += gradient.dot(step) - form[10] * s;
        }
        moved[6..9].copy_from_slice(&linear.to_array());
        moved[9] = error;
        for (slot, own) in form_mut(&mut self.forms, self.count, partner).iter_mut().zip(moved) {
            *slot += own;
        }
    }
}

fn form_mut(forms: &mut [f32], count: usize, wedge: u32) -> &mut [f32] {
    let stride = FIXED + 4 * count;
    &mut forms[wedge as usize * stride..][..stride]
}

#[inline]
fn matrix_times(form: &[f32], d: Vec3) -> Vec3 {
    Vec3::new(
        form[0] * d.x + form[1] * d.y + form[2] * d.z,
        form[1] * d.x + form[3] * d.y + form[4] * d.z,
        form[2] * d.x + form[4] * d.y + form[5] * d.z,
    )
}

/// `[submesh_count]`: the length on the surface of one unit of texture; 0 where the texture has no area.
fn texture_lengths(mesh: &Mesh, uv: &[Vec2]) -> Vec<f32> {
    let mut areas = vec![[0.0_f64; 2]; mesh.submeshes.len()];
    for (triangle, s) in mesh.triangles.iter().zip(&mesh.face_submesh) {
        let [a, b, c] = triangle.map(|v| mesh.positions[v as usize].as_dvec3());
        let [p, q, r] = triangle.map(|v| uv[v as usize].as_dvec2());
        areas[s.index()][0] += (b - a).cross(c - a).length();
        areas[s.index()][1] += (q - p).perp_dot(r - p).abs();
    }
    let length = |[surface, texture]: &[f64; 2]| {
        let length = ((surface / texture).sqrt() * TEXTURE) as f32;
        if length.is_finite() { length } else { 0.0 }
    };
    areas.iter().map(length).collect()
}
