// A LOD of a sliding window, picked while it is drawn. Twin: crates/kiln-runtime/src/window/pick.rs
//
// One invocation places one vertex of level 0: at the position of the vertex that it picks, or on the way to where it will be at a
// coarser LOD (Window::morph_positions). Drawn with level 0's own index buffer, the first triangles of each range (draw arguments:
// shaders/window_pick.wgsl); nothing else changes from LOD to LOD. Whoever draws more than positions reads its other arrays at
// `picked(index, alive)` too; attributes of a morph change with the finer LOD.
//
// Reads:  `view`      the view and the LOD
//         `parents`   [vertices]: where each vertex goes
//         `positions` [vertices x 3]: object space
// Writes: clip position, and object-space position at location 0

struct View {
    clip_from_object: mat4x4<f32>,
    // v(d) of the LOD, and of the coarser one that it is on the way to; the same for none.
    alive: u32,
    coarse_alive: u32,
    // 0: as the LOD, 1: as the coarser one.
    factor: f32,
    pad: u32,
}

struct Placed {
    @builtin(position) clip: vec4<f32>,
    @location(0) object: vec3<f32>,
}

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> parents: array<u32>;
@group(0) @binding(2) var<storage, read> positions: array<f32>;

// A parent that does not come first ends the walk, so it ends whatever is read.
fn picked(vertex: u32, alive: u32) -> u32 {
    var i = vertex;
    while (i >= alive && i < arrayLength(&parents)) {
        let parent = parents[i];
        if (parent >= i) {
            break;
        }
        i = parent;
    }
    return i;
}

fn position(vertex: u32) -> vec3<f32> {
    return vec3(positions[3u * vertex], positions[3u * vertex + 1u], positions[3u * vertex + 2u]);
}

@vertex
fn place(@builtin(vertex_index) index: u32) -> Placed {
    let near = picked(index, view.alive);
    let far = picked(near, view.coarse_alive);
    var object = position(near);
    if (far != near) {
        object = object * (1.0 - view.factor) + position(far) * view.factor;
    }
    return Placed(view.clip_from_object * vec4(object, 1.0), object);
}
