// Clearance of the robot's spheres: to the world, to the moving object and to each other. Twin of `collision.rs`.

struct Link {
    // Bounding sphere in the node's frame.
    center: vec3<f32>,
    radius: f32,
    node: u32,
    // Its spheres.
    first: u32,
    last: u32,
    flags: u32,
}

struct Scene {
    resting: Field,
    // In the frame of the driven joint's child.
    moving: Field,
    // The driven joint at zero, and its axis in its own frame.
    world_from_joint: Frame,
    axis: vec3<f32>,
    slides: u32,
    floor_z: f32,
    links: u32,
    pairs: u32,
}

const ON_BASE: u32 = 1u;
const ON_TOOL: u32 = 2u;
const FAR_AWAY: f32 = 1e9;

@group(0) @binding(0) var<uniform> scene: Scene;
// Centre and radius, sorted by link.
@group(0) @binding(2) var<storage, read> spheres: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> links: array<Link>;
// Links that may touch one another.
@group(0) @binding(4) var<storage, read> pairs: array<vec2<u32>>;

// Sine and cosine of the driven joint (a turn), or its position (a slide).
var<private> driven: vec2<f32>;

fn drive(object_q: f32) {
    if scene.slides == 1u {
        driven = vec2(object_q, 0.0);
    } else {
        driven = sin_cos(object_q);
    }
}

// Rodrigues' formula about the driven joint's axis.
fn about_axis(v: vec3<f32>, turn: vec2<f32>) -> vec3<f32> {
    return v * turn.y + cross(scene.axis, v) * turn.x + scene.axis * (dot(scene.axis, v) * (1.0 - turn.y));
}

// A world point in the frame of what the driven joint moves.
fn inside_moved(at: vec3<f32>) -> vec3<f32> {
    let local = inside(scene.world_from_joint, at);
    if scene.slides == 1u {
        return local - scene.axis * driven.x;
    }
    return about_axis(local, vec2(-driven.x, driven.y));
}

// World components of a direction of what the driven joint moves.
fn turned_with_moved(direction: vec3<f32>) -> vec3<f32> {
    if scene.slides == 1u {
        return turned(scene.world_from_joint, direction);
    }
    return turned(scene.world_from_joint, about_axis(direction, driven));
}

// Velocity of a world point of the moved link for each unit of the driven joint.
fn driven_velocity(at: vec3<f32>) -> vec3<f32> {
    let axis = turned(scene.world_from_joint, scene.axis);
    if scene.slides == 1u {
        return axis;
    }
    return cross(axis, at - scene.world_from_joint.origin);
}

fn link_center(link: Link) -> vec3<f32> {
    return place(nodes[link.node], link.center);
}

// Squared distance below which the bounds of two links may hold spheres within `reach` of each other.
fn bounds_meet(a: Link, b: Link, reach: f32) -> bool {
    let apart = link_center(a) - link_center(b);
    let least = a.radius + b.radius + reach;
    return dot(apart, apart) < least * least;
}

// Smallest clearance with the hand on the object, metres; those above `reach` (world) and `pair_reach` (the robot's own
// links) are not told apart.
fn clearance(reach: f32, pair_reach: f32) -> f32 {
    var least = FAR_AWAY;
    for (var l = 0u; l < scene.links; l++) {
        let link = links[l];
        let middle = link_center(link);
        let near = link.radius + reach;
        let may_rest = !is_beyond(scene.resting, middle, near);
        let may_move = (link.flags & ON_TOOL) == 0u && !is_beyond(scene.moving, inside_moved(middle), near);
        let may_stand = (link.flags & ON_BASE) == 0u && middle.z - scene.floor_z < near;
        if !(may_rest || may_move || may_stand) {
            continue;
        }
        for (var s = link.first; s < link.last; s++) {
            let sphere = spheres[s];
            let at = place(nodes[link.node], sphere.xyz);
            if may_rest && !is_beyond(scene.resting, at, sphere.w + reach) {
                least = min(least, sample(scene.resting, at).w - sphere.w);
            }
            if may_stand {
                least = min(least, at.z - scene.floor_z - sphere.w);
            }
            if may_move {
                let local = inside_moved(at);
                if !is_beyond(scene.moving, local, sphere.w + reach) {
                    least = min(least, sample(scene.moving, local).w - sphere.w);
                }
            }
        }
    }
    for (var p = 0u; p < scene.pairs; p++) {
        let a = links[pairs[p].x];
        let b = links[pairs[p].y];
        if !bounds_meet(a, b, pair_reach) {
            continue;
        }
        let around_b = link_center(b);
        for (var i = a.first; i < a.last; i++) {
            let own = spheres[i];
            let at = place(nodes[a.node], own.xyz);
            if distance(at, around_b) > own.w + b.radius + pair_reach {
                continue;
            }
            for (var j = b.first; j < b.last; j++) {
                let other = spheres[j];
                least = min(least, distance(at, place(nodes[b.node], other.xyz)) - own.w - other.w);
            }
        }
    }
    return least;
}

// Half the gradient and half the Hessian (lower triangle by rows) of `sum hinge^2`, its value, the largest hinge.
var<private> gradient: array<f32, MAX_VARIABLES>;
var<private> hessian: array<f32, TRIANGLE>;
var<private> hinge_cost: f32;
var<private> largest_hinge: f32;
// Derivative of one hinge's distance.
var<private> row: array<f32, MAX_VARIABLES>;

fn add_point(first_joint: u32, node: u32, at: vec3<f32>, slope: vec3<f32>) {
    var moved_by = joints[first_joint + node].moved_by;
    while moved_by != 0u {
        let variable = firstTrailingBit(moved_by);
        moved_by &= moved_by - 1u;
        row[variable] += dot(slope, point_column(first_joint, variable, at));
    }
}

// Adds `hinge^2`, of which `row` is the derivative, and clears `row`.
fn add_hinge(hinge: f32, dof: u32) {
    hinge_cost += hinge * hinge;
    largest_hinge = max(largest_hinge, hinge);
    var entry = 0u;
    for (var i = 0u; i < dof; i++) {
        let by = row[i];
        gradient[i] += by * hinge;
        if by != 0.0 {
            for (var j = 0u; j <= i; j++) {
                hessian[entry + j] += by * row[j];
            }
        }
        entry += i + 1u;
    }
    for (var i = 0u; i < dof; i++) {
        row[i] = 0.0;
    }
}

// Hinge penalties of every clearance below `margin` at `nodes`; the last variable is the driven joint.
fn penalise(first_joint: u32, dof: u32, margin: f32) {
    hinge_cost = 0.0;
    largest_hinge = 0.0;
    for (var i = 0u; i < MAX_VARIABLES; i++) {
        gradient[i] = 0.0;
        row[i] = 0.0;
    }
    for (var i = 0u; i < TRIANGLE; i++) {
        hessian[i] = 0.0;
    }
    for (var l = 0u; l < scene.links; l++) {
        let link = links[l];
        let middle = link_center(link);
        let near = link.radius + margin;
        let may_rest = !is_beyond(scene.resting, middle, near);
        let may_move = (link.flags & ON_TOOL) == 0u && !is_beyond(scene.moving, inside_moved(middle), near);
        let may_stand = (link.flags & ON_BASE) == 0u && middle.z - scene.floor_z < near;
        if !(may_rest || may_move || may_stand) {
            continue;
        }
        for (var s = link.first; s < link.last; s++) {
            let sphere = spheres[s];
            let at = place(nodes[link.node], sphere.xyz);
            let reach = sphere.w + margin;
            if may_rest && !is_beyond(scene.resting, at, reach) {
                let found = sample(scene.resting, at);
                if found.w < reach {
                    add_point(first_joint, link.node, at, -found.xyz);
                    add_hinge(reach - found.w, dof);
                }
            }
            if may_stand && at.z - scene.floor_z < reach {
                add_point(first_joint, link.node, at, vec3(0.0, 0.0, -1.0));
                add_hinge(reach - (at.z - scene.floor_z), dof);
            }
            if may_move {
                let local = inside_moved(at);
                if !is_beyond(scene.moving, local, reach) {
                    let found = sample(scene.moving, local);
                    if found.w < reach {
                        let slope = turned_with_moved(found.xyz);
                        add_point(first_joint, link.node, at, -slope);
                        row[dof - 1u] += dot(slope, driven_velocity(at));
                        add_hinge(reach - found.w, dof);
                    }
                }
            }
        }
    }
    for (var p = 0u; p < scene.pairs; p++) {
        let a = links[pairs[p].x];
        let b = links[pairs[p].y];
        if !bounds_meet(a, b, margin) {
            continue;
        }
        let around_b = link_center(b);
        for (var i = a.first; i < a.last; i++) {
            let own = spheres[i];
            let at = place(nodes[a.node], own.xyz);
            if distance(at, around_b) > own.w + b.radius + margin {
                continue;
            }
            for (var j = b.first; j < b.last; j++) {
                let other = spheres[j];
                let there = place(nodes[b.node], other.xyz);
                let apart = distance(at, there);
                let hinge = margin - (apart - own.w - other.w);
                if hinge > 0.0 && apart > 1e-6 {
                    let direction = (at - there) / apart;
                    add_point(first_joint, a.node, at, -direction);
                    add_point(first_joint, b.node, there, direction);
                    add_hinge(hinge, dof);
                }
            }
        }
    }
}

// Clearance of each configuration with the hand on the object; of those whose end is not where it belongs, none.
@compute @workgroup_size(WORKGROUP)
fn clear_all(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= arrayLength(&configurations) || !(configurations[id.x].squared < CONVERGED) {
        return;
    }
    q = configurations[id.x].x;
    forward(problems[0].first_joint, problems[0].dof);
    drive(problems[0].object_q);
    configurations[id.x].clearance = clearance(FAR_M, PAIR_FAR_M);
}
