//! Reads one request from standard input, unwraps it with xatlas, writes one reply to standard output.
//!
//! ```text
//! charts <- xatlas on the surface at 128 times unit scale     xatlas has absolute tolerances: at unit scale the Stanford
//!                                                             bunny shatters into 1,053 charts and leaves 13 faces out
//! for density from full coverage downwards, 6 % a step (or once, at the density that was asked):
//!     pack into a sheet of the size asked less the padding at its rim
//!     stop if one sheet holds all, and none was shrunk to fit
//! move by the rim's padding; reply
//! ```
//! Charts are made with one winding and not turned by quarter turns when packed, since xatlas turns by swapping u and v,
//! which mirrors; they still are laid along their own axes. Every face's place is read from its corners, and a face whose
//! corners lie on no sheet is reported as unplaced. `face_ignore_data` is never set: the binding passes one flag where
//! xatlas reads one a face.
//!
//! The worker ends when whoever started it is gone, however that came about: nobody is left to read the reply.

use std::io::{Read, Write};
use std::process::ExitCode;

use kiln_xatlas::protocol::{Reply, Request, UNPLACED};
use xatlas_rs_v2::{ChartOptions, IndexData, MeshData, MeshDecl, PackOptions, Xatlas};

/// Scale at which xatlas sees the surface, unitless; a power of two, so that it rounds nothing.
const SCALE: f32 = 128.0;

/// Factor from one density that is tried to the next.
const DENSITY_STEP: f32 = 0.94;

/// Densities that are tried: the last is a thousandth of full coverage's.
const DENSITY_STEPS: u32 = 110;

fn main() -> ExitCode {
    end_with_parent();
    let mut bytes = Vec::new();
    if let Err(error) = std::io::stdin().lock().read_to_end(&mut bytes) {
        eprintln!("reading the request: {error}");
        return ExitCode::FAILURE;
    }
    let request = match Request::decode(&bytes) {
        Ok(request) => request,
        Err(error) => {
            eprintln!("the request: {error}");
            return ExitCode::FAILURE;
        }
    };
    match std::io::stdout().lock().write_all(&answer(&request).encode()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("writing the reply: {error}");
            ExitCode::FAILURE
        }
    }
}

/// Looks twice a second whether the process that started this one is still its parent.
fn end_with_parent() {
    #[cfg(unix)]
    {
        use std::os::unix::process::parent_id;
        let parent = parent_id();
        std::thread::spawn(move || {
            while parent_id() == parent {
                std::thread::sleep(std::time::Duration::from_millis(500));
            }
            std::process::exit(1);
        });
    }
}

fn answer(request: &Request) -> Reply {
    // xatlas pads each chart by this much, so twice as much between two; the rim is ours.
    let rim = request.padding.div_ceil(2);
    if request.triangles.is_empty() || request.size <= 2 * rim + 1 {
        return Reply::Refused(format!("{} faces for a sheet of {}", request.triangles.len(), request.size));
    }
    let positions: Vec<f32> = request.positions.as_flattened().iter().map(|c| c * SCALE).collect();
    let decl = MeshDecl {
        vertex_position_data: MeshData::Contiguous(&positions),
        index_data: Some(IndexData::U32(request.triangles.as_flattened())),
        face_material_data: Some(&request.groups),
        ..MeshDecl::default()
    };
    let mut xatlas = Xatlas::new();
    if let Err(error) = xatlas.add_mesh(&decl) {
        return Reply::Refused(format!("xatlas refuses the mesh: {error:?}"));
    }
    xatlas.compute_charts(&ChartOptions { fix_winding: true, ..ChartOptions::default() });

    let inner = request.size - 2 * rim;
    let areas: Vec<f32> = request.triangles.iter().map(|t| area(&positions, *t)).collect();
    let full = inner as f32 / areas.iter().map(|a| f64::from(*a)).sum::<f64>().sqrt() as f32;
    let (mut density, steps) = if request.density > 0.0 { (request.density / SCALE, 1) } else { (full, DENSITY_STEPS) };
    let mut charts = 0;
    for _ in 0..steps {
        xatlas.pack_charts(&PackOptions {
            padding: rim,
            resolution: inner,
            texels_per_unit: density,
            rotate_charts: false,
            ..PackOptions::default()
        });
        charts = xatlas.chart_count();
        if xatlas.atlas_count() == 1 {
            let (charts, corners) = read_charts(&xatlas, request.triangles.len(), rim);
            if !any_shrunk(&charts, &corners, &areas, density) {
                return Reply::Placed { charts, corners };
            }
        }
        density *= DENSITY_STEP;
    }
    Reply::DoesNotFit { charts }
}

/// Chart and corners of each face, moved inwards by the rim.
fn read_charts(xatlas: &Xatlas<'_>, faces: usize, rim: u32) -> (Vec<u32>, Vec<[[f32; 2]; 3]>) {
    let mut charts = vec![UNPLACED; faces];
    let mut corners = vec![[[0.0; 2]; 3]; faces];
    for mesh in xatlas.meshes().iter().take(1) {
        for (face, indices) in mesh.index_array.chunks_exact(3).take(faces).enumerate() {
            let vertices = [indices[0], indices[1], indices[2]].map(|i| &mesh.vertex_array[i as usize]);
            if vertices.iter().all(|v| v.atlas_index == 0 && v.chart_index >= 0) {
                charts[face] = vertices[0].chart_index as u32;
                corners[face] = vertices.map(|v| v.uv.map(|c| c + rim as f32));
            }
        }
    }
    (charts, corners)
}

/// Whether xatlas made a chart smaller than the density says because it was larger than the sheet.
fn any_shrunk(charts: &[u32], corners: &[[[f32; 2]; 3]], areas: &[f32], density: f32) -> bool {
    let count = charts.iter().filter(|c| **c != UNPLACED).max().map_or(0, |c| *c as usize + 1);
    let mut sums = vec![(0.0f64, 0.0f64); count];
    for ((chart, corners), area) in charts.iter().zip(corners).zip(areas) {
        if let Some(sum) = sums.get_mut(*chart as usize) {
            let [a, b, c] = corners;
            let turn = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
            sum.0 += 0.5 * f64::from(turn.abs());
            sum.1 += f64::from(area * density * density);
        }
    }
    sums.iter().any(|(texels, expected)| *texels < 0.95 * expected)
}

/// Area of a triangle at xatlas' scale.
fn area(positions: &[f32], triangle: [u32; 3]) -> f32 {
    let [a, b, c] = triangle.map(|p| [0, 1, 2].map(|k| f64::from(positions[3 * p as usize + k])));
    let edge = |to: [f64; 3]| [to[0] - a[0], to[1] - a[1], to[2] - a[2]];
    let (u, v) = (edge(b), edge(c));
    let cross = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    (0.5 * (cross[0] * cross[0] + cross[1] * cross[1] + cross[2] * cross[2]).sqrt()) as f32
}
