// Distance fields on regular grids. Twin of `esdf.rs`.

struct Field {
    // Centre of the first voxel.
    origin: vec3<f32>,
    voxel_m: f32,
    size: vec3<u32>,
    // Where its values begin in `distances`; x runs fastest.
    first: u32,
}

@group(0) @binding(5) var<storage, read> distances: array<f32>;

fn lerp(a: f32, b: f32, t: f32) -> f32 {
    return a + (b - a) * t;
}

// Gradient (xyz) and value (w) of the trilinear distance; outside the grid, the value at the nearest point of it.
fn sample(field: Field, at: vec3<f32>) -> vec4<f32> {
    let inverse = 1.0 / field.voxel_m;
    let free = (at - field.origin) * inverse;
    let u = clamp(free, vec3(0.0), vec3<f32>(field.size - 1u));
    let base = min(vec3<u32>(u), field.size - 2u);
    let f = u - vec3<f32>(base);
    let row = field.size.x;
    let plane = field.size.x * field.size.y;
    let v = field.first + base.z * plane + base.y * row + base.x;
    let c000 = distances[v];
    let c100 = distances[v + 1u];
    let c010 = distances[v + row];
    let c110 = distances[v + row + 1u];
    let c001 = distances[v + plane];
    let c101 = distances[v + plane + 1u];
    let c011 = distances[v + plane + row];
    let c111 = distances[v + plane + row + 1u];
    let x00 = lerp(c000, c100, f.x);
    let x10 = lerp(c010, c110, f.x);
    let x01 = lerp(c001, c101, f.x);
    let x11 = lerp(c011, c111, f.x);
    let y0 = lerp(x00, x10, f.y);
    let y1 = lerp(x01, x11, f.y);
    let dx = lerp(lerp(c100 - c000, c110 - c010, f.y), lerp(c101 - c001, c111 - c011, f.y), f.z);
    let dy = lerp(x10 - x00, x11 - x01, f.z);
    // Beyond the grid the value no longer changes along an axis.
    let slope = select(vec3(0.0), vec3(inverse), free == u);
    return vec4(vec3(dx, dy, y1 - y0) * slope, lerp(y0, y1, f.z));
}

// True where the distance is surely at least `least`: one look at the nearest voxel.
fn is_beyond(field: Field, at: vec3<f32>, least: f32) -> bool {
    let rounded = max((at - field.origin) / field.voxel_m + 0.5, vec3(0.0));
    let voxel = min(vec3<u32>(rounded), field.size - 1u);
    let value = distances[field.first + (voxel.z * field.size.y + voxel.y) * field.size.x + voxel.x];
    let far = select(0.0, 1.0, value > NEAR_VOXELS * field.voxel_m);
    return value > max(least, 0.0) + (HALF_DIAGONAL + far) * field.voxel_m;
}

// Gradient and distance of the resting world at the first three entries of each configuration, written over the first four.
@compute @workgroup_size(WORKGROUP)
fn sample_all(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= arrayLength(&configurations) {
        return;
    }
    let at = vec3(configurations[id.x].x[0], configurations[id.x].x[1], configurations[id.x].x[2]);
    let found = sample(scene.resting, at);
    configurations[id.x].x[0] = found.x;
    configurations[id.x].x[1] = found.y;
    configurations[id.x].x[2] = found.z;
    configurations[id.x].x[3] = found.w;
}
